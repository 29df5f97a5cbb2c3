"""report.json beside a scan: counts, timings, noise, calibration, warnings, and errors where the truth is known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from acquire.contract.errors import ScanFileError
from acquire.contract.files import read_text, reason

from .dataset_names import REPORT_NAME

MAX_REPORT_BYTES = 16 * 1024 * 1024


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

    @classmethod
    def of(cls, measured: Mapping[str, float]) -> SweepChecks:
        """From the rig's measurements as they came in the ``end`` message; others than ours are left out."""
        return cls(**{name: measured[name] for name in cls.__struct_fields__ if name in measured})


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


class NoiseFound(msgspec.Struct, frozen=True):
    """Noise of the stored frames, in counts of the stored depth: variance = read^2 + shot x level, rounding apart."""

    read: float
    """Standard deviation in the dark."""
    shot: float
    """Variance per count of brightness; 1 / shot electrons make a count. 0 where the frames show none."""
    measured: bool
    """False: taken from the configuration, because too few pixels could be measured."""


class CalibrationUsed(msgspec.Struct, frozen=True):
    """Which calibration the points were made with."""

    source: str
    """``the scan``, or the name of the file given instead."""
    sha256: str
    """Of its text."""
    created_utc: str | None = None
    """None if not recorded."""
    age_days: float | None = None
    """At the time of the scan."""


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """report.json."""

    counts: dict[str, int]
    timings_s: dict[str, float] = {}
    """Elapsed time per stage."""
    processor_s: dict[str, float] = {}
    """Processor time of all threads, per stage; empty in reports of earlier versions."""
    speed: Speed = Speed()
    outcome: str = ""
    digest: str = ""
    """Over the frames that were folded."""
    sweep: SweepChecks = SweepChecks()
    warnings: list[str] = []
    notes: list[str] = []
    """What is no fault, but worth knowing."""
    settings: dict[str, Any] = {}
    versions: dict[str, str] = {}
    truth: TruthErrors | None = None
    noise: NoiseFound | None = None
    """None where the estimate does not ask for it (linear)."""
    calibration: CalibrationUsed | None = None
    """None without one, and in reports of earlier versions."""
    contrast_histogram: list[int] = []
    """Pixels by brightness range max - min in counts of 8 bit, 256 bins."""

    @property
    def points(self) -> int | None:
        """Points of the cloud; None if not recorded."""
        return self.counts.get("points")


def report_bytes(report: Report) -> bytes:
    """The content of report.json, indented."""
    return msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n"


def read_report(path: Path) -> Report:
    """An existing report.json.

    Raises:
        ScanFileError: not there, or not a report.
    """
    try:
        return msgspec.json.decode(read_text(path, MAX_REPORT_BYTES), type=Report)
    except (OSError, ValueError, RecursionError) as error:
        raise ScanFileError(f"{path} is not a readable report: {reason(error)}") from None


def find_report(folder: Path) -> Report | None:
    """report.json of a scan's folder; None where there is none or it cannot be read."""
    try:
        return read_report(folder / REPORT_NAME)
    except ScanFileError:
        return None
