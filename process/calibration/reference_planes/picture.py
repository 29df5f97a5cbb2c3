"""A picture of a calibration with reference planes: markers with numbers, regions, and a few of the lines found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from acquire.contract.files import replace_file
from process.fold.fold import to_grey
from process.results.scan_frames import ScanFrames

from .calibrate import Edges
from .known_planes import ReferencePlane

COLOURS = ((60, 170, 255), (255, 170, 60))
"""Of the two planes, blue green red."""
LINES = 8
WIDTH_PX = 900
"""Smaller pictures are enlarged to about this, so that numbers can be read."""


def draw(scan: Path, known: Sequence[ReferencePlane], edges: Edges, shown: Sequence[int]) -> NDArray[np.uint8]:
    """[h, w, 3] blue green red: the lightest of a few frames, with all that was given and found drawn in.

    Args:
        scan: whose frames lie under it.
        known: the planes.
        edges: found, by t.
        shown: frames that have a plane.
    """
    base = _background(scan)
    zoom = max(round(WIDTH_PX / base.shape[1]), 1)
    canvas = cv2.resize(cv2.cvtColor(base, cv2.COLOR_GRAY2BGR), None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
    for colour, plane in zip(COLOURS, known, strict=False):
        _draw_plane(canvas, plane, colour, zoom)
    for t in shown[:: max(len(shown) // LINES, 1)]:
        for points, colour in zip(edges.get(t, ()), COLOURS, strict=False):
            if points is not None:
                _draw_line(canvas, points.pixels, colour, zoom, str(t))
    return np.asarray(canvas, dtype=np.uint8)


def _background(scan: Path) -> NDArray[np.uint8]:
    with ScanFrames(scan) as frames:
        depth, crc = frames.layout.format.bit_depth, frames.field("crc32")
        present = np.flatnonzero(frames.present())
        best: NDArray[Any] | None = None
        for index in present[:: max(len(present) // 5, 1)].tolist():
            pixels = frames.pixels(index, int(crc[index]))
            if pixels is not None:
                grey = to_grey(pixels, depth)
                best = grey.copy() if best is None else np.maximum(best, grey)
    assert best is not None
    scale = 255 / max(float(np.percentile(best, 99)), 1.0)
    return np.asarray(np.clip(best * scale, 0, 255), dtype=np.uint8)


def _text(canvas: NDArray[Any], text: str, place: tuple[int, int], colour: tuple[int, int, int]) -> None:
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.55, 1)
    x, y = place
    cv2.rectangle(canvas, (x - 2, y - height - 3), (x + width + 2, y + below), (0, 0, 0), -1)
    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, colour, 1, cv2.LINE_AA)


def _draw_plane(canvas: NDArray[Any], plane: ReferencePlane, colour: tuple[int, int, int], zoom: int) -> None:
    left, right, top, bottom = (value * zoom for value in plane.region)
    cv2.rectangle(canvas, (left, top), (right + zoom, bottom + zoom), colour, 2, cv2.LINE_AA)
    # fonts of OpenCV know ASCII only
    name = plane.name.encode("ascii", "replace").decode()
    _text(canvas, f"{name}: corners miss by {plane.misfit_px:.2f} px", (left + 6, bottom - 8), colour)
    corners = np.round((plane.corners_px + 0.5) * zoom).astype(np.int32)
    cv2.polylines(canvas, [corners.reshape(-1, 1, 2)], True, colour, 1, cv2.LINE_AA)
    width, height = plane.rectangle_mm
    for number, (x, y) in enumerate(corners.tolist(), start=1):
        cv2.circle(canvas, (x, y), 5, colour, 2, cv2.LINE_AA)
        _text(canvas, str(number), (x + 8, y - 6), colour)
    for first, second, length in ((0, 1, width), (1, 2, height)):
        x, y = (corners[first] + corners[second]).tolist()
        _text(canvas, f"{length:g} mm", (x // 2 - 30, y // 2 - 6), colour)


def _draw_line(
    canvas: NDArray[Any], pixels: NDArray[np.float64], colour: tuple[int, int, int], zoom: int, name: str
) -> None:
    for x, y in np.round((pixels + 0.5) * zoom).astype(int).tolist():
        cv2.circle(canvas, (x, y), 1, colour, -1, cv2.LINE_AA)
    x, y = np.round((pixels[int(pixels[:, 1].argmin())] + 0.5) * zoom).astype(int).tolist()
    _text(canvas, name, (x + 4, y + 14), (255, 255, 255))


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write it as PNG, in one step.

    Raises:
        CalibrationError: it cannot be written.
    """
    try:
        replace_file(path, cv2.imencode(".png", picture)[1].tobytes())
    except OSError as error:
        raise CalibrationError(f"cannot write {path}: {error.strerror}") from None
