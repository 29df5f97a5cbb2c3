"""Writes one full-size picture as a PNG, for calibration, where reduced preview pictures are too coarse."""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.cameras.protocol import CameraFrame
from acquire.contract.errors import CommandRefusedError, ScanFileError
from acquire.contract.files import replace_file
from acquire.contract.scan_data.bayer import demosaiced

from .background import Background

FOLDER: Final = "captures"


def capture_path(wanted: str, data_dir: Path) -> Path:
    """The path of a new picture.

    Raises:
        CommandRefusedError: it lies outside the folder of scans, is no .png, or exists.
    """
    data_dir = data_dir.resolve()
    if not wanted:
        return data_dir / FOLDER / f"{datetime.now(UTC).strftime('%Y%m%dT%H%M%S%fZ')}.png"
    path = Path(os.path.normpath(wanted))
    if not path.is_absolute() or not path.parent.resolve().is_relative_to(data_dir):
        raise CommandRefusedError(f"pictures go into the folder of scans {data_dir}, not to {wanted[:200]}")
    if path.suffix.lower() != ".png":
        raise CommandRefusedError(f"a picture is a .png file, not {path.name[:100]}")
    if path.exists():
        raise CommandRefusedError(f"{path} is there already and was left alone")
    return path


def write_png(path: Path, pixels: NDArray[Any], pixel_format: str) -> None:
    """Write [h, w] or [h, w, 3] RGB, uint8 or uint16 as stored, by a rename; Bayer frames become colour.

    Raises:
        ScanFileError: it cannot be written; nothing of it is left.
    """
    pixels = demosaiced(pixels, pixel_format)
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_RGB2BGR)
    encoded = cv2.imencode(".png", pixels)[1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, encoded.tobytes())
    except OSError as error:
        raise ScanFileError(f"cannot write {path}: {error.strerror}; take the picture again") from None


class Capture(Background):
    """Takes one picture and writes it."""

    name: ClassVar[str] = "capture"
    snaps: ClassVar[bool] = True

    def __init__(self, path: Path, pixel_format: str, snap: Callable[[int], None]) -> None:
        super().__init__()
        self._path, self._pixel_format, self._snap = path, pixel_format, snap

    def begin(self, now_ns: int) -> None:
        """Ask for the picture."""
        self._snap(now_ns)

    def on_frame(self, frame: CameraFrame, now_ns: int) -> None:
        """Write it."""
        self.share = 0.5
        self.do(lambda: self._write(frame), now_ns)

    def _write(self, frame: CameraFrame) -> str:
        write_png(self._path, frame.pixels, self._pixel_format)
        return f"saved {self._path}"
