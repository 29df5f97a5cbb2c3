"""The quarter circle in a frame, to sub-pixel: both straight edges, their corner, and the ends of the arc.

Across an edge blurred as an erf, q = Phi^-1(relative brightness) is linear in the distance from it. So each edge is a
robust linear fit over all pixels within its blur, and the corner c is where both lines meet; the blurred corner itself
is not used. Lengths in mm on the flat; the leading edge ends in p2, the other straight edge in p1 of the paper's figure
3.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from process.calibration.light_plane import robust

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
LOW, HIGH = 0.1, 0.9
"""Range of relative brightness in which a pixel tells its distance from an edge."""
CLEAR_WIDTHS = 4.0
"""Pixels within so many widths of the blur of another edge see both edges."""
MIN_PIXELS = 150
QUICK_ROUNDS = 6
MIN_LENGTH_SHARE = 0.3
"""Least share of an edge's length that has to be in the picture."""
GRADIENT_TERMS = 3
"""Terms of a polynomial for the conic's gradient along the arc."""
MOST_PIXELS = 1500
"""Per edge and frame; more are thinned evenly."""
MIN_ARC_DEG = 65.0
BINS = 40
BORDER_PX = 4
_SHARES = np.linspace(0.0, 1.0, 4097)
_PROBITS = np.array([NormalDist().inv_cdf(min(max(share, 1e-4), 1 - 1e-4)) for share in _SHARES])


@dataclass(frozen=True)
class RoughPattern:
    """Rough shape, place and motion of the quarter circle on the flat, for finding it in a frame."""

    origin: F8
    """[2] corner at t = 0."""
    velocity: F8
    """[2] per unit of t."""
    lead: F8
    """[2] unit vector along the leading edge, from the corner."""
    side: F8
    """[2] unit vector along the other straight edge, from the corner."""
    lead_mm: float
    side_mm: float
    width_mm: float
    """Standard deviation of the blur."""

    def corner(self, t: float) -> F8:
        """Corner at t, [2] mm."""
        return np.asarray(self.origin + t * self.velocity)


@dataclass(frozen=True)
class FramePattern:
    """The quarter circle in one frame; places [2] in mm on the flat."""

    frame_index: int
    t: float
    corner: F8
    lead: F8
    """Unit vector along the leading edge."""
    side: F8
    width_mm: float
    lead_end: F8 | None
    """Intersection of the leading edge and the arc; None where the arc is not in the field."""
    side_end: F8 | None
    conic: F8 | None = None
    """[5] A to E of the arc A u^2 + B u v + C v^2 + D u + E v = 1, u along the side, v along the leading edge."""


def inside_quarter_circle(places: F8, corner: F8, shape: tuple[F8, F8, F8], margin_mm: float) -> NDArray[np.bool_]:
    """[h, w] mask of places at least ``margin_mm`` inside a quarter circle (lead, side, conic)."""
    lead, side, conic = shape
    matrix = np.linalg.inv(np.column_stack([side, lead]))
    u, v = np.moveaxis((places - corner) @ matrix.T, -1, 0)
    value = conic[0] * u * u + conic[1] * u * v + conic[2] * v * v + conic[3] * u + conic[4] * v
    along_u, along_v = 2 * conic[0] * u + conic[1] * v + conic[3], conic[1] * u + 2 * conic[2] * v + conic[4]
    inside = 1 - value > margin_mm * np.hypot(along_u, along_v)
    return np.asarray((u > margin_mm) & (v > margin_mm) & inside)


def probit(share: F4 | F8) -> F8:
    """Inverse normal of a relative brightness (clipped at 3.7)."""
    return np.interp(share, _SHARES, _PROBITS)


def outline(bright: F4, places: F8, ahead: F8) -> tuple[F8, F8, F8] | None:
    """Outline of the lit region: depth behind the leading edge and both ends across it, [bins] each; or None.

    Args:
        bright: [h, w] relative brightness.
        places: [h, w, 2] mm.
        ahead: [3] n_x, n_y, c: n . X + c is the distance ahead of the leading edge, n a unit vector.
    """
    lit = (cv2.GaussianBlur(np.nan_to_num(bright), (0, 0), 2.0) > 0.5).astype(np.uint8)
    depth = -(places @ ahead[:2] + ahead[2])
    lit[depth <= 0] = 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats(lit)
    if count < 2:
        return None
    own = labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    if own.sum() < 20 * MIN_PIXELS:
        return None
    height, width = bright.shape
    across = places @ np.array([-ahead[1], ahead[0]])
    inner = np.zeros_like(own)
    inner[BORDER_PX : height - BORDER_PX, BORDER_PX : width - BORDER_PX] = True
    furthest = float(np.percentile(depth[own], 99.5))
    number = np.clip((depth[own] / furthest * BINS).astype(np.intp), 0, BINS - 1)
    low, high = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(low, number, across[own])
    np.maximum.at(high, number, across[own])
    for ends, pick in ((low, np.minimum), (high, np.maximum)):
        outer = np.full(BINS, np.inf if pick is np.minimum else -np.inf)
        edge = own & ~inner
        at = np.clip((depth[edge] / furthest * BINS).astype(np.intp), 0, BINS - 1)
        pick.at(outer, at, across[edge])
        ends[outer == ends] = np.nan
    return (
        (np.arange(BINS) + 0.5) / BINS * furthest,
        np.where(np.isfinite(low), low, np.nan),
        np.where(np.isfinite(high), high, np.nan),
    )


def straight_end(depth: F8, ends: F8) -> tuple[float, float, float] | None:
    """(v, slope, residual) of the line through the ends of the bins near the leading edge; None for too few bins."""
    near = (depth > 0.08 * depth[-1]) & (depth < 0.6 * depth[-1]) & np.isfinite(ends)
    if near.sum() < 8:
        return None
    design = np.column_stack([np.ones(int(near.sum())), depth[near]])
    fit = robust.solve(design, ends[near])
    return float(fit.x[0]), float(fit.x[1]), float(np.median(np.abs(ends[near] - design @ fit.x)))


def find_pattern(
    share: F4, steady: NDArray[np.bool_], places: F8, near: RoughPattern, frame_index: int, t: float
) -> FramePattern | None:
    """Find the pattern in a frame, from its rough shape; None where its straight edges are not both in the field.

    Args:
        share: [h, w] relative brightness.
        steady: [h, w] where that can be trusted.
        places: [h, w, 2] mm on the flat.
        near: rough pattern.
        frame_index: 0-based.
        t: its sweep coordinate.
    """
    usable = steady & (share > LOW) & (share < HIGH)
    x, q = places[usable], probit(share[usable])
    corner = near.corner(t)
    lines = []
    for along, beside, length, other in (
        (near.lead, near.side, near.lead_mm, near.side_mm),
        (near.side, near.lead, near.side_mm, near.lead_mm),
    ):
        line = _line(x, q, corner, (along, beside), (length, other), near.width_mm)
        if line is None:
            return None
        lines.append(line)
    matrix = np.array([line[:2] for line in lines])
    if abs(np.linalg.det(matrix / np.linalg.norm(matrix, axis=1)[:, None])) < 0.2:
        return None
    corner = np.linalg.solve(matrix, [-line[2] for line in lines])
    lead, side = (_along(line, rough) for line, rough in zip(lines, (near.lead, near.side), strict=True))
    width = float(1 / np.linalg.norm(matrix, axis=1).mean())
    ends = _arc_ends(x, q, corner, (lead, side), near, width)
    return FramePattern(frame_index, t, corner, lead, side, width, *(ends or (None, None, None)))


def _line(x: F8, q: F8, corner: F8, directions: tuple[F8, F8], lengths: tuple[float, float], width: float) -> F8 | None:
    """(g_x, g_y, c) of q = g . X + c at one straight edge; repeated about the line that was found."""
    along, beside = directions
    inward = np.array([-along[1], along[0]])
    inward = inward if inward @ beside > 0 else -inward
    offset = x - corner
    at, across = offset @ along, offset @ inward
    clear = CLEAR_WIDTHS * width
    inside = (at > clear) & (at < lengths[0] - clear)
    # however wide the first window is, the other edge of a narrow pattern is left alone
    chosen = inside & (np.abs(across) < min(max(3 * clear, 0.1 * lengths[0]), 0.5 * lengths[1]))
    fit = np.array([*inward, -float(inward @ corner)]) / width
    # the first window is about the rough edge, the others about the line itself, within 1.3 widths of the blur
    for _ in range(3):
        if chosen.sum() < MIN_PIXELS or np.ptp(at[chosen]) < MIN_LENGTH_SHARE * lengths[0]:
            return None
        design, values = _thinned(np.column_stack([x[chosen], np.ones(int(chosen.sum()))]), q[chosen])
        fit = robust.solve(design, values, start=fit, rounds=QUICK_ROUNDS).x
        steep = float(np.linalg.norm(fit[:2]))
        if steep <= 0 or fit[:2] @ inward < 0.5 * steep:
            return None
        chosen = inside & (np.abs(x @ fit[:2] + fit[2]) < 1.3)
    return fit


def _thinned(design: F8, values: F8) -> tuple[F8, F8]:
    every = max(len(values) // MOST_PIXELS, 1)
    return design[::every], values[::every]


def _along(line: F8, rough: F8) -> F8:
    found = np.array([-line[1], line[0]]) / np.linalg.norm(line[:2])
    return np.asarray(found if found @ rough > 0 else -found)


def _arc_ends(
    x: F8, q: F8, corner: F8, directions: tuple[F8, F8], near: RoughPattern, width: float
) -> tuple[F8, F8, F8] | None:
    """Where the arc meets the leading and the other edge.

    The cone of light cuts the flat in a conic A u^2 + B u v + C v^2 + D u + E v = 1, u and v along the edges. Beside
    the arc the left side differs from 1 by q times a factor that varies slowly along the arc.
    """
    lead, side = directions
    oblique = np.linalg.solve(np.column_stack([side, lead]), (x - corner).T)
    radius = np.linalg.norm(x - corner, axis=1)
    angle = np.arctan2(oblique[1], oblique[0])
    rough = 1 / np.sqrt((np.cos(angle) / near.side_mm) ** 2 + (np.sin(angle) / near.lead_mm) ** 2)
    clear = 0.9 * CLEAR_WIDTHS * width
    chosen = (oblique[0] > clear) & (oblique[1] > clear) & (np.abs(radius - rough) < 0.12 * rough)
    if chosen.sum() < 2 * MIN_PIXELS:
        return None
    if np.degrees(np.ptp(np.percentile(angle[chosen], [0.5, 99.5]))) < MIN_ARC_DEG:
        return None
    u, v, turn = oblique[0][chosen], oblique[1][chosen], angle[chosen] / (np.pi / 4) - 1
    falls = [-q[chosen] * turn**power for power in range(GRADIENT_TERMS)]
    design, values = _thinned(np.column_stack([u * u, u * v, v * v, u, v, *falls]), np.ones(len(u)))
    first = np.asarray(np.linalg.lstsq(design, values, rcond=None)[0], dtype=np.float64)
    fit = robust.solve(design, values, start=first, rounds=QUICK_ROUNDS).x
    ends = [_root(fit[2], fit[4]), _root(fit[0], fit[3])]
    if ends[0] is None or ends[1] is None:
        return None
    return corner + ends[0] * lead, corner + ends[1] * side, np.asarray(fit[:5])


def _root(square: float, linear: float) -> float | None:
    """Least positive root of square x^2 + linear x = 1."""
    roots = np.roots([square, linear, -1.0])
    good = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and root.real > 0]
    return min(good) if good else None
