"""The recipe of a light plane: which sweeps it was made from, so that it can be made again with another estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from acquire.contract.calibration import CameraModel, parse_calibration
from acquire.contract.errors import CalibrationError, ScanFileError
from process.calibration.board.detection import Board
from process.calibration.camera.bundle import NAMES

from .from_sweeps import PlaneResult, fit_plane
from .surfaces import Surface, board_surface, flat_surface
from .sweeps import FoldedSweep, fold_sweep
from .uncertainty import camera_covariance

Progress = Callable[[str], None]
BEFORE = "before_sweeps"
"""Key in calibration.json of the camera as its own views give it."""
REFINED = ("K", "distortion", "R", "T")
"""Parts of the camera that sweeps over boards refine."""


class SweepRecipe(msgspec.Struct, frozen=True):
    """Sweeps and options of a light plane; kept in calibration.json."""

    scans: tuple[str, ...]
    """Absolute paths of the sweeps over the board."""
    columns: int
    rows: int
    square_mm: float
    flats: tuple[str, ...] = ()
    """Absolute paths of the sweeps over a white flat."""
    edge: Literal["rising", "falling"] = "rising"
    contrast: int | None = None

    @property
    def board(self) -> Board:
        """The board seen in ``scans``."""
        return Board(self.columns, self.rows, self.square_mm)


@dataclass(frozen=True)
class RefittedPlane:
    """A light plane made again."""

    document: dict[str, Any]
    result: PlaneResult


def make_plane(
    recipe: SweepRecipe, document: dict[str, Any], method: str, progress: Progress | None = None
) -> PlaneResult:
    """Make the light plane from the recipe's sweeps, with the camera of ``document``.

    Raises:
        CalibrationError, ScanFileError: as ``fold_sweep``, ``board_surface`` and ``fit_plane``.
    """
    document = with_original_camera(document)
    camera = parse_calibration(msgspec.json.encode(document).decode()).camera
    surfaces: list[Surface] = []
    for number, scan in enumerate((*recipe.scans, *recipe.flats)):
        if progress is not None:
            progress(scan)
        sweep = fold_sweep(Path(scan), method=method, edge=recipe.edge, contrast=recipe.contrast)
        _same_size(sweep, camera)
        on_board = number < len(recipe.scans)
        surfaces.append(board_surface(sweep, recipe.board, camera, alone=False) if on_board else flat_surface(sweep))
    return fit_plane(surfaces, camera, edge=recipe.edge, method=method, known_camera=camera_covariance(document))


def _same_size(sweep: FoldedSweep, camera: CameraModel) -> None:
    seen, wanted = (sweep.format.width, sweep.format.height), (camera.width, camera.height)
    if seen != wanted:
        raise CalibrationError(
            f"{sweep.name} has {seen[0]} x {seen[1]} pixels, the camera was calibrated at {wanted[0]} x {wanted[1]}: "
            "calibrate the camera at the size of the sweeps"
        )


def with_plane(document: dict[str, Any], result: PlaneResult, recipe: SweepRecipe, days: float) -> dict[str, Any]:
    """The calibration with this light plane, its recipe, and the camera as its sweeps refined it."""
    document, plane = with_original_camera(document), result.document()
    plane["quality"]["recipe"] = msgspec.to_builtins(recipe)
    made = {**document, "light_plane": plane, "valid_for": result.validity(days)}
    if camera_covariance(document) is None:
        return made
    quality = {**document["camera"]["quality"], "covariance": result.camera_covariance.tolist()}
    quality["sd"] = dict(zip(NAMES, np.sqrt(np.diag(result.camera_covariance)).tolist(), strict=False))
    own = {key: value for key, value in msgspec.to_builtins(result.camera).items() if key in REFINED}
    camera = {**document["camera"], **own, "quality": quality, BEFORE: document["camera"]}
    return {**made, "camera": camera}


def with_original_camera(document: dict[str, Any]) -> dict[str, Any]:
    """The calibration with the camera as its own views give it: sweeps must not refine it twice."""
    before = document.get("camera", {}).get(BEFORE)
    return document if not isinstance(before, dict) else {**document, "camera": before}


def recipe_in(document: dict[str, Any]) -> SweepRecipe | None:
    """Recipe of the light plane of a calibration; None where it has none."""
    quality = (document.get("light_plane") or {}).get("quality") or {}
    try:
        return msgspec.convert(quality["recipe"], SweepRecipe)
    except (KeyError, TypeError, msgspec.ValidationError):
        return None


def refit_plane(document: dict[str, Any], method: str, progress: Progress | None = None) -> RefittedPlane:
    """The calibration with its light plane made again from its own sweeps, with another estimate.

    A shift by ``rezero`` since then is applied again: it is kept beside the recipe.

    Raises:
        CalibrationError: it was not made from sweeps, they are gone, or they contradict each other now.
    """
    recipe = recipe_in(document)
    if recipe is None:
        raise CalibrationError("the calibration does not say which sweeps its light plane was made of")
    try:
        result = make_plane(recipe, document, method, progress)
    except ScanFileError as error:
        raise CalibrationError(f"a sweep that the light plane was made of is gone: {error}") from None
    if not result.ok:
        bad = next(surface for surface in result.surfaces if not surface.ok)
        raise CalibrationError(f"with {method}, {bad.name} contradicts the others: {bad.cause}")
    made = with_plane(document, result, recipe, 0.0)
    made["valid_for"] = document.get("valid_for")
    shift_t = float((document["light_plane"].get("quality") or {}).get("rezeroed_t") or 0.0)
    return RefittedPlane(rezeroed(made, shift_t) if shift_t else made, result)


def rezeroed(document: dict[str, Any], shift_t: float) -> dict[str, Any]:
    """The calibration with its light plane moved so that it passes ``shift_t`` later."""
    plane = dict(document["light_plane"])
    quality = dict(plane.get("quality") or {})
    quality["rezeroed_t"] = float(quality.get("rezeroed_t") or 0.0) + shift_t
    origin, velocity = plane["corner_origin_mm"], plane["corner_velocity_mm"]
    plane["corner_origin_mm"] = [at - shift_t * speed for at, speed in zip(origin, velocity, strict=True)]
    return {**document, "light_plane": {**plane, "quality": quality}}
