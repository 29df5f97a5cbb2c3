"""One estimate for points and light plane: the plane is made again from its own sweeps where they differ."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from acquire.contract.calibration import load_calibration
from acquire.contract.errors import CalibrationError, SweepscopeError
from acquire.contract.scan_data.file_layout import ScanLayout, read_layout
from process.calibration.calibration_file import write_document
from process.results.settings import ReconstructOptions, recorded_in, settle

from .recipe import recipe_in, refit_plane

NAME = "calibration-{method}.json"


def with_matching_plane(
    scan: Path, options: ReconstructOptions, say: Callable[[str], None] = lambda _: None
) -> ReconstructOptions:
    """``options`` with a calibration whose light plane was made with the estimate of the points.

    If the recorded or named calibration was made with another estimate and its sweeps are still there, the plane is
    made again from them and written beside the results. If they are gone, ``options`` is returned unchanged, and the
    reconstruction warns.

    Args:
        scan: SCAN.
        options: as asked for.
        say: called with messages about what happens.

    Raises:
        ScanFileError, CalibrationError, ConfigError: as ``reconstruct``.
    """
    layout = read_layout(scan)
    settings = settle(recorded_in(layout), options)
    plane = settings.light_plane
    if plane is None or plane.method == settings.method:
        return options
    text = _text(layout, options)
    document = json.loads(text)
    if recipe_in(document) is None:
        return options
    target = (options.out or layout.path.parent) / NAME.format(method=settings.method)
    source = hashlib.sha256(text.encode()).hexdigest()
    if _is_of(target, source):
        return replace(options, calibration=target)
    say(f"the light plane was made with {plane.method}: it is made again with {settings.method} from its own sweeps")
    try:
        made = refit_plane(document, settings.method, say).document
        made["light_plane"]["quality"]["refitted_from_sha256"] = source
        target.parent.mkdir(parents=True, exist_ok=True)
        write_document(target, made, force=True)
    except (SweepscopeError, OSError) as error:
        say(f"that cannot be done: {error}")
        return options
    return replace(options, calibration=target)


def _text(layout: ScanLayout, options: ReconstructOptions) -> str:
    if options.calibration is not None:
        return load_calibration(options.calibration)[1]
    return layout.verbatim["calibration"].decode("utf-8")


def _is_of(target: Path, source: str) -> bool:
    """Whether ``target`` was made from the calibration with this digest by an earlier reconstruction."""
    if not target.is_file():
        return False
    try:
        found: dict[str, Any] = json.loads(load_calibration(target)[1])
    except CalibrationError:
        return False
    return (found.get("light_plane", {}).get("quality") or {}).get("refitted_from_sha256") == source
