"""Owns what the worker knows of a scan before its first frame, and what it needs to fold it: settings and memory."""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError, ConfigError, ScanFileError, SweepscopeError
from acquire.contract.messaging.messages import FrameFormat, Start
from acquire.contract.scan_data.file_layout import zero_id_in
from acquire.contract.units import format_bytes
from process.edge_fit.early_estimates import EarlyEstimates
from process.fold.fold import Fold
from process.results.scan_frames import ScanFrames
from process.results.settings import ReconstructOptions, Recorded, Settings, recorded_in, settle

logger = logging.getLogger(__name__)


class ScanRefusedError(SweepscopeError):
    """A scan that this worker cannot fold; the sweep itself is not touched."""


@dataclass(frozen=True)
class Announced:
    """A scan as the start message, or the file after a late start, describes it."""

    scan_uid: str
    folder: Path
    count: int
    """Frames of the plan."""
    recorded: Recorded

    @property
    def planned_positions_um(self) -> NDArray[np.float64]:
        """Where the frames should be taken, [n]; NaN without a plan."""
        plan = self.recorded.plan
        return np.full(self.count, np.nan) if plan is None else plan.positions_um().astype(np.float64)


def announced_by_start(start: Start) -> Announced:
    """The scan that a start message begins."""
    recorded = Recorded(
        start.format, start.plan, start.config_toml, start.calibration_json, zero_id_in(start.versions_json)
    )
    return Announced(start.scan_uid, Path(start.path), start.plan.count, recorded)


def announced_by_file(frames: ScanFrames) -> Announced:
    """The scan in a file that exists already.

    Raises:
        ScanFileError: what it recorded cannot be read.
    """
    layout = frames.layout
    return Announced(layout.scan_uid, layout.path.parent, layout.count, recorded_in(layout))


def live_settings(recorded: Recorded) -> Settings:
    """The recorded settings; a calibration that cannot be used costs the cloud, never the maps."""
    try:
        return settle(recorded, ReconstructOptions())
    except CalibrationError as error:
        why = f"no cloud: {error}"
        recorded = dataclasses.replace(recorded, calibration_json="")
    except (ConfigError, ScanFileError) as error:
        why = f"no cloud, and default settings: {error}"
        recorded = Recorded(recorded.format, recorded.plan)
    logger.warning("%s", why)
    try:
        settings = settle(recorded, ReconstructOptions())
    except (ConfigError, ScanFileError):
        settings = settle(Recorded(recorded.format, recorded.plan), ReconstructOptions())
    return dataclasses.replace(settings, warnings=(why,))


def check_memory(form: FrameFormat, fold_bytes: int) -> None:
    """Refuse a scan whose fold does not fit into ``fold_bytes``.

    Raises:
        ScanRefusedError: how much it needs, and what to do.
    """
    shape = (form.height, form.width)
    needed = Fold.bytes_needed(shape, form.bit_depth) + EarlyEstimates.bytes_needed(shape)
    if needed > fold_bytes:
        raise ScanRefusedError(
            f"the live cloud needs {format_bytes(needed)} for frames of {form.width} x {form.height}, "
            f"limits.fold_bytes allows {format_bytes(fold_bytes)}: the scan itself is safe; raise the limit, "
            "or make the cloud afterwards with 'sweepscope reconstruct'"
        )
