"""Our camera calibration beside OpenCV's on folders of board views.

``python -m tests.accuracy.public_boards DIR... --squares 10x7``

A line for ours; one for each of OpenCV's detectors with cv2.calibrateCamera (five distortion terms), as its tutorials
do it; and one for OpenCV's solver on our corners, which tells corners from distortion models. OpenCV leaves out no view
that its detector found.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board
from process.calibration.camera.calibrate import calibrate_camera
from tui.commands.calibrate.camera import read_pictures

_SUBPIX = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 1e-3)


def opencv_corners(grey: np.ndarray, grid: tuple[int, int], detector: str) -> np.ndarray | None:
    """Corners [n, 1, 2] float32 by OpenCV's ``classic`` detector (with cornerSubPix) or its ``sector`` detector."""
    if detector == "sector":
        found, corners = cv2.findChessboardCornersSB(grey, grid, flags=cv2.CALIB_CB_ACCURACY)
        return corners if found else None
    found, corners = cv2.findChessboardCorners(grey, grid)
    return cv2.cornerSubPix(grey, corners, (11, 11), (-1, -1), _SUBPIX) if found else None


def solved(objects: list[np.ndarray], pixels: list[np.ndarray], size: tuple[int, int]) -> str:
    """Views, RMS and focal length of cv2.calibrateCamera as text."""
    if len(pixels) < 3:
        return f"{len(pixels)} views: too few"
    rms_px, matrix = cv2.calibrateCamera(objects, pixels, size, None, None)[:2]
    return f"{len(pixels)} views, {rms_px:.4f} px RMS, f {matrix[0, 0]:.1f}"


def compare(folder: Path, board: Board, corners: str) -> None:
    """Print the comparison of one folder."""
    pictures = read_pictures((folder,)).pictures
    size = pictures[0][1].shape[::-1]
    print(f"{folder.name}: {len(pictures)} pictures of {size[0]} x {size[1]}")
    began_s = time.monotonic()
    try:
        result = calibrate_camera(pictures, board, corners=corners)
    except CalibrationError as error:
        print(f"  ours: {error}", flush=True)
    else:
        print(
            f"  ours: {len(result.used)} views, {result.fit.rms_px:.4f} px RMS, f {result.fit.intrinsics[0]:.1f} "
            f"({result.corner_estimate}; {result.fit.model}; {time.monotonic() - began_s:.0f} s)"
        )
        for text in [f"left out {view.name}: {view.reason}" for view in result.views if view.reason]:
            print(f"    {text}")
        objects = [view.object_mm.astype(np.float32) for view in result.used]
        ours = [view.pixels.astype(np.float32).reshape(-1, 1, 2) for view in result.used]
        print("  OpenCV's solver on our corners:", solved(objects, ours, size), flush=True)
    x, y = np.meshgrid(np.arange(board.grid[0]), np.arange(board.grid[1]))
    whole = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float32) * board.pitch_mm
    for detector in ("classic", "sector"):
        tried = [opencv_corners(grey, board.grid, detector) for _, grey in pictures]
        found = [one for one in tried if one is not None]
        print(f"  OpenCV, {detector} detector:", solved([whole] * len(found), found, size), flush=True)


def main() -> None:
    """Compare each folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--squares", required=True, help="squares of the board, as 10x7")
    parser.add_argument("--corners", default="auto")
    options = parser.parse_args()
    columns, rows = (int(part) for part in options.squares.split("x"))
    for folder in options.folders:
        compare(folder, Board(max(columns, rows), min(columns, rows), 25.0), options.corners)


if __name__ == "__main__":
    main()
