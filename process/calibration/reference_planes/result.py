"""The planes of a sweep, and what became of each frame: as text, and as the light plane of calibration.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.frame_ranges import ranges_of

from .frame_planes import FramePlane
from .known_planes import ReferencePlane
from .light_point import LightPoint

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class PlaneSd:
    """Standard deviation of a plane by one source."""

    source: str
    mm: float
    """At the middle of the scene."""
    degrees: float


@dataclass(frozen=True)
class ReferenceResult:
    """Planes by frame, and the reason of each frame without one."""

    planes: tuple[FramePlane, ...]
    """By increasing t, which may leave numbers out."""
    reasons: dict[int, str]
    """1-based frame number -> why it has no plane."""
    known: tuple[ReferencePlane, ...]
    edge: str
    method: str
    light: LightPoint | None
    crossings: int = 0
    """Pixels with a crossing in the whole picture."""
    without_plane: int = 0
    """Of these, how many cross where there is no plane."""
    spread: tuple[PlaneSd, ...] = field(default=())

    @property
    def skew_mm(self) -> F8:
        """Distance of the two lines of each frame that has two, [frames]."""
        return np.array([plane.skew_mm for plane in self.planes if plane.skew_mm is not None])

    def lines(self) -> list[str]:
        """The result as lines of text."""
        found = [f"{plane.name}: corners miss their rectangle by {plane.misfit_px:.2f} px RMS" for plane in self.known]
        found += [f"note: {remark}" for plane in self.known for remark in plane.remarks]
        skew = self.skew_mm
        found.append(
            f"planes for {len(self.planes)} frames, {frame_ranges([p.t for p in self.planes])} (1-based); the two "
            f"lines of a frame miss each other by {np.median(skew):.2f} mm (median), {skew.max():.2f} mm at most"
        )
        found += self._sources()
        if self.light is not None:
            found.append(
                f"the planes have a point in common within {self.light.scatter_deg:.3f} degrees, the lamp, "
                f"{self.light.distance_mm:.0f} mm from the middle of the scene"
            )
        else:
            found.append("the planes have no point in common: each stands on its own two lines")
        found += [f"no plane: frames {numbers}: {why}" for why, numbers in self._reasons()]
        if self.without_plane:
            share = 100 * self.without_plane / max(self.crossings, 1)
            found.append(f"note: {self.without_plane} crossings ({share:.1f} %) lie where there is no plane")
        for sd in self.spread:
            found.append(
                f"{sd.source} alone moves the planes by {sd.mm:.2f} mm at the middle of the scene and turns them by "
                f"{sd.degrees:.3f} degrees (standard deviations)"
            )
        return found

    def _sources(self) -> list[str]:
        made: dict[str, list[int]] = {}
        for plane in self.planes:
            made.setdefault(plane.source, []).append(plane.t)
        return [f"frames {frame_ranges(ts)}: {source}" for source, ts in made.items() if source != "two lines"]

    def _reasons(self) -> list[tuple[str, str]]:
        why: dict[str, list[int]] = {}
        for t, reason in sorted(self.reasons.items()):
            why.setdefault(reason, []).append(t)
        return [(reason, frame_ranges(ts)) for reason, ts in why.items()]

    def document(self) -> dict[str, Any]:
        """The ``light_plane`` object of calibration.json; frames without a plane are null."""
        planes = {plane.t: plane for plane in self.planes}
        first, last = self.planes[0].t, self.planes[-1].t
        rows = [planes.get(t) for t in range(first, last + 1)]
        sources = {str(plane.t): plane.source for plane in self.planes}
        table = sources | {str(t): f"no plane: {why}" for t, why in self.reasons.items()}
        sd = {spread.source: {"mm": spread.mm, "deg": spread.degrees} for spread in self.spread}
        camera = sd.get("the camera's uncertainty")
        return {
            "kind": "per-frame",
            "parameter": "frame",
            "edge": self.edge,
            "method": self.method,
            "first_frame": first,
            "planes": [None if plane is None else [*plane.normal.tolist(), plane.offset] for plane in rows],
            "quality": {
                "source": "reference-planes",
                "frames": dict(sorted(table.items(), key=lambda entry: int(entry[0]))),
                "skew_mm": self.skew_mm.tolist(),
                "skew_median_mm": float(np.median(self.skew_mm)),
                "corner_misfit_px": {plane.name: plane.misfit_px for plane in self.known},
                "light_point_mm": None if self.light is None else self.light.place.tolist(),
                "light_point_scatter_deg": None if self.light is None else self.light.scatter_deg,
                "crossings_without_plane": self.without_plane,
                "sd": sd,
                "camera_sd_mm": camera["mm"] if camera else None,
                "camera_sd_deg": camera["deg"] if camera else None,
            },
        }


def frame_ranges(frames: list[int]) -> str:
    """Frame numbers as text: 1 to 39, 45, 50 to 60."""
    found = [f"{first} to {last}" if last > first else str(first) for first, last in ranges_of(frames)]
    return ", ".join(found) if len(found) <= SHOWN else ", ".join(found[:SHOWN]) + f" and {len(found) - SHOWN} more"


SHOWN = 8
"""Ranges of frames that are named in a line."""
