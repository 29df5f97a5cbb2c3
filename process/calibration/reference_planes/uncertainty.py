"""Uncertainty of planes from reference planes, by source: the lines, the clicks on the markers, the camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError

from .calibrate import Edges, planes_of, scene_of
from .frame_planes import FramePlane
from .known_planes import Marked, plane_from_markers
from .result import PlaneSd, ReferenceResult

F8 = NDArray[np.float64]
FRAMES = 24
"""Frames by which the effect of a change is judged: enough for the common light point."""
LEAST_SHARE = 1e-9
"""Axes of the covariance with a smaller share of its largest variance are skipped."""
CLICK_PX = 0.1
"""Markers are not clicked better than this, however well four of them fit."""
CAMERA = "the camera's uncertainty"
MARKERS = "the clicks on the markers"
LINES = "the lines' disagreement"


def spread_of(
    edges: Edges, marked: Sequence[Marked], camera: CameraModel, covariance: F8 | None, result: ReferenceResult
) -> tuple[PlaneSd, ...]:
    """Standard deviations of a plane's distance at the middle of the scene in mm, and of its direction in degrees.

    Args:
        edges: of all frames.
        marked: the reference planes' file.
        camera: the camera.
        covariance: [15, 15] of its intrinsics and world, of which only the intrinsics act here; None: not known.
        result: the planes that were found.
    """
    shown = [plane.t for plane in result.planes if plane.skew_mm is not None]
    some = {t: edges[t] for t in shown[:: max(len(shown) // FRAMES, 1)]}

    def planes(model: CameraModel, places: Sequence[Marked]) -> dict[int, FramePlane]:
        return planes_of(some, [plane_from_markers(one, model) for one in places], model).planes

    middle = scene_of(result.known, camera).middle
    nominal = planes(camera, marked)
    judge = _Judge(nominal, middle)
    found = [_by_lines(result, middle)]
    found.append(judge.sd(MARKERS, [_attempt(planes, camera, moved) for moved in _clicks(marked, result)]))
    if covariance is not None:
        values, vectors = np.linalg.eigh(covariance[:9, :9])
        steps = [
            np.sqrt(value) * axis
            for value, axis in zip(values, vectors.T, strict=True)
            if value > LEAST_SHARE * values[-1]
        ]
        found.append(judge.sd(CAMERA, [_attempt(planes, _moved(camera, step), marked) for step in steps]))
    return tuple(found)


class _Judge:
    """Root sum of squares over independent changes, mean over frames."""

    def __init__(self, nominal: dict[int, FramePlane], middle: F8) -> None:
        self._nominal, self._middle = nominal, middle

    def sd(self, source: str, changed: Sequence[dict[int, FramePlane]]) -> PlaneSd:
        squares = {t: np.zeros(2) for t in self._nominal}
        for planes in changed:
            for t, plane in planes.items():
                if t in squares:
                    squares[t] += _change(self._nominal[t], plane, self._middle) ** 2
        rms = np.sqrt(np.mean(list(squares.values()), axis=0))
        return PlaneSd(source, float(rms[0]), float(rms[1]))


def _attempt(
    planes: Callable[[CameraModel, Sequence[Marked]], dict[int, FramePlane]],
    camera: CameraModel,
    marked: Sequence[Marked],
) -> dict[int, FramePlane]:
    """Planes for a change; none where it makes the planes impossible (its effect is then not counted)."""
    try:
        return planes(camera, marked)
    except CalibrationError:
        return {}


def _clicks(marked: Sequence[Marked], result: ReferenceResult) -> list[list[Marked]]:
    """The markers with each coordinate moved by its standard deviation: 8 coordinates determine 6 of a pose."""
    found = []
    for index, one in enumerate(marked):
        sd = max(result.known[index].misfit_px * np.sqrt(4 / 2), CLICK_PX)
        for place in np.ndindex(4, 2):
            corners = one.corners_px.copy()
            corners[place] += sd
            found.append([*marked[:index], replace(one, corners_px=corners), *marked[index + 1 :]])
    return found


def _by_lines(result: ReferenceResult, middle: F8) -> PlaneSd:
    """By the scatter of lines, made larger by how far the two lines of a frame miss each other."""
    two = [plane for plane in result.planes if plane.skew_mm is not None and plane.covariance is not None]
    skew = float(np.sqrt(np.mean(result.skew_mm**2)))
    spread = np.mean([plane.covariance for plane in two if plane.covariance is not None], axis=0)
    own = float(np.sqrt(spread[0, 0]))
    turn = float(np.degrees(np.sqrt(np.linalg.eigvalsh(spread[1:, 1:])[-1])))
    # each line is off by half the skew; a plane that is tilted by it between both
    share = max(skew / 2 / max(own, 1e-9), 1.0)
    return PlaneSd(LINES, own * share, turn * share)


def _moved(camera: CameraModel, step: F8) -> CameraModel:
    (fx, skew, cx), (_, fy, cy), _ = camera.K
    matrix = ((fx + step[0], skew, cx + step[2]), (0.0, fy + step[1], cy + step[3]), (0.0, 0.0, 1.0))
    k1, k2, p1, p2, k3 = (value + change for value, change in zip(camera.distortion, step[4:], strict=True))
    return CameraModel(
        width=camera.width, height=camera.height, K=matrix, R=camera.R, T=camera.T, distortion=(k1, k2, p1, p2, k3),
        mirrored=camera.mirrored,
    )  # fmt: skip


def _change(before: FramePlane, after: FramePlane, middle: F8) -> F8:
    """[2]: change of the distance in mm at the foot of ``middle``, and of the direction in degrees."""
    foot = middle - (before.normal @ middle - before.offset) * before.normal
    angle = np.degrees(np.arccos(min(abs(float(before.normal @ after.normal)), 1.0)))
    return np.array([after.normal @ foot - after.offset, angle])
