"""Own the content of the files that people take away from the page."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError

from .exports import View, page_html, ply_bytes

BACKGROUND = 20.0
"""Grey of the page behind the scene."""


def on_black(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A rendering [h, w, 3 or 4] RGB(A) as BGR before the dark that the page shows behind it."""
    if pixels.shape[2] == 3:
        return np.ascontiguousarray(pixels[:, :, ::-1])
    share = pixels[:, :, 3:] / 255.0
    mixed = share * pixels[:, :, 2::-1] + (1 - share) * BACKGROUND
    return mixed.astype(np.uint8)


def file_of(kind: str, view: View) -> tuple[str, bytes]:
    """Name and content of an export."""
    if kind == "PLY":
        return f"{view.title}.ply", ply_bytes(view.tiles)
    if kind == "3D page":
        return f"{view.title}.html", page_html(view).encode()
    from .figure import figure_png  # noqa: PLC0415 - matplotlib takes half a second, and few ask for a figure

    return f"{view.title}.png", figure_png(view)


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
    """A rendering [h, w, 3 or 4] RGB(A) as PNG."""
    return cv2.imencode(".png", on_black(pixels))[1].tobytes()
