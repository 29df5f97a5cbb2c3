"""Make the report of a reconstruction: counts, contrast, speed, noise, calibration, warnings, errors against truth."""

from __future__ import annotations

import importlib.metadata
import logging
import math
from collections.abc import Collection
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import PerFramePlanes, TranslatingPlane, Validity
from acquire.contract.errors import ScanFileError
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.dataset_names import TRUTH_NAME, FrameStatus
from acquire.contract.scan_data.report_file import (
    CalibrationUsed,
    NoiseFound,
    Report,
    Speed,
    SweepChecks,
    TruthErrors,
    find_report,
)
from acquire.contract.units import UM_PER_MM
from process.cloud.cloud import PointCloud
from process.cloud.light_planes import planes_at
from process.crossings.light_change import light_counts, light_warnings
from process.crossings.maps import full_scale
from process.crossings.quality import Quality
from process.edge_fit.noise_model import ROUNDING_VARIANCE, NoiseModel
from process.edge_fit.refine import Refined

from .fold_cursor import CursorCounts
from .nothing_found import OTHER_EDGE_SHARE, other_edge_words
from .scan_frames import ScanFrames
from .settings import Edge, Settings

logger = logging.getLogger(__name__)

HISTOGRAM_BINS = 256
SECONDS_PER_DAY = 86_400.0
_COUNT_NAMES = {name: f"quality_{name}" for name in (str(bit.name).lower() for bit in Quality)}
"""The fold's names of pixels by quality bit -> those in the report, where ``from_file`` already means frames."""

_LIT = "lit_at_start"
_COMMON_FAULTS = (
    ("saturated", 0.005, "are saturated, their plateau is not known: less exposure or gain"),
    ("plateau_not_reached", 0.02, "were still within the light's edge at the last frame: sweep further"),
    ("no_dark_level", 0.05, "have no dark level: begin the sweep earlier, keep stray light out"),
    (_LIT, 0.05, "were lit in the first frame already and have no point: begin the sweep earlier"),
    ("several", 0.1, "see the light more than once (shadows, reflections): their points may be wrong"),
    ("filtered", 0.05, "were filtered as uncertain or lonely: more light would keep them"),
)
"""Quality bit, the share of a scan's pixels over the contrast from which on it is worth a warning, and the warning."""


def make_report(
    frames: ScanFrames,
    settings: Settings,
    folded: CursorCounts,
    refined: Refined,
    cloud: PointCloud | None,
    *,
    cloud_path: Path,
    outcome: str,
    digest: str,
    checks: SweepChecks,
    more_counts: dict[str, int],
    nothing: str,
) -> Report:
    """The report of a finished reconstruction, without timings and without the comparison with the truth.

    ``digest`` is that of the folded frames; ``more_counts`` are counts that only the caller knows;
    ``nothing`` as in ``Results``.
    """
    layout, maps, other_light = frames.layout, refined.maps, frames.other_light()
    noise = None if settings.method == "linear" else noise_found(refined.noise, _full_of(settings, frames))
    calibration = calibration_used(settings, layout.start_time)
    without_plane = crossings_without_plane(maps.crossing, settings.light_plane)
    return Report(
        counts=frame_counts(frames)
        | {"points": 0 if cloud is None else len(cloud)}
        | {"from_live": folded.from_live, "from_file": folded.from_file, "refolded": folded.refolded}
        | {_COUNT_NAMES.get(name, name): number for name, number in maps.counts.items()}
        | light_counts(other_light)
        | without_plane
        | more_counts,
        contrast_histogram=contrast_histogram(maps.minimum, maps.maximum, layout.format.bit_depth),
        speed=sweep_speed(layout.plan, settings.light_plane),
        outcome=outcome,
        digest=digest,
        sweep=checks if checks != SweepChecks() else _recorded_checks(frames, digest),
        warnings=[
            *([nothing] if nothing else []),
            *settings.warnings,
            *damage_warnings(frames.damaged),
            *(no_cloud_warnings(settings, cloud_path) if cloud is None else ()),
            *age_warnings(settings, calibration),
            *(() if nothing else quality_warnings(maps.counts, noise, edge=settings.edge)),
            *light_warnings(other_light, maps.counts),
        ],
        settings={name: getattr(settings, name) for name in ("contrast", "median", "edge", "method", "noise_counts")},
        notes=plane_notes(without_plane, maps.counts, settings.light_plane),
        versions=versions(layout.program_version),
        noise=noise,
        calibration=calibration,
    )


def frame_counts(frames: ScanFrames) -> dict[str, int]:
    """Frames of the plan, committed, missing and retaken, as the file says now."""
    status = frames.status()
    committed = int(np.isin(status, (FrameStatus.GOOD, FrameStatus.RETAKEN)).sum())
    return {
        "frames": len(status),
        "committed": committed,
        "missing": len(status) - committed,
        "retaken": int((status == FrameStatus.RETAKEN).sum()),
    }


def _recorded_checks(frames: ScanFrames, digest: str) -> SweepChecks:
    """What the rig measured around this sweep: from the scan; of older scans, from the report that was made then."""
    if found := frames.measured:
        return SweepChecks.of(found)
    earlier = find_report(frames.layout.path.parent)
    return earlier.sweep if earlier is not None and earlier.digest == digest else SweepChecks()


def contrast_histogram(minimum: NDArray[Any], maximum: NDArray[Any], bit_depth: int) -> list[int]:
    """Number of pixels by max - min in counts of 8 bit (256 bins)."""
    contrast = (maximum - minimum) >> (bit_depth - 8)
    return [int(n) for n in np.bincount(contrast.ravel(), minlength=HISTOGRAM_BINS)]


def sweep_speed(plan: SweepPlan | None, plane: TranslatingPlane | PerFramePlanes | None) -> Speed:
    """Commanded against calibrated um per frame.

    The plane's motion within itself cannot be seen, so only a velocity whose direction was found or assumed is
    compared (docs/design.md, section 5).
    """
    commanded = None if plan is None else plan.steps_per_frame * plan.um_per_microstep
    if not isinstance(plane, TranslatingPlane) or plane.velocity_direction == "normal":
        return Speed(commanded)
    calibrated = float(np.linalg.norm(plane.corner_velocity_mm)) * UM_PER_MM
    if plane.parameter == "position_um":
        if commanded is None:
            return Speed()
        calibrated *= commanded
    return Speed(commanded, calibrated, calibrated / commanded if commanded else None)


def noise_found(noise: NoiseModel, full: int) -> NoiseFound:
    """The model of the folded signal in terms of the stored one; full: full scale of a falling edge, else 0."""
    floor, slope = (noise.floor + noise.slope * full, -noise.slope) if full else (noise.floor, noise.slope)
    return NoiseFound(math.sqrt(max(floor - ROUNDING_VARIANCE, 0.0)), max(slope, 0.0), noise.measured)


def _full_of(settings: Settings, frames: ScanFrames) -> int:
    return full_scale(frames.layout.format.bit_depth) if settings.edge == "falling" else 0


def calibration_used(settings: Settings, scan_start_utc: str) -> CalibrationUsed | None:
    """None without a calibration; times are ISO 8601."""
    if settings.calibration is None:
        return None
    valid = settings.calibration.valid_for or Validity()
    made, start = _time(valid.created_utc), _time(scan_start_utc)
    age = None if made is None or start is None else round((start - made).total_seconds() / SECONDS_PER_DAY, 3)
    return CalibrationUsed(settings.calibration_source, settings.calibration_sha256, valid.created_utc, age)


def _time(text: str | None) -> datetime | None:
    try:
        found = datetime.fromisoformat(text or "")
    except ValueError:
        return None
    return found if found.tzinfo else None


def age_warnings(settings: Settings, used: CalibrationUsed | None) -> list[str]:
    """A sentence if the calibration is older than it was meant to become."""
    valid = settings.calibration.valid_for if settings.calibration else None
    if used is None or used.age_days is None or valid is None or not valid.days or used.age_days <= valid.days:
        return []
    return [
        f"the calibration was {used.age_days:.0f} days old, it is meant for {valid.days:g}: "
        "check it with 'sweepscope calibrate check'"
    ]


def quality_warnings(counts: dict[str, int], noise: NoiseFound | None, *, edge: Edge = "rising") -> list[str]:
    """Sentences on what many pixels of a scan have in common; counts as in ``Maps.counts``.

    With a falling edge, that of a shadow through a lit room, nothing has to be dark.
    """
    pixels = max(counts["over_contrast"], 1)
    skipped = {"no_dark_level"} if edge == "falling" else set()
    if counts.get(_LIT, 0) > OTHER_EDGE_SHARE * pixels:
        skipped.add(_LIT)
    warnings = [
        f"{counts[name]} pixels ({100 * counts[name] / pixels:.1f} % of those over the contrast) {text}"
        for name, share, text in _COMMON_FAULTS
        if counts.get(name, 0) > share * pixels and name not in skipped
    ]
    if _LIT in skipped:
        warnings.append(other_edge_words(counts, edge))
    if noise is not None and not noise.measured and counts["crossings"]:
        warnings.append(f"too few pixels to measure the noise: sigma rests on noise_counts, {noise.read:.2g} counts")
    return warnings


def crossings_without_plane(
    crossing: NDArray[np.float64], plane: TranslatingPlane | PerFramePlanes | None
) -> dict[str, int]:
    """How many crossings [h, w] lie where per-frame planes have none: ``without_plane``; nothing for other planes."""
    if not isinstance(plane, PerFramePlanes):
        return {}
    t = crossing[np.isfinite(crossing)] + 1
    return {"without_plane": int(np.isnan(planes_at(plane, t)[:, 0]).sum())}


def plane_notes(
    without_plane: dict[str, int], counts: dict[str, int], plane: TranslatingPlane | PerFramePlanes | None
) -> list[str]:
    """A sentence on crossings that cannot become points for want of a light plane."""
    lost = without_plane.get("without_plane", 0)
    if not lost or not isinstance(plane, PerFramePlanes):
        return []
    missing = sum(row is None for row in plane.planes)
    gaps = f", {missing} of these without one" if missing else ""
    return [
        f"{lost} crossings ({100 * lost / max(counts['crossings'], 1):.1f} %) have no point: the light planes are "
        f"those of frames {plane.first_frame} to {plane.last_frame}{gaps}"
    ]


def damage_warnings(damaged: Collection[int]) -> list[str]:
    """A sentence on frames that are committed but do not have their checksum."""
    if not damaged:
        return []
    named = ", ".join(str(k) for k in sorted(damaged)[:5])
    return [f"{len(damaged)} frames do not have their checksum and were left out: {named}"]


def no_cloud_warnings(settings: Settings, cloud: Path) -> list[str]:
    """Why there is no cloud, and that a file of that name is another run's."""
    stale = [f"{cloud} is left from an earlier run, it does not belong to these maps"]
    return [settings.what_is_missing] + (stale if cloud.exists() else [])


def find_truth(frames: ScanFrames, cloud: PointCloud | None, settings: Settings) -> TruthErrors | None:
    """The comparison of the cloud with truth.h5 beside the scan; None where there is none (yet)."""
    path = frames.layout.path.parent / TRUTH_NAME
    if cloud is None or not path.is_file():
        return None
    try:
        return truth_errors(path, cloud, settings.contrast)
    except ScanFileError as error:
        logger.warning("%s", error)  # the simulation may still be writing it
        return None


def truth_errors(path: Path, cloud: PointCloud, contrast: int) -> TruthErrors:
    """Compare a cloud with truth.h5.

    Raises:
        ScanFileError: the truth cannot be read, or is of another size.
    """
    try:
        with h5py.File(path, "r") as file:
            points = file["points"][()].reshape(-1, 3)
            visible = (file["visible"][()].ravel() > 0) & (file["amplitude"][()].ravel() >= contrast)
    except (OSError, KeyError, ValueError) as error:
        raise ScanFileError(f"{path} is not a readable truth.h5: {str(error).splitlines()[0][:120]}") from None
    if len(cloud) and cloud.pixels[-1] >= len(points):
        raise ScanFileError(f"{path} is the truth of a smaller image")
    error_um = np.linalg.norm(cloud.points_mm - points[cloud.pixels], axis=1) * UM_PER_MM
    known = error_um[np.isfinite(error_um)]
    expected, found = int(visible.sum()), int(visible[cloud.pixels].sum())
    median, p95 = (float(x) for x in np.percentile(known, (50, 95))) if known.size else (None, None)
    return TruthErrors(
        points=int(known.size),
        points_beside=len(cloud) - int(known.size),
        median_um=median,
        rms_um=float(np.sqrt(np.mean(known**2))) if known.size else None,
        p95_um=p95,
        visible_over_contrast=expected,
        reconstructed=found,
        share=found / expected if expected else None,
    )


@lru_cache(maxsize=4)
def versions(scan_program: str) -> dict[str, str]:
    """Versions of what made the scan and the results."""
    return {
        "sweepscope": importlib.metadata.version("sweepscope"),
        "scan_program": scan_program,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "h5py": h5py.__version__,
    }
