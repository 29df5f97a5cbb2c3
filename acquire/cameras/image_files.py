"""Reads image files: listing a folder in natural order, decoding to the arrays that scans store."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from natsort import natsorted
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import MAX_SIDE_PX, FrameFormat
from acquire.contract.plan import MAX_FRAMES

SUFFIXES: Final = frozenset({".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff"})


_FLAGS: Final = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION


def list_pictures(folder: Path) -> list[Path]:
    """The pictures in ``folder`` in natural order of their names (2 before 10); hidden files are left out.

    Raises:
        ScanFileError: there is no such folder, or nothing in it is a picture.
    """
    try:
        names = [entry.name for entry in os.scandir(folder) if entry.is_file() and not entry.name.startswith(".")]
    except OSError as error:
        raise ScanFileError(f"{folder} cannot be read: {error.strerror}; give the folder of the frames") from None
    pictures = natsorted(found for found in names if Path(found).suffix.lower() in SUFFIXES)
    if not pictures:
        raise ScanFileError(f"{folder} holds no pictures (png, bmp, jpg or tif): give the folder of the frames")
    if len(pictures) > MAX_FRAMES:
        raise ScanFileError(f"{folder} holds {len(pictures)} pictures, more than the {MAX_FRAMES} that a scan can have")
    return [folder / found for found in pictures]


def read_picture(path: Path) -> NDArray[Any]:
    """Pixels of one picture as stored in scans: uint8 or uint16, [h, w] or [h, w, 3] RGB, C-contiguous.

    Raises:
        ScanFileError: it is no picture, damaged, or of another type; its name is in the text.
    """
    try:
        raw = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise ScanFileError(f"{path} cannot be read: {error.strerror}") from None
    pixels = _decode(raw)
    if pixels is None:
        raise ScanFileError(f"{path} is no readable picture: replace it, or take it out of the folder")
    if path.suffix.lower() in (".tif", ".tiff") and cv2.imcount(str(path)) > 1:
        raise ScanFileError(f"{path} holds several pictures: split it into one file per frame first")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ScanFileError(f"{path} holds {pixels.dtype} values: scans have 8 or 16 bits, unsigned")
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    return np.ascontiguousarray(pixels)


def _decode(raw: NDArray[np.uint8]) -> NDArray[Any] | None:
    if raw.size == 0:
        return None
    level = cv2.utils.logging.getLogLevel()
    # silence OpenCV's own messages about a damaged picture; our error says it in one line
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.imdecode(raw, _FLAGS)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)


def format_of(pixels: NDArray[Any], path: Path) -> FrameFormat:
    """The format of a scan whose first frame is ``pixels``, [h, w] or [h, w, 3].

    Raises:
        ScanFileError: too large.
    """
    height, width = pixels.shape[:2]
    if max(height, width) > MAX_SIDE_PX:
        raise ScanFileError(f"{path} is {width} x {height}: at most {MAX_SIDE_PX} pixels a side are possible")
    bit_depth = 8 if pixels.dtype == np.uint8 else 16
    return FrameFormat(width, height, bit_depth, "rgb" if pixels.ndim == 3 else "mono")
