"""Owns report.json: counts, timings, contrast, speed, and errors against the truth where a simulation wrote one."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import h5py
import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import PerFramePlanes, TranslatingPlane
from acquire.contract.errors import ScanFileError
from acquire.contract.plan import SweepPlan
from acquire.contract.units import UM_PER_MM
from process.atomic_write import replacing
from process.cloud.cloud import Cloud

from .report_findings import CalibrationUsed, NoiseFound

HISTOGRAM_BINS = 256


class Speed(msgspec.Struct, frozen=True):
    """The sweep's speed as commanded and as calibrated: a difference catches wrong steps per mm."""

    commanded_um_per_frame: float | None = None
    """None where the plan is not known (imported folders)."""
    calibrated_um_per_frame: float | None = None
    """None where the direction of travel cannot be determined from the light plane."""
    ratio: float | None = None
    """calibrated / commanded."""


class SweepChecks(msgspec.Struct, frozen=True):
    """What the rig measured around the sweep; None where it did not."""

    drift_px: float | None = None
    steps_lost: float | None = None
    brightness_change: float | None = None
    light_changed_at: float | None = None
    """First frame that was taken in another light (F27); the operator went on with it."""


class TruthErrors(msgspec.Struct, frozen=True):
    """Distances of all points from the true surface point of their pixel, untrimmed."""

    points: int
    """Points whose pixel sees a surface."""
    points_beside: int
    """Points whose pixel sees none; they are in no other number."""
    median_um: float | None
    rms_um: float | None
    p95_um: float | None
    visible_over_contrast: int
    """Pixels that are lit by the sweep, seen by the camera and brighter than the contrast threshold in truth."""
    reconstructed: int
    """Those of them that have a point."""
    share: float | None
    """reconstructed / visible_over_contrast."""


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """report.json."""

    counts: dict[str, int]
    timings_s: dict[str, float]
    """By the clock, per stage."""
    processor_s: dict[str, float] = {}
    """Processor time of all threads, per stage; empty in reports of earlier versions."""
    speed: Speed
    outcome: str
    digest: str
    """Over the frames that were folded."""
    sweep: SweepChecks
    warnings: list[str]
    settings: dict[str, Any]
    versions: dict[str, str]
    truth: TruthErrors | None = None
    noise: NoiseFound | None = None
    """None where the estimate does not ask for it (linear)."""
    calibration: CalibrationUsed | None = None
    """None without one, and in reports of earlier versions."""
    contrast_histogram: list[int]
    """Pixels by brightness range max - min in counts of 8 bit, 256 bins."""


def write_report(path: Path, report: Report) -> None:
    """Write report.json, indented.

    Raises:
        ResultWriteError: the folder cannot be written to.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n")


def read_report(path: Path) -> Report:
    """An existing report.json.

    Raises:
        ScanFileError: not there, or not a report of this version.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=Report)
    except (OSError, msgspec.MsgspecError) as error:
        raise ScanFileError(f"{path} is not a readable report: {error}") from None


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


def truth_errors(path: Path, cloud: Cloud, contrast: int) -> TruthErrors:
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


def checks_of(measured: Mapping[str, float]) -> SweepChecks:
    """The rig's measurements as they came in the ``end`` message."""
    return SweepChecks(**{key: measured[key] for key in SweepChecks.__struct_fields__ if key in measured})
