"""Light planes over the sweep: their coefficients at any time, and the time of each frame. No compiled code.

Equation 3 of the paper, n(t) . X = d(t) with d = n . q; mm, float64.
"""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import PerFramePlanes, TranslatingPlane
from acquire.contract.errors import CalibrationError

F8 = NDArray[np.float64]
LightPlane = TranslatingPlane | PerFramePlanes
_NO_PLANE = (np.nan,) * 4


class PlaneTable(NamedTuple):
    """A light plane as coefficients (nx, ny, nz, d), n . X = d, over t: linear between the nodes, none outside."""

    first: float
    """t of node 0; -inf for a plane that only translates (defined for every t, by ``slope``)."""
    last: float
    """t of the last node; +inf likewise."""
    nodes: F8
    """[m, 4]; a translating plane has one, its plane at t = 0. NaN: a frame without a plane."""
    slope: F8
    """[4], change of the coefficients per unit of t; used by translating planes only."""


def plane_table(plane: LightPlane) -> PlaneTable:
    """The plane's coefficients over t, in the unit of its ``parameter``."""
    if isinstance(plane, PerFramePlanes):
        nodes = np.array([_NO_PLANE if row is None else row for row in plane.planes], dtype=np.float64)
        return PlaneTable(float(plane.first_frame), float(plane.last_frame), nodes, np.zeros(4))
    normal = np.array(plane.normal, dtype=np.float64)
    offset = normal @ np.array(plane.corner_origin_mm)
    slope = normal @ np.array(plane.corner_velocity_mm)
    return PlaneTable(-inf, inf, np.array([[*normal, offset]]), np.array([0.0, 0.0, 0.0, slope]))


def planes_at(plane: LightPlane, t: F8) -> F8:
    """Coefficients (nx, ny, nz, d) of the light plane at each t [n], shape [n, 4]; NaN where there is none.

    Per-frame planes are interpolated linearly for first_frame <= t <= last_frame, both ends included; there is none
    between a frame with a plane and one without.
    """
    table = plane_table(plane)
    t = np.asarray(t, dtype=np.float64)
    if isinstance(plane, TranslatingPlane):
        moved: F8 = table.nodes[0] + t[:, None] * table.slope
        return moved
    inside = (t >= table.first) & (t <= table.last)
    at = np.where(inside, t - table.first, 0.0)
    low = np.minimum(np.floor(at).astype(np.intp), max(len(table.nodes) - 2, 0))
    high = np.minimum(low + 1, len(table.nodes) - 1)
    fraction = (at - low)[:, None]
    found: F8 = table.nodes[low] + fraction * (table.nodes[high] - table.nodes[low])
    # on a node, the other one does not matter
    found = np.where(fraction == 0, table.nodes[low], np.where(fraction == 1, table.nodes[high], found))
    found[~inside] = np.nan
    return found


def coordinates(plane: LightPlane, frames: int, present: NDArray[Any], position_um: F8) -> F8:
    """The sweep coordinate of every frame index 0..frames-1, float64 [frames], in the plane's unit.

    ``frame``: t = frame_index + 1. ``position_um``: the recorded stage positions of the present frames (bool
    [frames]); a missing frame's is interpolated between its neighbours, so that a crossing in the gap gets its own.

    Raises:
        CalibrationError: the plane counts in um and the scan does not know its positions.
    """
    if plane.parameter == "frame":
        return np.arange(1, frames + 1, dtype=np.float64)
    known = np.flatnonzero(present)
    positions = np.asarray(position_um, dtype=np.float64)[known]
    if not np.isfinite(positions).all():
        raise CalibrationError(
            "the light plane is calibrated by stage position, but this scan does not know its positions: "
            "use a calibration by frame number"
        )
    if not known.size:
        return np.full(frames, np.nan)
    return np.interp(np.arange(frames, dtype=np.float64), known.astype(np.float64), positions)
