"""One light plane per frame, from the lines in which its edge crosses two known planes: for hand-swept rigs, shadows.

The classic method that the paper cites ([8]) and could not use for want of depth of focus. Lengths in mm; t is the
1-based frame number. Lines come from each picture itself, where it crosses half brightness of each pixel; from the
crossings where these tell the line better. A frame with one line gets its plane with the point that all planes share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.calibration.light_plane import robust
from process.cloud.triangulation import rays

from .edge_lines import (
    EdgeLine,
    EdgePoints,
    better,
    edge_by_crossings,
    edge_in_picture,
    lag_px,
    line_on_plane,
    meet,
    pushed,
    smoothed,
)
from .frame_planes import (
    LEAST_ANGLE_DEG,
    LEAST_JUMP,
    MOST_BRIDGED,
    MOST_SKEW,
    ODD_SIGMAS,
    ODD_SKEW,
    FramePlane,
    Scene,
    between,
    bridged,
    jumping,
    line_angle_deg,
    off_at,
    plane_of_lines,
    with_light,
)
from .known_planes import ReferencePlane
from .light_point import LightPoint, find_light_point
from .result import ReferenceResult
from .sweep_pictures import Progress, Region, SweepPictures

F8 = NDArray[np.float64]
Edges = dict[int, tuple[EdgePoints | None, EdgePoints | None]]
"""By t: the edge on both planes; frames without a picture are not there."""
Planes = dict[int, FramePlane]
LEAST_LAGS = 5
"""Frames that must tell how far lines and crossings are apart."""
MOST_LAG_PX = 3.0
"""A larger distance is no matter of levels: the crossings are not trusted then."""
LEAST_GOOD = 0.5
"""If fewer of the frames with two lines give a plane, the planes' file is wrong, not the frames."""


@dataclass(frozen=True)
class FoundPlanes:
    """Planes by t, reasons of the frames without, and the common light point."""

    planes: dict[int, FramePlane]
    reasons: dict[int, str]
    light: LightPoint | None


def find_edges(
    sweep: SweepPictures,
    crossing: F8,
    camera: CameraModel,
    *,
    edge: str,
    local_levels: bool,
    progress: Progress | None = None,
) -> Edges:
    """The edge on both planes in each picture.

    Args:
        sweep: the pictures.
        crossing: [h, w] 0-based frame index, NaN where there is none.
        camera: for its distortion: edges are straight without it.
        edge: rising or falling.
        local_levels: the crossings take their levels beside the edge, not from the whole sweep as pictures do: lines
            are then moved to where the crossings have the edge.
        progress: of the pictures.
    """
    found: Edges = {}
    parts = []
    for region in sweep.regions:
        left, right, top, bottom = region.plane.region
        parts.append(np.where(region.usable, crossing[top : bottom + 1, left : right + 1], np.nan))
    for index, pictures in sweep.pictures(progress):
        pair = []
        for region, part, picture in zip(sweep.regions, parts, pictures, strict=True):
            seen = edge_in_picture(region, smoothed(region, picture, camera.width), edge, camera)
            timed = None if seen is not None and seen.sd_px < 0.1 else edge_by_crossings(region, part, index)
            pair.append(better(seen, timed))
        found[index + 1] = (pair[0], pair[1])
    return _pushed_by_crossings(found, sweep.regions, parts) if local_levels else found


def _pushed_by_crossings(edges: Edges, regions: Sequence[Region], parts: Sequence[F8]) -> Edges:
    """Lines moved to where the crossings have the edge, by one distance per plane: points are made of crossings."""
    moved: list[dict[int, EdgePoints | None]] = []
    for side, (region, part) in enumerate(zip(regions, parts, strict=True)):
        own = {t: pair[side] for t, pair in edges.items()}
        lags = [lag for t, one in own.items() if one and (lag := lag_px(region, one, part, t - 1)) is not None]
        lag = float(np.median(lags)) if len(lags) >= LEAST_LAGS else 0.0
        lag = lag if abs(lag) < MOST_LAG_PX else 0.0
        moved.append({t: one and pushed(region, one, lag) for t, one in own.items()})
    return {t: (moved[0][t], moved[1][t]) for t in edges}


def fit_reference_planes(
    edges: Edges, known: Sequence[ReferencePlane], camera: CameraModel, *, frames: int, edge: str, method: str
) -> ReferenceResult:
    """One plane for each frame whose edge is seen, and the reason of every other frame.

    Args:
        edges: as :func:`find_edges` found them.
        known: the two reference planes.
        camera: with its pose in the world.
        frames: of the sweep.
        edge: as the sweep was read.
        method: the crossing estimate that points will be made with.

    Raises:
        CalibrationError: parallel planes, no frame with its edge on both, or lines that are not those of planes.
    """
    check_planes(known)
    found = planes_of(edges, known, camera)
    reasons = {t: found.reasons.get(t, "no picture") for t in range(1, frames + 1) if t not in found.planes}
    order = tuple(found.planes[t] for t in sorted(found.planes))
    return ReferenceResult(order, reasons, tuple(known), edge, method, found.light)


def check_planes(known: Sequence[ReferencePlane]) -> None:
    """Refuse others than two planes that are not parallel.

    Raises:
        CalibrationError: as it says.
    """
    if len(known) != 2:
        raise CalibrationError(f"it takes two reference planes; {len(known)} were given")
    if abs(float(known[0].normal @ known[1].normal)) > 0.999:
        raise CalibrationError("the two reference planes are parallel: the light plane cannot be told from its lines")


def planes_of(edges: Edges, known: Sequence[ReferencePlane], camera: CameraModel) -> FoundPlanes:
    """Planes of all frames with lines, by the rules of ``frame_planes``.

    Raises:
        CalibrationError: as :func:`fit_reference_planes`.
    """
    scene = scene_of(known, camera)
    lines = {t: _lines(pair, known, camera) for t, pair in edges.items()}
    both = {t: (a, b) for t, (a, b) in lines.items() if a is not None and b is not None}
    reasons = {t: f"no edge on the {_missing(pair, known)}" for t, pair in lines.items() if t not in both}
    if not both:
        raise CalibrationError(
            f"no frame shows the edge on both {known[0].name} and {known[1].name}: are image_region_px and --edge "
            "right? A shadow begins with a falling edge and ends with a rising one"
        )
    planes, refused = _two_line_planes(both, scene)
    reasons |= refused
    _refuse_absurd(planes, both, scene)
    places = np.array([line.middle for pair in both.values() for line in pair])[:: max(len(both) // 50, 1)]
    off = jumping(planes, _spread(places), scene)
    reasons |= {t: f"the plane jumps by {mm:.1f} mm away from its neighbours" for t, mm in off.items()}
    planes = {t: plane for t, plane in planes.items() if t not in off}
    light = _light(planes, scene)
    if light is not None:
        planes, missed = _held(planes, both, light)
        reasons |= missed
        near = range(min(planes, default=0) - MOST_BRIDGED, max(planes, default=-1) + MOST_BRIDGED + 1)
        one = {t: pair for t, pair in lines.items() if t not in both and t in near}
        planes |= _continuing(planes, _one_line_planes(one, known, light), _spread(places), scene)
    planes |= bridged(planes, _spread(places), scene)
    return FoundPlanes(planes, {t: why for t, why in reasons.items() if t not in planes}, light)


def _lines(
    pair: tuple[EdgePoints | None, EdgePoints | None], known: Sequence[ReferencePlane], camera: CameraModel
) -> tuple[EdgeLine | None, EdgeLine | None]:
    first, second = (
        None if points is None else line_on_plane(points, plane, camera)
        for points, plane in zip(pair, known, strict=True)
    )
    return first, second


def _missing(pair: tuple[EdgeLine | None, EdgeLine | None], known: Sequence[ReferencePlane]) -> str:
    return " and the ".join(plane.name for line, plane in zip(pair, known, strict=True) if line is None)


def _two_line_planes(
    both: dict[int, tuple[EdgeLine, EdgeLine]], scene: Scene
) -> tuple[dict[int, FramePlane], dict[int, str]]:
    planes, reasons = {}, {}
    for t, pair in both.items():
        angle = line_angle_deg(*pair)
        if angle < LEAST_ANGLE_DEG:
            reasons[t] = f"its two lines are parallel within {LEAST_ANGLE_DEG:g} degree"
            continue
        plane = plane_of_lines(t, pair, None, "two lines")
        assert plane.skew_mm is not None
        if plane.skew_mm > MOST_SKEW * scene.size_mm:
            reasons[t] = f"its two lines miss each other by more than {MOST_SKEW * scene.size_mm:.1f} mm"
            continue
        planes[t] = plane
    bound = _skew_bound([plane.skew_mm for plane in planes.values() if plane.skew_mm is not None], scene)
    odd = {t: plane for t, plane in planes.items() if plane.skew_mm is not None and plane.skew_mm > bound}
    reasons |= dict.fromkeys(odd, f"its two lines miss each other by {bound:.1f} mm or more")
    return {t: plane for t, plane in planes.items() if t not in odd}, reasons


def _skew_bound(skews: list[float], scene: Scene) -> float:
    """Skew in mm beyond which a frame's lines differ from those of the other frames."""
    if not skews:
        return 0.0
    middle, scale = robust.median_and_scale(np.array(skews))
    return middle + max(ODD_SIGMAS * scale, ODD_SKEW * scene.size_mm)


def _refuse_absurd(planes: dict[int, FramePlane], both: dict[int, tuple[EdgeLine, EdgeLine]], scene: Scene) -> None:
    if len(planes) >= LEAST_GOOD * len(both):
        return
    raise CalibrationError(
        f"of {len(both)} frames with the edge on both planes, {len(both) - len(planes)} have lines that "
        f"miss each other by more than {MOST_SKEW * scene.size_mm:.1f} mm or are parallel: "
        "marker_corners_px, marker_rectangle_mm or image_region_px is wrong, or this is another camera's calibration"
    )


def _spread(places: F8) -> F8:
    """A few places [n, 3] that span all of them, for comparing planes."""
    return places[np.unique(np.concatenate([places.argmin(axis=0), places.argmax(axis=0)]))]


def _light(planes: dict[int, FramePlane], scene: Scene) -> LightPoint | None:
    if not planes:
        return None
    normals = np.array([plane.normal for plane in planes.values()])
    offsets = np.array([plane.offset for plane in planes.values()])
    return find_light_point(normals, offsets, scene.middle, scene.size_mm)


def _held(
    planes: dict[int, FramePlane], both: dict[int, tuple[EdgeLine, EdgeLine]], light: LightPoint
) -> tuple[dict[int, FramePlane], dict[int, str]]:
    """Planes near the light point, fitted with it; the reasons of the others."""
    kept, reasons = {}, {}
    for t, plane in planes.items():
        miss = float(light.miss_deg(plane.normal[None], np.array([plane.offset]))[0])
        if miss > light.bound_deg:
            reasons[t] = f"the plane misses the common light point by {miss:.2f} degrees"
        else:
            kept[t] = with_light(plane, both[t], light)
    return kept, reasons


def _one_line_planes(
    lines: dict[int, tuple[EdgeLine | None, EdgeLine | None]], known: Sequence[ReferencePlane], light: LightPoint
) -> dict[int, FramePlane]:
    found = {}
    for t, pair in lines.items():
        for line, plane in zip(pair, known, strict=True):
            if line is not None:
                source = f"from the line on the {plane.name} and the common light point"
                found[t] = plane_of_lines(t, [line], light, source)
    return found


def _continuing(planes: dict[int, FramePlane], more: dict[int, FramePlane], places: F8, scene: Scene) -> Planes:
    """Those of the planes from one line that continue the motion of the frames beside them."""
    found = dict(planes)
    order = sorted(planes)
    steps = [off_at(planes[a], planes[b], places) for a, b in zip(order, order[1:], strict=False) if b == a + 1]
    bound = (float(np.median(steps)) if steps else 0.0) + LEAST_JUMP * scene.size_mm
    outwards = sorted((t for t in more if order and t < order[-1]), reverse=True) + sorted(more)
    for t in outwards:
        for way in (1, -1):
            beside = [found[s] for s in range(t + way, t + way * (MOST_BRIDGED + 2), way) if s in found][:2]
            if len(beside) < 2:
                continue
            near, far = beside
            if off_at(more[t], between(near, far, t, ""), places) < bound:
                found[t] = more[t]
    return {t: plane for t, plane in found.items() if t in more}


def scene_of(known: Sequence[ReferencePlane], camera: CameraModel) -> Scene:
    """The middle between both regions on their planes, and the size of the scene: how far they and their ends reach."""
    corners = []
    for plane in known:
        left, right, top, bottom = plane.region
        pixels = np.array([[x, y] for x in (left, right) for y in (top, bottom)], dtype=np.float64)
        places, distance = meet(rays(camera, pixels), plane.normal, plane.offset)
        if not (distance > 0).all() or not np.isfinite(places).all():
            raise CalibrationError(
                f"{plane.name}: image_region_px reaches past the plane's horizon: is it the region of this plane?"
            )
        corners.append(places)
    middles = [places.mean(axis=0) for places in corners]
    size = float(np.linalg.norm(np.ptp(np.concatenate(corners), axis=0)))
    return Scene(np.asarray(np.mean(middles, axis=0)), size)
