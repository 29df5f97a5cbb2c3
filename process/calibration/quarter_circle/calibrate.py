"""Light plane from the slide's quarter circle on a white flat (equations 5 to 10 and 15 of the paper).

The motion of the plane is the track of the corner over all frames, corner(t) = origin + velocity t, by robust
regression (the paper's listing draws a line through two clicked points). Its tilt follows from the lengths of both
straight edges and the sizes of the slide. Lengths in mm in the world; the flat is the plane z = height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.calibration.light_plane import robust
from process.cloud.triangulation import rays

from .edges import FramePattern, RoughPattern, find_pattern, inside_quarter_circle
from .optics import Slide, plane_normal
from .picture import SlideSweep, open_slide_sweep
from .rough_search import rough_pattern, straight_track

F8 = NDArray[np.float64]
MIN_CORNERS = 8
MIN_ARCS = 5
PLATEAU_FRAMES = 150
PLATEAU_WIDTHS = 3.5


@dataclass(frozen=True)
class QuarterCircle:
    """A light plane from the pattern on a flat, mm in the world."""

    slide: Slide
    edge: str
    parameter: str
    patterns: tuple[FramePattern, ...]
    """The pattern in each frame where it was found; empty for clicked points."""
    origin: F8
    """[3] corner at t = 0."""
    velocity: F8
    """[3] mm per unit of t."""
    track_rms_um: float
    """Root mean square distance of the corners from corner(t)."""
    lead_end: F8
    """[3] end of the leading edge, from the corner: p2 - c of equation 7b."""
    side_end: F8
    """[3] end of the other straight edge, from the corner: p1 - c of equation 7a."""
    end_sd_um: tuple[float, float]
    """Standard deviations of their lengths from the scatter over the frames; NaN for clicked points."""
    turns: tuple[float, float]
    """theta of the leading and of the other edge (equation 6), rad; negative where it leads towards the projector."""
    normal: F8
    normal_sd_deg: float
    """From the scatter of the ends over the frames; without errors that all frames have in common."""

    @property
    def lengths_mm(self) -> tuple[float, float]:
        """Lengths of the leading and of the other straight edge: d2 and d1 of the paper."""
        return float(np.linalg.norm(self.lead_end)), float(np.linalg.norm(self.side_end))

    def lines(self) -> list[str]:
        """The result as lines of text."""
        n, (lead, side) = self.normal, self.lengths_mm
        unit = "um of travel" if self.parameter == "position_um" else "frame"
        how = f"found in {len(self.patterns)} frames" if self.patterns else "from clicked points"
        return [
            f"corner {how}, {self.track_rms_um:.2f} um RMS about its straight track, "
            f"{1000 * float(np.linalg.norm(self.velocity)):.5f} um per {unit}",
            f"leading edge {lead:.4f} mm, the other {side:.4f} mm long (hp = {self.slide.hp_mm:.4f} mm): turned by "
            f"{np.degrees(self.turns[0]):.2f} and {np.degrees(self.turns[1]):.2f} degrees (negative: it leads towards "
            "the projector)",
            f"normal ({n[0]:.5f}, {n[1]:.5f}, {n[2]:.5f})"
            + ("" if not self.patterns else f" +- {self.normal_sd_deg:.4f} degrees from the scatter over the frames"),
            f"an edge that is wrong by 1 um turns the plane by {self._degrees_per_um():.4f} degrees; "
            "sizes of the slide by more",
        ]

    def _degrees_per_um(self) -> float:
        """Change of theta with 1 um of the edge beside the leading one."""
        length = self.lengths_mm[1]
        share = self.slide.hp_mm * np.cos(self.slide.half_angle) / length
        return float(np.degrees(share / length / np.sqrt(max(1 - share**2, 1e-12)) * 1e-3))

    def document(self) -> dict[str, Any]:
        """The ``light_plane`` object of calibration.json."""
        return {
            "kind": "translating",
            "parameter": self.parameter,
            "edge": self.edge,
            "method": "auto",
            "normal": self.normal.tolist(),
            "corner_origin_mm": self.origin.tolist(),
            "corner_velocity_mm": self.velocity.tolist(),
            "velocity_direction": "corner-track",
            "quality": {
                "source": "quarter-circle",
                "frames": len(self.patterns),
                "track_rms_um": self.track_rms_um,
                "edge_lengths_mm": list(self.lengths_mm),
                "edge_lengths_sd_um": list(self.end_sd_um),
                "edge_turns_deg": [float(np.degrees(turn)) for turn in self.turns],
                "hp_mm": self.slide.hp_mm,
                "normal_sd_deg": self.normal_sd_deg,
            },
        }


def on_flat(camera: CameraModel, pixels: F8 | None, height_mm: float) -> F8:
    """Where pixels [n, 2] (None: all, row-major) see the flat z = height_mm, [n, 2] mm."""
    view = rays(camera, pixels)
    distance = (height_mm - view.centre_mm[2]) / view.directions[:, 2]
    return np.asarray((view.centre_mm + distance[:, None] * view.directions)[:, :2], dtype=np.float64)


def find_quarter_circle(
    scan: Path, camera: CameraModel, slide: Slide, *, height_mm: float = 0.0, edge: str = "rising"
) -> QuarterCircle:
    """Find the light plane in a sweep over a white flat.

    Args:
        scan: SCAN.
        camera: with its pose in the world.
        slide: sizes of slide and lens.
        height_mm: height of the flat.
        edge: of the leading edge, as in calibration.json; ``rising`` here.

    Raises:
        ScanFileError: no readable scan.
        CalibrationError: another picture size, no pattern, too little of it, or impossible geometry.
    """
    sweep = open_slide_sweep(scan)
    if (sweep.format.width, sweep.format.height) != (camera.width, camera.height):
        raise CalibrationError(
            f"{sweep.name} has {sweep.format.width} x {sweep.format.height} pixels, the camera was calibrated at "
            f"{camera.width} x {camera.height}"
        )
    places = on_flat(camera, None, height_mm).reshape(camera.height, camera.width, 2)
    near = rough_pattern(sweep, places)
    sweep = sweep.without_rim(near.width_mm / _pixel_mm(places))
    every = np.flatnonzero(sweep.usable)
    some = every[:: max(len(every) // PLATEAU_FRAMES, 1)]
    first = _find_patterns(sweep, places, near, some)
    sweep = _with_plateaus(sweep, places, near, first, some)
    return assembled(_find_patterns(sweep, places, near, every), slide, edge, sweep.parameter, height_mm, sweep.name)


def _pixel_mm(places: F8) -> float:
    row, column = places.shape[0] // 2, places.shape[1] // 2
    return float(np.linalg.norm(places[row, column + 1] - places[row, column]))


def _find_patterns(sweep: SlideSweep, places: F8, near: RoughPattern, indices: NDArray[np.intp]) -> list[FramePattern]:
    found = []
    for index, share in sweep.frames(indices):
        seen = find_pattern(share, sweep.steady, places, near, index, float(sweep.frame_t[index]))
        if seen is not None:
            found.append(seen)
    return found


def _with_plateaus(
    sweep: SlideSweep, places: F8, near: RoughPattern, found: Sequence[FramePattern], indices: NDArray[np.intp]
) -> SlideSweep:
    """The sweep with plateaus from where the pattern lies in each frame; unchanged where no arc was found."""
    conics = [seen.conic for seen in found if seen.conic is not None]
    if len(conics) < MIN_ARCS:
        return sweep
    lead, side = (np.median([getattr(seen, name) for seen in found], axis=0) for name in ("lead", "side"))
    shape = (lead, side, np.median(conics, axis=0))
    margin = PLATEAU_WIDTHS * near.width_mm
    return sweep.with_plateaus(lambda t: inside_quarter_circle(places, near.corner(t), shape, margin), indices)


def assembled(
    seen: Sequence[FramePattern], slide: Slide, edge: str, parameter: str, height_mm: float, name: str
) -> QuarterCircle:
    """The light plane from the pattern in many frames.

    Raises:
        CalibrationError: too few frames, or impossible geometry.
    """
    arcs = [
        (s.lead_end - s.corner, s.side_end - s.corner)
        for s in seen
        if s.lead_end is not None and s.side_end is not None
    ]
    if len(seen) < MIN_CORNERS or len(arcs) < MIN_ARCS:
        raise CalibrationError(
            f"{name}: the corner was found in {len(seen)} frames and the whole arc in {len(arcs)}, at least "
            f"{MIN_CORNERS} and {MIN_ARCS} are needed: sweep until the whole pattern is in the field, or give --points"
        )
    t = np.array([s.t for s in seen])
    corners = np.array([s.corner for s in seen])
    start, velocity, inliers = straight_track(t, corners)
    off = corners - (start + t[:, None] * velocity)
    rms = float(np.sqrt((off[inliers] ** 2).sum(axis=1).mean())) * 1000
    ends = np.array(arcs)
    middle = np.median(ends, axis=0)
    spread = robust.MAD_TO_SIGMA * np.median(np.abs(ends - middle), axis=0) / np.sqrt(len(ends))
    lead, side = (np.array([*vector, 0.0]) for vector in middle)
    origin, velocity = np.array([*start, height_mm]), np.array([*velocity, 0.0])
    conics = [s.conic for s in seen if s.conic is not None]
    turns = edge_turns(slide, lead, side, float(np.median(conics, axis=0)[3]) if conics else None)
    sd = _normal_sd(slide, (lead, side), turns, velocity, spread)
    return QuarterCircle(
        slide, edge, parameter, tuple(seen), origin, velocity, rms, lead, side,
        (float(np.linalg.norm(spread[0])) * 1000, float(np.linalg.norm(spread[1])) * 1000),
        turns, plane_normal(lead, side, turns, velocity), sd,
    )  # fmt: skip


def edge_turns(slide: Slide, lead: F8, side: F8, taper: float | None) -> tuple[float, float]:
    """Theta of the leading and of the other edge, rad.

    Of the leading edge, which lies in the light plane, the angle hardly matters: the smaller one is taken. The other
        edge leads towards the projector or away from it; the ``taper`` of the arc along it decides. Without an arc
        (clicked points) it leads towards it.

    Raises:
        CalibrationError: impossible geometry.
    """
    first = min(slide.turns(float(np.linalg.norm(lead)), "leading edge"), key=abs)
    away, towards = slide.turns(float(np.linalg.norm(side)), "edge beside the leading one")
    if taper is None:
        return first, towards
    return first, min(away, towards, key=lambda theta: abs(slide.taper(theta) - taper))


def _normal_sd(slide: Slide, edges: tuple[F8, F8], turns: tuple[float, float], velocity: F8, spread: F8) -> float:
    """Standard deviation of the normal in degrees from those of both ends, ``spread`` [2, 2] mm."""
    normal, total = plane_normal(*edges, turns, velocity), 0.0
    for which in (0, 1):
        for axis in (0, 1):
            moved = [edges[0].copy(), edges[1].copy()]
            moved[which][axis] += spread[which, axis]
            length = float(np.linalg.norm(moved[which]))
            try:
                angle = min(slide.turns(length, "edge"), key=lambda theta: abs(theta - turns[which]))
            except CalibrationError:
                angle = -slide.half_angle
            both = (angle, turns[1]) if which == 0 else (turns[0], angle)
            total += float(np.linalg.norm(plane_normal(moved[0], moved[1], both, velocity) - normal)) ** 2
    return float(np.degrees(np.sqrt(total)))
