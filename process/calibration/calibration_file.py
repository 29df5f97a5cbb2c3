"""Write calibration.json: checked as a reader would check it, unknown keys kept, replaced in one step."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from acquire.contract.calibration import load_calibration, parse_calibration
from acquire.contract.errors import CalibrationError
from acquire.contract.files import replace_file


def new_document(camera: dict[str, Any], light_plane: dict[str, Any] | None = None) -> dict[str, Any]:
    """A calibration of a camera, perhaps with a light plane, for JSON."""
    found: dict[str, Any] = {"format": "sweepscope-calibration", "version": 1, "camera": camera}
    if light_plane is not None:
        found["light_plane"] = light_plane
    return found


def read_document(path: Path) -> dict[str, Any]:
    """The content of a calibration, with keys that this version does not know.

    Raises:
        CalibrationError: as ``load_calibration``.
    """
    return dict(json.loads(load_calibration(path)[1]))


def write_document(path: Path, document: dict[str, Any], *, force: bool = False) -> None:
    """Write a calibration so that it survives a power cut: unlike results it cannot be made again from a scan.

    Raises:
        CalibrationError: the file is there and ``force`` is not given, the content is not valid, or it cannot be
            written; a file that was there is untouched.
    """
    if path.exists() and not force:
        raise CalibrationError(f"{path} is there and was left alone: name another file, or replace it with --force")
    text = json.dumps(_finite(document), indent=1, allow_nan=False) + "\n"
    parse_calibration(text, str(path))
    try:
        replace_file(path, text.encode(), durable=True)
    except OSError as error:
        raise CalibrationError(f"cannot write {path}: {error.strerror}; nothing was changed") from None


def utc_now() -> str:
    """The time for ``created_utc``, ISO 8601 Z."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _finite(value: Any) -> Any:
    """JSON has no NaN: an unknown figure of quality is null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
