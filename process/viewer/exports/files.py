"""Names and contents of the files that people take away from the page."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError

from .offline_page import page_html
from .shown_cloud import ShownCloud, ply_bytes

BACKGROUND = 20.0
"""Grey of the page behind the scene."""


def file_of(kind: str, shown: ShownCloud) -> tuple[str, bytes]:
    """Name and content of an export: ``PLY``, ``3D page`` or ``Figure``."""
    if kind == "PLY":
        return f"{shown.title}.ply", ply_bytes(shown.tiles)
    if kind == "3D page":
        return f"{shown.title}.html", page_html(shown).encode()
    from .figure import figure_png  # noqa: PLC0415 - matplotlib takes half a second, and few ask for a figure

    return f"{shown.title}.png", figure_png(shown)


def report_of(folder: Path | None) -> bytes:
    """The report of a scan as one HTML page (as ``sweepscope page`` makes it).

    Raises:
        ScanFileError: there is no scan, or it has no results.
    """
    from process.results.page.html import page  # noqa: PLC0415 - matplotlib takes half a second, and few ask for it
    from process.results.page.load import read_results  # noqa: PLC0415

    if folder is None:
        raise ScanFileError("there is no scan yet")
    return page(read_results(folder)).encode()


def screenshot_of(pixels: NDArray[np.uint8]) -> bytes:
    """A rendering [h, w, 3 or 4] RGB(A) as PNG, on the dark that the page shows behind it."""
    bgr = pixels[:, :, 2::-1]
    if pixels.shape[2] == 4:
        share = pixels[:, :, 3:] / 255.0
        bgr = (share * bgr + (1 - share) * BACKGROUND).astype(np.uint8)
    return cv2.imencode(".png", np.ascontiguousarray(bgr))[1].tobytes()
