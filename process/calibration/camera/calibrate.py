"""Camera calibration from pictures of a board: intrinsics, pose of the stage, uncertainty, and its limits as notes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import (
    Board,
    BoardNotFoundError,
    LargerBoardError,
    Sighting,
    find_board,
    settled,
)
from process.calibration.board.poses import PlanePose, find_pose, project

from .bundle import NAMES, CameraFit, as_vector, joint_covariance
from .plausible import plausibility_notes, refuse_impossible, refuse_smaller_board
from .selection import MIN_VIEWS, choose_corners, choose_model, harmful_view

F8 = NDArray[np.float64]
MIN_TILT_SPREAD_DEG = 3.0
"""Least difference between the tilts of the views: parallel views say nothing about the focal length."""
LITTLE_COVERAGE = 0.5
VOLUME_HALF_HEIGHT_MM = 0.5
DRAWS = 40
MOST_CHOICES = 3
"""How often corners, distortion model and views are chosen anew by what the other choices gave."""


@dataclass(frozen=True)
class BoardView:
    """A picture and how it was used."""

    name: str
    sighting: Sighting | None
    reason: str = ""
    """Why it was left out; empty if it was used."""
    larger: bool = False
    """True if the picture shows a board of more squares than given."""
    corners: str = ""
    """Estimate of the corners that was used; empty if the view was left out."""
    rms_px: float = float("nan")
    tilt_deg: float = float("nan")


@dataclass(frozen=True)
class CameraResult:
    """A calibrated camera."""

    size: tuple[int, int]
    board: Board
    fit: CameraFit
    used: tuple[Sighting, ...]
    views: tuple[BoardView, ...]
    stage: PlanePose | None
    """Pose of the board lying flat, which defines the world. None: the world is the camera's own frame."""
    corner_estimate: str
    held_out_px: dict[str, float]
    coverage: float
    """Share of the field that the used corners span."""
    predicted_um: tuple[float, float]
    """Predicted error at the corners of the field: at z = 0 and half a millimetre above (standard deviations)."""
    stage_sighting: Sighting | None = None
    """The corners of the stage view."""
    notes: tuple[str, ...] = field(default=())

    @property
    def covariance(self) -> F8:
        """Covariance [15, 15] of the intrinsics and the world's pose (rotation vector, translation)."""
        if self.stage is not None and self.stage_sighting is not None:
            return joint_covariance(self.fit, self.stage_sighting, as_vector(self.stage))
        found = np.zeros((15, 15))
        found[:9, :9] = self.fit.covariance
        return found

    @property
    def sd(self) -> dict[str, float]:
        """Standard deviations of the intrinsics."""
        return dict(zip(NAMES, np.sqrt(np.diag(self.fit.covariance)).tolist(), strict=True))

    def lines(self) -> list[str]:
        """The result as lines of text."""
        fit, sd = self.fit, self.sd
        fx, fy, cx, cy = fit.intrinsics[:4]
        terms = ", ".join(
            f"{name} = {value:.4g} +- {sd[name]:.2g}"
            for name, value in zip(("k1", "k2", "p1", "p2", "k3"), fit.distortion, strict=True)
            if sd[name] > 0
        )
        lines = [f"left out {view.name}: {view.reason}" for view in self.views if view.reason]
        lines += [
            f"{len(self.used)} of {len(self.views)} views, reprojection error {fit.rms_px:.4f} px RMS "
            f"(corners by the {self.corner_estimate} estimate)",
            f"fx = {fx:.2f} +- {sd['fx']:.2f}, fy = {fy:.2f} +- {sd['fy']:.2f}, "
            f"cx = {cx:.2f} +- {sd['cx']:.2f}, cy = {cy:.2f} +- {sd['cy']:.2f} px",
            f"distortion: {terms or 'none'} (chosen by held-out views: "
            + ", ".join(f"{model} {error:.4f}" for model, error in self.held_out_px.items())
            + " px)",
        ]
        if self.board.dictionary:
            old = ", layout before OpenCV 4.6" if self.board.legacy_layout else ""
            lines.append(f"markers of {self.board.dictionary}{old}")
        if self.stage is None:
            lines.append("note: no --stage view: the world is the camera's own frame")
        return lines + [f"note: {note}" for note in self.notes]

    def document(self) -> dict[str, Any]:
        """The ``camera`` object of calibration.json, with its quality."""
        rotation = np.eye(3) if self.stage is None else self.stage.rotation
        translation = np.zeros(3) if self.stage is None else self.stage.translation
        return {
            "width": self.size[0],
            "height": self.size[1],
            "K": self.fit.matrix.tolist(),
            "distortion": self.fit.distortion.tolist(),
            "R": rotation.tolist(),
            "T": translation.tolist(),
            "quality": {
                "rms_px": self.fit.rms_px,
                "sd": self.sd,
                "covariance": self.covariance.tolist(),
                "model": self.fit.model,
                "held_out_px": self.held_out_px,
                "corner_estimate": self.corner_estimate,
                "board": self.board.facts(),
                "coverage": self.coverage,
                "predicted_um": {"at_z0": self.predicted_um[0], "at_half_mm": self.predicted_um[1]},
                "views": [
                    {
                        "name": v.name,
                        "used": not v.reason,
                        "reason": v.reason,
                        "rms_px": _number(v.rms_px),
                        "corners": v.corners,
                    }
                    for v in self.views
                ],
                "notes": list(self.notes),
            },
        }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def calibrate_camera(
    pictures: Sequence[tuple[str, NDArray[np.generic]]],
    board: Board,
    stage: str | None = None,
    corners: str = "auto",
    progress: Callable[[str], None] = lambda _line: None,
) -> CameraResult:
    """Calibrate the camera from named pictures of the board.

    Args:
        pictures: (name, grey or RGB pixels), all of one size.
        board: the pattern.
        stage: name of the picture with the board lying flat on the stage: z = 0, origin in the middle of the pattern.
        corners: estimate of the corners: saddle, sector, gradient, or auto (the best one, or the mean of two).
        progress: called with a line of text after each picture, and before the fit.

    Raises:
        CalibrationError: fewer than three usable views, parallel views, different sizes, or a stage view that cannot
            define the world.
    """
    size = _common_size(pictures)
    if stage is not None and stage not in [name for name, _ in pictures]:
        raise CalibrationError(f"the stage view {stage} is not among the pictures: name one of them")
    board = settled(board, (pixels for _, pixels in pictures))
    found = []
    for index, (name, pixels) in enumerate(pictures):
        found.append(_view(name, pixels, board))
        seen = found[-1].sighting
        outcome = found[-1].reason if seen is None else f"{len(seen.pixels)} corners"
        progress(f"picture {index + 1} of {len(pictures)}, {name}: {outcome}")
    good = [view for view in found if view.sighting is not None]
    if not good:
        raise CalibrationError(f"the board was found in none of {len(found)} pictures: {found[0].reason}")
    _enough(len(good), found)
    progress(f"fitting the camera to {len(good)} views")
    _same_board(found, good, size, board)
    solved = _solve(good, size, corners, stage)
    fit, held_out, sightings, estimate = solved.fit, solved.held_out_px, solved.sightings, solved.estimate
    names = solved.names
    _not_parallel(fit)
    refuse_impossible(fit, size)
    views = [_account(view, solved) for view in found]
    pose = None if stage is None else _stage_pose(stage, names, sightings, found, fit)
    coverage = _coverage(sightings, size)
    predicted = _predicted_um(fit, size, sightings[names.index(stage)] if stage in names else sightings[0])
    return CameraResult(
        size, board, fit, tuple(sightings), tuple(views), pose, estimate, held_out, coverage, predicted,
        sightings[names.index(stage)] if stage in names else None,
        (
            *_corner_notes(views, estimate, corners),
            *plausibility_notes(fit, size),
            *_notes(fit, size, coverage, predicted, sightings, world=stage is not None),
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class _Solved:
    fit: CameraFit
    held_out_px: dict[str, float]
    sightings: list[Sighting]
    estimate: str
    names: list[str]
    """Names of the views that were used."""
    dropped: dict[str, str]
    """Reasons of views that were left out of the fit."""


def _solve(good: Sequence[BoardView], size: tuple[int, int], corners: str, stage: str | None) -> _Solved:
    """The camera from the views that have a board; corners, distortion model and views that are left out settled.

    The estimate of the corners is chosen with the model and the views of the final fit: each choice is made again until
    it stays.
    """
    names, seen, dropped = [v.name for v in good], [v.sighting for v in good if v.sighting is not None], {}
    model = "k1"
    for _ in range(MOST_CHOICES):
        count = len(seen)
        sightings, estimate = choose_corners(seen, size, corners, model)
        fit, held_out = choose_model(sightings, size)
        while (harm := harmful_view(sightings, fit, names.index(stage) if stage in names else None)) is not None:
            index, reason = harm
            dropped[names[index]] = reason
            if len(names) - 1 < MIN_VIEWS:
                raise CalibrationError(
                    f"too few views: without {names[index]} only {len(names) - 1} are left; {reason}"
                )
            del seen[index], names[index], sightings[index]
            fit, held_out = choose_model(sightings, size)
        if corners != "auto" or (fit.model == model and len(seen) == count):
            break
        model = fit.model
    return _Solved(fit, held_out, sightings, estimate, names, dropped)


def _same_board(found: Sequence[BoardView], good: Sequence[BoardView], size: tuple[int, int], board: Board) -> None:
    """Refuse another board than the one given: a larger one in as many pictures as it was found in, or a smaller one.

    Raises:
        CalibrationError: see above.
    """
    sightings = [view.sighting for view in good if view.sighting is not None]
    larger = [view for view in found if view.larger]
    if larger and len(larger) >= len(good) and not any(view.whole for view in sightings):
        raise CalibrationError(f"in {len(larger)} of {len(found)} pictures {larger[0].reason}")
    refuse_smaller_board(sightings, size, board)


def _corner_notes(views: Sequence[BoardView], estimate: str, wanted: str) -> list[str]:
    """Views whose corners were located otherwise than those of most, or than asked for."""
    others: dict[str, list[str]] = {}
    for view in views:
        if view.corners and view.corners != (estimate if wanted == "auto" else wanted):
            others.setdefault(view.corners, []).append(view.name)
    return [
        f"corners by the {name} estimate in {len(names)} views, which have no other (a part of the board, or dots): "
        + ", ".join(names)
        for name, names in others.items()
    ]


def _common_size(pictures: Sequence[tuple[str, NDArray[np.generic]]]) -> tuple[int, int]:
    if not pictures:
        raise CalibrationError("no pictures were given: name some of the board in different tilts")
    height, width = pictures[0][1].shape[:2]
    for name, pixels in pictures:
        if pixels.shape[:2] != (height, width):
            raise CalibrationError(
                f"{name} has {pixels.shape[1]} x {pixels.shape[0]} pixels, {pictures[0][0]} {width} x {height}: "
                "take all of them with one camera setting"
            )
    return width, height


def _view(name: str, pixels: NDArray[np.generic], board: Board) -> BoardView:
    try:
        return BoardView(name, find_board(pixels, board))
    except BoardNotFoundError as error:
        return BoardView(name, None, str(error), isinstance(error, LargerBoardError))


def _enough(count: int, found: Sequence[BoardView]) -> None:
    if count >= MIN_VIEWS:
        return
    why = next((f"; {view.name}: {view.reason}" for view in found if view.reason), "")
    raise CalibrationError(f"too few views: the board was found in {count} of {len(found)}, it takes {MIN_VIEWS}{why}")


def _not_parallel(fit: CameraFit) -> None:
    normals = np.array([np.asarray(cv2.Rodrigues(pose[:3])[0])[:, 2] for pose in fit.poses])
    spread = np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1)).max())
    if spread < MIN_TILT_SPREAD_DEG:
        raise CalibrationError(
            f"all views are parallel (tilts differ by {spread:.1f} degrees): the focal length cannot be told; "
            "tilt the board by 10 to 30 degrees in several directions"
        )


def _account(view: BoardView, solved: _Solved) -> BoardView:
    if view.name not in solved.names:
        return replace(view, reason=solved.dropped.get(view.name, view.reason))
    index, fit = solved.names.index(view.name), solved.fit
    normal = np.asarray(cv2.Rodrigues(fit.poses[index][:3])[0])[:, 2]
    tilt = float(np.degrees(np.arccos(min(abs(float(normal[2])), 1.0))))
    return replace(
        view, corners=solved.sightings[index].estimate, rms_px=fit.view_rms_px[index], tilt_deg=tilt, reason=""
    )


def _stage_pose(
    stage: str, names: Sequence[str], sightings: Sequence[Sighting], found: Sequence[BoardView], fit: CameraFit
) -> PlanePose:
    if stage not in names:
        reason = next(view.reason for view in found if view.name == stage)
        raise CalibrationError(f"the stage view {stage} cannot carry the world: {reason}")
    view = sightings[names.index(stage)]
    if not view.whole:
        raise CalibrationError(f"the stage view {stage} shows only part of the board: its middle is the world's origin")
    pose = find_pose(view.object_mm, view.pixels, fit.matrix, fit.distortion)
    if pose.ambiguous:
        raise CalibrationError(
            f"the stage view {stage} has two poses that explain it nearly equally ({pose.rms_px:.3f} and "
            f"{pose.mirrored_rms_px:.3f} px): use a larger board or a sharper picture"
        )
    return pose


def _coverage(sightings: Sequence[Sighting], size: tuple[int, int]) -> float:
    points = np.concatenate([view.pixels for view in sightings]).astype(np.float32)
    return float(cv2.contourArea(cv2.convexHull(points.reshape(-1, 1, 2)))) / (size[0] * size[1])


def _predicted_um(fit: CameraFit, size: tuple[int, int], view: Sighting) -> tuple[float, float]:
    """Standard deviation in um of a point at a corner of the field, on the board's plane and above it.

    Monte Carlo: random cameras of the fitted covariance, each with the pose in which it sees the board's corners where
    they were.
    """
    nominal = find_pose(view.object_mm, view.pixels, fit.matrix, fit.distortion)
    seen = project(view.object_mm, nominal.rotation_vector, nominal.translation, fit.matrix, fit.distortion)
    corners = np.array([[x, y] for x in (0.0, size[0] - 1.0) for y in (0.0, size[1] - 1.0)])
    reference = _on_plane(corners, nominal, fit.matrix, fit.distortion)
    values, vectors = np.linalg.eigh(fit.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    generator, errors = np.random.default_rng(1), []
    for _ in range(DRAWS):
        drawn = fit.intrinsics + root @ generator.normal(size=9)
        other = CameraFit(drawn, (), fit.covariance, 0.0, (), fit.model)
        pose = find_pose(view.object_mm, seen, other.matrix, other.distortion)
        errors.append(_on_plane(corners, pose, other.matrix, other.distortion) - reference)
    spread = np.sqrt((np.array(errors)[..., :2] ** 2).sum(axis=-1).mean(axis=0)).max(axis=0)
    return float(spread[0]) * 1000, float(spread[1]) * 1000


def _on_plane(pixels: F8, pose: PlanePose, matrix: F8, distortion: F8) -> F8:
    """Points [n, 2, 3] where rays meet z = 0 and z = VOLUME_HALF_HEIGHT_MM of the board."""
    flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2)
    rays = np.column_stack([flat, np.ones(len(flat))]) @ pose.rotation
    centre = -pose.rotation.T @ pose.translation
    heights = (0.0, np.sign(centre[2]) * VOLUME_HALF_HEIGHT_MM)
    return np.stack([centre + ((height - centre[2]) / rays[:, 2])[:, None] * rays for height in heights], axis=1)


def _notes(
    fit: CameraFit, size: tuple[int, int], coverage: float, predicted: tuple[float, float],
    sightings: Sequence[Sighting], *, world: bool,
) -> tuple[str, ...]:  # fmt: skip
    sd = np.sqrt(np.diag(fit.covariance))
    notes = []
    if sd[0] / fit.intrinsics[0] > 2e-3 and fit.intrinsics[0] > 4 * size[0]:
        distance = float(np.median([pose[5] for pose in fit.poses]))
        notes.append(
            f"focal length and distance can hardly be told apart (nearly telecentric): f is {fit.intrinsics[0]:.0f} "
            f"+- {sd[0]:.0f} px at {distance:.1f} mm; points in the volume near the board stay right"
        )
    if max(sd[2], sd[3]) > 0.01 * size[0]:
        notes.append(
            f"the principal point is known to +- {max(sd[2], sd[3]):.0f} px only; it trades against tilt, "
            "and points near the board stay right"
        )
    widest = max(float(np.ptp(v.pixels[:, 0]) * np.ptp(v.pixels[:, 1])) for v in sightings) / (size[0] * size[1])
    if widest < LITTLE_COVERAGE and world:
        notes.append(
            f"the board fills {100 * widest:.0f} % of the field at most: predicted error at the corners of the field "
            f"{predicted[0]:.1f} um on the board's plane, {predicted[1]:.1f} um half a millimetre above"
        )
    if coverage < LITTLE_COVERAGE:
        notes.append(f"all views together cover {100 * coverage:.0f} % of the field: move the board about")
    if fit.rms_px > 0.3:
        notes.append(f"the corners miss by {fit.rms_px:.2f} px: blurred pictures, or a board that is not flat")
    return tuple(notes)
