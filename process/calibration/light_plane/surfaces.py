"""Known surfaces of calibration sweeps: a board in the pose of its corners, or a white flat of any height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board, Sighting, find_board
from process.calibration.board.poses import PlanePose, find_pose
from process.cloud.triangulation import Rays, rays

from .sweeps import FoldedSweep

F8 = NDArray[np.float64]
BLUR_WIDTHS = 3.0
BLUR_PX = 1.0
"""Width of the camera's blur in px: pixels within three of it from a printed edge see both squares."""
MOST_OF_SQUARE = 0.35
"""Most of a square that is left out at each side, however small the squares are."""
MOST_PIXELS = 120_000
"""Per surface; more are thinned out evenly."""
MIN_PIXELS = 300
FAR_SHARE = 0.05
"""A board whose distance from the camera differs by this share from that of z = 0 cannot be on this stage."""


@dataclass(frozen=True)
class Surface:
    """A known surface in the world: a plane through ``point`` with ``normal``."""

    sweep: FoldedSweep
    point: F8
    normal: F8
    pixels: NDArray[np.intp]
    """[n] flat indices of the pixels to use."""
    free_height: bool = False
    """True for a matt white flat parallel to z = 0, whose height is estimated."""
    sighting: Sighting | None = None
    """The board's corners; None for a flat."""
    pose: PlanePose | None = None
    """Pose of the board in camera coordinates; None for a flat."""


def board_surface(sweep: FoldedSweep, board: Board, camera: CameraModel, *, alone: bool = True) -> Surface:
    """The board in the pose of its own corners in this sweep, and its pixels clear of printed edges.

    Args:
        sweep: over the board.
        board: the pattern.
        camera: with its pose in the world.
        alone: only the corners tell its pose from the mirrored one, so an ambiguous pose is refused.

    Raises:
        CalibrationError: board not found, its pose ambiguous, or too few clean pixels.
    """
    try:
        sighting = find_board(sweep.picture, board)
    except CalibrationError as error:
        raise CalibrationError(f"{sweep.name}: {error}") from None
    matrix, distortion = np.array(camera.K), np.array(camera.distortion)
    pose = find_pose(sighting.object_mm, sighting.pixels, matrix, distortion)
    if alone and pose.ambiguous:
        raise CalibrationError(f"{sweep.name}: two poses of the board explain it nearly equally; tilt it more")
    _refuse_far(sweep.name, pose, camera, board)
    to_world = np.array(camera.R).T
    rotation = to_world @ pose.rotation
    point = to_world @ (pose.translation - np.array(camera.T))
    view = rays(camera)
    at = (meet(view, point, rotation[:, 2], None) - point) @ rotation[:, :2]
    margin = min(BLUR_WIDTHS * BLUR_PX / sighting.pitch_px, MOST_OF_SQUARE)
    cells = (at - sighting.board_mm.min(axis=0)) / board.pitch_mm
    extent = np.ptp(sighting.board_mm, axis=0) / board.pitch_mm
    inside = ((cells > -1 + margin) & (cells < extent + 1 - margin)).all(axis=1)
    clear = (np.abs(cells - np.rint(cells)) > margin).all(axis=1)
    return Surface(sweep, point, rotation[:, 2], _chosen(sweep, inside & clear), sighting=sighting, pose=pose)


def _refuse_far(name: str, pose: PlanePose, camera: CameraModel, board: Board) -> None:
    """Refuse a board that seems nearer or further than the stage: one of another size."""
    distance, wanted = float(pose.translation[2]), camera.T[2]
    if wanted > 0 and abs(distance / wanted - 1) > FAR_SHARE:
        fitting = board.pitch_mm * wanted / distance
        raise CalibrationError(
            f"{name}: with squares of {board.pitch_mm:g} mm the board would be {distance:.1f} mm from the camera, and "
            f"the stage is at {wanted:.1f} mm: a board of another size (--square-mm; {fitting:.4g} "
            "would fit), or the camera was moved since it was calibrated"
        )


def flat_surface(sweep: FoldedSweep) -> Surface:
    """A matt white flat parallel to z = 0 of unknown height."""
    everywhere = np.ones(sweep.crossing.size, dtype=np.bool_)
    return Surface(sweep, np.zeros(3), np.array([0.0, 0.0, 1.0]), _chosen(sweep, everywhere), free_height=True)


def _chosen(sweep: FoldedSweep, allowed: NDArray[np.bool_]) -> NDArray[np.intp]:
    pixels = np.flatnonzero(allowed & np.isfinite(sweep.crossing.ravel()))
    if len(pixels) < MIN_PIXELS:
        raise CalibrationError(
            f"{sweep.name}: only {len(pixels)} clean pixels on the surface; {MIN_PIXELS} are needed: sweep all of it"
        )
    return pixels[:: max(len(pixels) // MOST_PIXELS, 1)]


def meet(view: Rays, point: F8, normal: F8, pixels: NDArray[np.intp] | None) -> F8:
    """Points [n, 3] mm where the rays of ``pixels`` (None: all) meet the plane through ``point`` (equation 4)."""
    directions = view.directions if pixels is None else view.directions[pixels]
    distance = (normal @ (point - view.centre_mm)) / (directions @ normal)
    return np.asarray(view.centre_mm + distance[:, None] * directions, dtype=np.float64)
