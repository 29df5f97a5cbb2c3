"""The light plane of one frame from its lines, and the rules by which planes are kept, dropped and bridged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .edge_lines import EdgeLine
from .light_point import LightPoint

F8 = NDArray[np.float64]
MOST_SKEW = 0.01
"""Two lines of a frame that miss each other by a larger share of the scene's size are not those of one plane ..."""
ODD_SKEW = 0.003
"""... nor those that miss by so much, and by ODD_SIGMAS, more than the other frames do."""
ODD_SIGMAS = 6.0
LEAST_ANGLE_DEG = 1.0
"""Lines nearer to parallel do not check each other."""
JUMP = 4.0
"""A plane that is off between both neighbours by so many times what they differ is wrong."""
LEAST_JUMP = 0.01
"""... and by so large a share of the scene's size."""
MOST_BRIDGED = 5
"""Frames without a plane in a row that are filled in, if the motion about them is smooth; frames with one line only get
a plane so far before the first and after the last one with two."""
SMOOTH = 0.01
"""Planes about a gap continue each other within this share of the scene's size."""


@dataclass(frozen=True)
class FramePlane:
    """The light plane of one frame."""

    t: int
    """1-based frame number."""
    normal: F8
    offset: float
    skew_mm: float | None
    """Distance of the two lines; 0 if they lie in one plane; None where there are not two."""
    source: str
    """What it is made of: ``two lines``, a line and the light point, or the frames between which it lies."""
    covariance: F8 | None = None
    """[3, 3] of its offset at the middle of its lines in mm and two turns in radians, by the scatter of its lines."""


@dataclass(frozen=True)
class Scene:
    """Where the planes are: the middle between both regions in mm, and their distance."""

    middle: F8
    size_mm: float


def line_angle_deg(first: EdgeLine, second: EdgeLine) -> float:
    """Angle between two lines."""
    return float(np.degrees(np.arcsin(min(float(np.linalg.norm(np.cross(first.direction, second.direction))), 1.0))))


def skew_mm(first: EdgeLine, second: EdgeLine) -> float:
    """Distance of two lines that are not parallel."""
    between = np.cross(first.direction, second.direction)
    return abs(float((second.middle - first.middle) @ between)) / float(np.linalg.norm(between))


def plane_of_lines(t: int, lines: Sequence[EdgeLine], light: LightPoint | None, source: str) -> FramePlane:
    """The plane through lines, and the light point where there is one, by weighted least squares over their ends."""
    places = np.concatenate([line.ends for line in lines] + ([light.place[None]] if light else []))
    sd = np.ones(len(places))
    normal, middle = np.zeros(3), np.zeros(3)
    for _ in range(4):
        weight = 1 / sd**2
        middle = (places * weight[:, None]).sum(axis=0) / weight.sum()
        normal = np.linalg.svd((places - middle) / sd[:, None])[2][2]
        # what a pixel across the line is off the plane; two ends share the line's information
        ends = [max(abs(float(normal @ line.across_mm)), 1e-9) * line.sd_px * np.sqrt(2) for line in lines]
        sd = np.array([value for value in ends for _ in range(2)] + ([light.sd_mm] if light else []))
    normal = normal if normal[int(np.abs(normal).argmax())] > 0 else -normal
    skew = skew_mm(lines[0], lines[1]) if len(lines) == 2 else None
    spread = _covariance(places - middle, normal, sd)
    return FramePlane(t, np.asarray(normal), float(normal @ middle), skew, source, spread)


def _covariance(places: F8, normal: F8, sd: F8) -> F8:
    """[3, 3] of (offset at the places' middle, two turns in radians) of a plane through places [n, 3] with sd [n]."""
    axes = np.linalg.svd(normal[None])[2][1:]
    design = np.column_stack([np.ones(len(places)), places @ axes.T]) / sd[:, None]
    return np.asarray(np.linalg.pinv(design.T @ design))


def off_at(plane: FramePlane, other: FramePlane, places: F8) -> float:
    """Largest distance in mm between two planes at places [n, 3], measured along their normals."""
    sign = 1.0 if plane.normal @ other.normal > 0 else -1.0
    gap = (places @ plane.normal - plane.offset) - sign * (places @ other.normal - other.offset)
    return float(np.abs(gap).max())


def between(first: FramePlane, last: FramePlane, t: float, source: str) -> FramePlane:
    """The plane at t, linear between two others."""
    share = (t - first.t) / (last.t - first.t)
    sign = 1.0 if first.normal @ last.normal > 0 else -1.0
    normal = (1 - share) * first.normal + share * sign * last.normal
    offset = (1 - share) * first.offset + share * sign * last.offset
    length = float(np.linalg.norm(normal))
    return FramePlane(round(t), normal / length, offset / length, None, source)


def jumping(planes: dict[int, FramePlane], places: F8, scene: Scene) -> dict[int, float]:
    """Planes that lie off between their neighbours, where these agree with each other; mm by t."""
    found = {}
    order = sorted(planes)
    for before, t, after in zip(order, order[1:], order[2:], strict=False):
        if after - before > 4:
            continue
        apart = off_at(planes[before], planes[after], places)
        off = off_at(planes[t], between(planes[before], planes[after], t, ""), places)
        if off > max(JUMP * apart, LEAST_JUMP * scene.size_mm):
            found[t] = off
    return found


def bridged(planes: dict[int, FramePlane], places: F8, scene: Scene) -> dict[int, FramePlane]:
    """Planes for short gaps, where those on both sides continue each other."""
    found = {}
    order = sorted(planes)
    for first, last in zip(order, order[1:], strict=False):
        gap = range(first + 1, last)
        if not 0 < len(gap) <= MOST_BRIDGED:
            continue
        if _smooth(planes, first, last, places, SMOOTH * scene.size_mm):
            for t in gap:
                found[t] = between(planes[first], planes[last], t, f"interpolated between frames {first} and {last}")
    return found


def _smooth(planes: dict[int, FramePlane], first: int, last: int, places: F8, bound_mm: float) -> bool:
    """Whether the planes on each side of a gap, continued into it at their own speed, meet in its middle."""
    if first - 1 not in planes or last + 1 not in planes:
        return False
    middle = (first + last) / 2
    left = between(planes[first - 1], planes[first], middle, "")
    right = between(planes[last + 1], planes[last], middle, "")
    chord = between(planes[first], planes[last], middle, "")
    return max(off_at(left, chord, places), off_at(right, chord, places)) < bound_mm


def with_light(plane: FramePlane, lines: Sequence[EdgeLine], light: LightPoint) -> FramePlane:
    """The same plane, held near the common light point too."""
    return replace(plane_of_lines(plane.t, lines, light, plane.source), skew_mm=plane.skew_mm)
