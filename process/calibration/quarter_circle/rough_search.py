"""Rough shape, place and motion of the quarter circle, from a few frames of the sweep. Lengths in mm on the flat."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from process.calibration.light_plane import robust

from .edges import RoughPattern, find_pattern, outline, straight_end
from .picture import SlideSweep

F8 = NDArray[np.float64]
COARSE = 64
"""Frames from which the motion of the leading edge is taken."""
LOOKS = 24
MIN_LOOKS = 4
MOST_PIXELS = 20_000
FIRST_WIDTH_SHARE = 0.02
"""First guess of the blur, as a share of the leading edge's length."""


class _Outline(NamedTuple):
    """Outline of the lit region in a frame."""

    t: float
    ahead: F8
    """(n_x, n_y, c): n . X + c is the distance ahead of the leading edge."""
    depth: F8
    """[bins] behind the leading edge."""
    low: F8
    """[bins] one end across it, NaN where it is not in the picture."""
    high: F8
    """[bins] the other end."""


def straight_track(t: F8, corners: F8) -> tuple[F8, F8, NDArray[np.bool_]]:
    """Robust regression of corner(t) = origin + velocity t (equation 15): both [2], and the inliers [n]."""
    design = np.column_stack([np.ones(len(t)), t])
    fits = [robust.solve(design, corners[:, axis]) for axis in (0, 1)]
    (x0, vx), (y0, vy) = fits[0].x, fits[1].x
    return np.array([x0, y0]), np.array([vx, vy]), (fits[0].weight > 0) & (fits[1].weight > 0)


def rough_pattern(sweep: SlideSweep, places: F8) -> RoughPattern:
    """Find the pattern roughly.

    Args:
        sweep: over a white flat.
        places: [h, w, 2] mm on the flat.

    Raises:
        CalibrationError: no leading edge that moves, or no quarter circle behind it.
    """
    every = np.flatnonzero(sweep.usable)
    coarse = every[np.unique(np.linspace(0, len(every) - 1, min(COARSE, len(every))).astype(np.intp))]
    a, b, rate = _leading_edge(sweep, places, coarse)
    looks = coarse[:: max(len(coarse) // LOOKS, 1)]
    found: list[_Outline] = []
    for index, share in sweep.frames(looks):
        t = float(sweep.frame_t[index])
        ahead = np.array([*(a * rate), (b - t) * rate])
        seen = outline(share, places, ahead)
        if seen is not None:
            found.append(_Outline(t, ahead, *seen))
    return _sharpened(sweep, places, _assembled(found), looks)


def _leading_edge(sweep: SlideSweep, places: F8, coarse: NDArray[np.intp]) -> tuple[F8, float, float]:
    """(a, b, mm per t) of t = a . X + b, the time at which light first reaches a place X."""
    first = np.full(sweep.steady.shape, np.nan)
    before, before_t = None, 0.0
    for index, share in sweep.frames(coarse):
        t = float(sweep.frame_t[index])
        if before is not None:
            rises = np.isnan(first) & (before < 0.5) & (share >= 0.5)
            part = (0.5 - before[rises]) / (share[rises] - before[rises])
            first[rises] = before_t + part * (t - before_t)
        before, before_t = share, t
    row, column = np.nonzero(sweep.steady & np.isfinite(first))
    every = max(len(row) // MOST_PIXELS, 1)
    row, column = row[::every], column[::every]
    if len(row) < 500:
        raise CalibrationError(f"{sweep.name}: no edge of light that moves was found: is it a sweep over a white flat?")
    x = places[row, column]
    fit = robust.solve(np.column_stack([x, np.ones(len(x))]), first[row, column]).x
    steep = float(np.linalg.norm(fit[:2]))
    if steep <= 0:
        raise CalibrationError(f"{sweep.name}: the edge of light does not move: is it a sweep?")
    return fit[:2], float(fit[2]), 1.0 / steep


def _assembled(found: list[_Outline]) -> RoughPattern:
    ends = [
        [straight_end(look.depth, look.low) for look in found],
        [straight_end(look.depth, look.high) for look in found],
    ]
    usable = [[index for index, end in enumerate(side) if end is not None] for side in ends]
    if max(len(indices) for indices in usable) < MIN_LOOKS:
        raise CalibrationError(
            "no quarter circle was found: both straight edges of the slide have to be in the field while it sweeps"
        )
    straightness = [
        float(np.median([ends[side][index][2] for index in usable[side]])) if len(usable[side]) >= MIN_LOOKS else np.inf  # type: ignore[index]
        for side in (0, 1)
    ]
    chosen = int(np.argmin(straightness))
    inward = 1.0 if chosen == 0 else -1.0
    times, corners, slopes, leads, sides = [], [], [], [], []
    for index in usable[chosen]:
        t, ahead, depth, low, high = found[index]
        v, slope, _ = ends[chosen][index]  # type: ignore[misc]
        n, m = ahead[:2], np.array([-ahead[1], ahead[0]])
        times.append(t)
        corners.append(v * m - ahead[2] * n)
        slopes.append(slope)
        other = (high if chosen == 0 else low) - (v + slope * depth)
        leads.append(float(np.nanmax(inward * other)) if np.isfinite(other).any() else np.nan)
        sides.append(float(depth[-1]))
    n, m = found[0].ahead[:2], np.array([-found[0].ahead[1], found[0].ahead[0]])
    side = -n + float(np.median(slopes)) * m
    origin, velocity, _ = straight_track(np.array(times), np.array(corners))
    lead_mm = float(np.nanpercentile(leads, 75))
    return RoughPattern(
        origin=origin,
        velocity=velocity,
        lead=inward * m,
        side=side / np.linalg.norm(side),
        lead_mm=lead_mm,
        side_mm=float(np.percentile(sides, 75) * np.linalg.norm(side)),
        width_mm=FIRST_WIDTH_SHARE * lead_mm,
    )


def _sharpened(sweep: SlideSweep, places: F8, near: RoughPattern, looks: NDArray[np.intp]) -> RoughPattern:
    """The pattern with blur, directions and track measured in a few frames."""
    seen = [
        pattern
        for index, share in sweep.frames(looks)
        if (pattern := find_pattern(share, sweep.steady, places, near, index, float(sweep.frame_t[index]))) is not None
    ]
    if len(seen) < MIN_LOOKS:
        raise CalibrationError(
            f"{sweep.name}: the straight edges of the slide were found in {len(seen)} of {len(looks)} frames only: is "
            "the flat white, even and larger than the pattern?"
        )
    origin, velocity, _ = straight_track(np.array([p.t for p in seen]), np.array([p.corner for p in seen]))
    lead, side = (np.median([getattr(p, name) for p in seen], axis=0) for name in ("lead", "side"))
    return RoughPattern(
        origin, velocity, lead / np.linalg.norm(lead),
        side / np.linalg.norm(side), near.lead_mm, near.side_mm, float(np.median([p.width_mm for p in seen])),
    )  # fmt: skip
