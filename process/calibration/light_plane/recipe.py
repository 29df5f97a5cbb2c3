"""Owns how a light plane is made from sweeps, so that it can be made again with another estimate of the crossings."""

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
"""Key of the camera as its own views have it."""
REFINED = ("K", "distortion", "R", "T")
"""What sweeps over boards tell of a camera beside its own views."""


class SweepRecipe(msgspec.Struct, frozen=True):
    """What a light plane was made of; kept in calibration.json."""

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
        """The board in ``scans``."""
        return Board(self.columns, self.rows, self.square_mm)


@dataclass(frozen=True)
class Refit:
    """A light plane made again."""

    document: dict[str, Any]
    result: PlaneResult


def make_plane(
    recipe: SweepRecipe, document: dict[str, Any], method: str, progress: Progress | None = None
) -> PlaneResult:
    """The light plane of the recipe's sweeps, with the camera of ``document``.

    Raises:
        CalibrationError, ScanFileError: as ``fold_sweep``, ``board_surface`` and ``fit_plane``.
    """
    document = as_before(document)
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
    """The calibration with this light plane, what it was made of, and the camera as its sweeps have it."""
    document, plane = as_before(document), result.document()
    plane["quality"]["recipe"] = msgspec.to_builtins(recipe)
    made = {**document, "light_plane": plane, "valid_for": result.validity(days)}
    if camera_covariance(document) is None:
        return made
    quality = {**document["camera"]["quality"], "covariance": result.camera_covariance.tolist()}
    quality["sd"] = dict(zip(NAMES, np.sqrt(np.diag(result.camera_covariance)).tolist(), strict=False))
    own = {key: value for key, value in msgspec.to_builtins(result.camera).items() if key in REFINED}
    camera = {**document["camera"], **own, "quality": quality, BEFORE: document["camera"]}
    return {**made, "camera": camera}


def as_before(document: dict[str, Any]) -> dict[str, Any]:
    """With the camera as it was before a light plane's sweeps had their say in it: they must not have it twice."""
    before = document.get("camera", {}).get(BEFORE)
    return document if not isinstance(before, dict) else {**document, "camera": before}


def recipe_in(document: dict[str, Any]) -> SweepRecipe | None:
    """What the light plane of a calibration was made of; None where it does not say."""
    quality = (document.get("light_plane") or {}).get("quality") or {}
    try:
        return msgspec.convert(quality["recipe"], SweepRecipe)
    except (KeyError, TypeError, msgspec.ValidationError):
        return None


def refit(document: dict[str, Any], method: str, progress: Progress | None = None) -> Refit:
    """The same calibration with its light plane made again from its own sweeps, with another estimate.

    What a ``rezero`` has moved since is moved again: the shift is kept beside the recipe.

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
    return Refit(rezeroed(made, shift_t) if shift_t else made, result)


def rezeroed(document: dict[str, Any], shift_t: float) -> dict[str, Any]:
    """The calibration with its light plane moved so that it comes ``shift_t`` later; everything else as it was."""
    plane = dict(document["light_plane"])
    quality = dict(plane.get("quality") or {})
    quality["rezeroed_t"] = float(quality.get("rezeroed_t") or 0.0) + shift_t
    origin, velocity = plane["corner_origin_mm"], plane["corner_velocity_mm"]
    plane["corner_origin_mm"] = [at - shift_t * speed for at, speed in zip(origin, velocity, strict=True)]
    return {**document, "light_plane": {**plane, "quality": quality}}
