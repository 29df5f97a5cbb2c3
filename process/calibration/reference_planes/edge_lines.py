"""The line of the edge on a reference plane: where one picture crosses half brightness, or the crossings near a frame.

Both are given as points in the picture that lie on the edge, and become a line in mm by :func:`line_on_plane`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from process.calibration.light_plane import robust
from process.cloud.triangulation import Rays, rays

from .known_planes import ReferencePlane
from .sweep_pictures import F4, F8, Region

MIN_POINTS = 12
MIN_SHARE = 0.4
"""Least share of a picture's points that lie on the line: else there is no one edge."""
MIN_LENGTH = 0.3
"""Least length of a line in shares of the region's shorter side."""
REACH_PX = 1.5
"""Points nearer to a drawn line than this support it."""
DRAWS = 150
SMOOTH_PX_OF_WIDTH = 0.7 / 512
"""Pictures are smoothed by this share of their width: noise else crosses half brightness several times."""
WINDOW_FRAMES = 1.2
"""Pixels that cross within so many frames of a frame belong to its edge."""
MIN_CROSSINGS = 40
MODEL_PX = 0.1
"""Edges, lenses and planes are straight to about this; lines are not weighted as better than it."""


@dataclass(frozen=True)
class EdgePoints:
    """Points on the edge of one frame in one region."""

    pixels: F8
    """[n, 2] in the whole picture."""
    scatter_px: float
    """Robust standard deviation across the line."""
    independent: float
    """Number of points that do not share pixels."""
    source: str
    """``picture`` or ``crossings``."""

    @property
    def sd_px(self) -> float:
        """Standard deviation of the line's place by the scatter of its points."""
        return self.scatter_px / float(np.sqrt(max(self.independent, 1.0)))


@dataclass(frozen=True)
class EdgeLine:
    """The edge on a reference plane, in mm in the world."""

    middle: F8
    """[3]"""
    direction: F8
    """[3] unit vector."""
    half_mm: float
    """Standard deviation of the points along it."""
    across_mm: F8
    """[3] within the plane, across the line: what one pixel is there."""
    sd_px: float

    @property
    def ends(self) -> F8:
        """[2, 3]: two places on it that together weigh as much as its points."""
        step = self.half_mm * self.direction
        return np.array([self.middle - step, self.middle + step])


def smoothed(region: Region, picture: F4, width: int) -> F4:
    """Normalised picture of a region, smoothed over its usable pixels; NaN elsewhere."""
    weight = region.usable.astype(np.float32)
    shares = np.where(region.usable, region.shares(picture), np.float32(0))
    sigma = max(SMOOTH_PX_OF_WIDTH * width, 0.5)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = cv2.GaussianBlur(shares, (0, 0), sigma) / cv2.GaussianBlur(weight, (0, 0), sigma)
    return np.where(region.usable, found, np.float32(np.nan)).astype(np.float32)


def picture_points(region: Region, shares: F4, edge: str) -> F8:
    """Sub-pixel places [n, 2] in the whole picture where it crosses half brightness as the edge does.

    A shadow's leading edge (falling) is lit in the direction of motion; a rising edge is dark there.
    """
    found = []
    sign = 1.0 if edge == "falling" else -1.0
    down, right = np.gradient(shares)
    ahead = sign * (right * region.motion[0] + down * region.motion[1])
    for axis in (0, 1):
        first, second = (shares[:, :-1], shares[:, 1:]) if axis == 0 else (shares[:-1], shares[1:])
        step = second - first
        with np.errstate(invalid="ignore"):
            both = ahead[:, :-1] + ahead[:, 1:] if axis == 0 else ahead[:-1] + ahead[1:]
            here = ((first < 0) != (second < 0)) & (both > 0)
        here &= np.isfinite(step)
        row, column = np.nonzero(here)
        fraction = -first[here] / step[here]
        places = np.column_stack([column, row]).astype(np.float64)
        places[:, axis] += fraction
        found.append(places)
    return np.concatenate(found) + region.origin


def edge_in_picture(region: Region, shares: F4, edge: str, camera: CameraModel) -> EdgePoints | None:
    """The edge of one picture on one plane; None where there is no one straight edge."""
    pixels = picture_points(region, shares, edge)
    if len(pixels) < MIN_POINTS:
        return None
    flat = _straightened(pixels, camera)
    near = _supporters(flat)
    if near.sum() < max(MIN_POINTS, MIN_SHARE * len(pixels)):
        return None
    keep, scatter, along = _settled(flat, near)
    left, right, top, bottom = region.plane.region
    if keep.sum() < MIN_POINTS or np.ptp(along) < MIN_LENGTH * min(right - left, bottom - top):
        return None
    # each place counts along rows and along columns, and smoothing couples neighbours
    return EdgePoints(pixels[keep], scatter, keep.sum() / 4, "picture")


def _straightened(pixels: F8, camera: CameraModel) -> F8:
    """Pixels [n, 2] of a camera without distortion, in px of the same focal length."""
    matrix = np.array(camera.K)
    view = rays(camera, pixels).directions @ np.array(camera.R).T * (-1.0 if camera.mirrored else 1.0)
    return np.asarray((view[:, :2] / view[:, 2:]) * matrix[[0, 1], [0, 1]])


def _supporters(flat: F8) -> NDArray[np.bool_]:
    """Points near the best of many lines through two of them (random sample consensus)."""
    pick = np.random.default_rng(1).integers(0, len(flat), (DRAWS, 2))
    base, step = flat[pick[:, 0]], flat[pick[:, 1]] - flat[pick[:, 0]]
    length = np.linalg.norm(step, axis=1)
    base, step = base[length > 4], step[length > 4] / length[length > 4, None]
    if not len(base):
        return np.zeros(len(flat), np.bool_)
    normal = np.column_stack([-step[:, 1], step[:, 0]])
    gap = np.abs(flat @ normal.T - (base * normal).sum(axis=1))
    cost = np.minimum(gap / REACH_PX, 1.0).sum(axis=0)
    return np.asarray(gap[:, int(cost.argmin())] < REACH_PX)


def _settled(flat: F8, near: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], float, F8]:
    """Orthogonal fit with Tukey's weights: which points it keeps, their scatter, and where they lie along it."""
    weight = near.astype(np.float64)
    scatter, along, gap = 0.0, flat[:, 0], np.zeros(len(flat))
    for _ in range(12):
        middle = (flat * weight[:, None]).sum(axis=0) / weight.sum()
        axes = np.linalg.svd((flat - middle) * np.sqrt(weight)[:, None], full_matrices=False)[2]
        along, gap = (flat - middle) @ axes[0], (flat - middle) @ axes[1]
        scatter = max(robust.MAD_TO_SIGMA * float(np.median(np.abs(gap[near]))), 1e-3)
        weight = np.where(near, np.clip(1 - (gap / (robust.TUKEY * scatter)) ** 2, 0, None) ** 2, 0.0)
    keep = weight > 0.05
    return keep, scatter, along[keep]


def edge_by_crossings(region: Region, crossing: F8, at: int) -> EdgePoints | None:
    """The edge of frame ``at`` from the crossings ([h, w] of the region, 0-based frame index) about it; None if few.

    Near the edge the crossing is linear across it, t = g . x + c: each pixel is moved along g to where
    t is the frame's.
    """
    row, column = np.nonzero(np.abs(crossing - at) < WINDOW_FRAMES)
    if len(row) < MIN_CROSSINGS:
        return None
    t = crossing[row, column] - at
    places = np.column_stack([column, row]).astype(np.float64)
    middle = places.mean(axis=0)
    design = np.column_stack([places - middle, np.ones(len(places))])
    fit = robust.solve(design, t, seed=1)
    gradient = fit.x[:2]
    steep = float(gradient @ gradient)
    keep = fit.weight > 0.05
    if steep < 1e-12 or keep.sum() < MIN_CROSSINGS:
        return None
    moved = places - (t / steep)[:, None] * gradient
    scatter = max(fit.scale / np.sqrt(steep), 1e-3)
    return EdgePoints(moved[keep] + region.origin, float(scatter), float(keep.sum()) / 4, "crossings")


def lag_px(region: Region, points: EdgePoints, crossing: F8, at: int) -> float | None:
    """How far along the motion pixels lie that cross at frame ``at``, from the line of its picture; None if few.

    Crossings take their levels right beside the edge, pictures those of the whole sweep: where stray light comes with
    the edge, the two differ by a part of the edge's width.
    """
    row, column = np.nonzero(np.abs(crossing - at) < WINDOW_FRAMES)
    if len(row) < MIN_CROSSINGS or points.source != "picture":
        return None
    middle, normal = _line_normal(region, points.pixels)
    distance = (np.column_stack([column, row]) + region.origin - middle) @ normal
    design = np.column_stack([crossing[row, column] - at, np.ones(len(row))])
    near = np.abs(distance) < 4 * float(np.median(np.abs(distance))) + 1.0
    start = np.linalg.lstsq(design[near], distance[near], rcond=None)[0]
    return float(robust.solve(design, distance, start=np.asarray(start, np.float64)).x[1])


def pushed(region: Region, points: EdgePoints, lag: float) -> EdgePoints:
    """The points moved along the motion, where the line is a picture's."""
    if points.source != "picture":
        return points
    return replace(points, pixels=points.pixels + lag * _line_normal(region, points.pixels)[1])


def _line_normal(region: Region, pixels: F8) -> tuple[F8, F8]:
    """Middle of a line's points, and its unit normal in the picture, along the motion."""
    middle = pixels.mean(axis=0)
    normal = np.linalg.svd(pixels - middle, full_matrices=False)[2][1]
    return middle, normal if normal @ region.motion > 0 else -normal


def better(picture: EdgePoints | None, crossings: EdgePoints | None) -> EdgePoints | None:
    """The one whose line is known better; the picture's where both are as good as a straight edge can be."""
    if picture is None or crossings is None:
        return picture or crossings
    return crossings if crossings.sd_px < picture.sd_px and picture.sd_px > MODEL_PX else picture


def line_on_plane(points: EdgePoints, plane: ReferencePlane, camera: CameraModel) -> EdgeLine | None:
    """The line in mm through an edge's points for a camera; None if it does not lie in front of the camera."""
    view = rays(camera, points.pixels)
    places, distance = meet(view, plane.normal, plane.offset)
    if not (distance > 0).all():
        return None
    # each pixel is worth more mm where the plane is further away or flatter: weigh by what a pixel is in the picture
    flat = _straightened(points.pixels, camera)
    middle = flat.mean(axis=0)
    _, spread, axes = np.linalg.svd(flat - middle, full_matrices=False)
    half = float(spread[0]) / np.sqrt(len(flat))
    marks = middle + np.array([[0.0, 0.0], axes[0] * half, -axes[0] * half, axes[1]])
    matrix = np.array(camera.K)
    directions = np.column_stack([marks / matrix[[0, 1], [0, 1]], np.ones(4)]) @ np.array(camera.R)
    if camera.mirrored:
        directions = -directions
    found, distance = meet(Rays(view.centre_mm, directions), plane.normal, plane.offset)
    if not (distance > 0).all() or not np.isfinite(found).all():
        return None
    along = found[1] - found[2]
    length = float(np.linalg.norm(along))
    if length < 1e-9 or not np.isfinite(places).all():
        return None
    along /= length
    across = found[3] - found[0]
    across -= (across @ along) * along
    sd = float(np.hypot(points.sd_px, MODEL_PX))
    return EdgeLine((found[1] + found[2]) / 2, along, length / 2, across, sd)


def meet(view: Rays, normal: F8, offset: float) -> tuple[F8, F8]:
    """Points [n, 3] where rays meet a plane, and their distances [n] in mm along the optical axis."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (offset - normal @ view.centre_mm) / (view.directions @ normal)
    return view.centre_mm + distance[:, None] * view.directions, distance
