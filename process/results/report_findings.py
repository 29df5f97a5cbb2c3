"""Owns what the numbers of a scan mean: its noise in the camera's terms, its calibration, and warnings in words."""

from __future__ import annotations

import math
from collections.abc import Collection
from datetime import datetime
from pathlib import Path

import msgspec

from acquire.contract.calibration import Validity
from process.edge_fit.noise_model import ROUNDING_VARIANCE, NoiseModel

from .settings import Settings

SATURATED_SHARE, CUT_SHARE, BRIGHT_SHARE, SEVERAL_SHARE, FILTERED_SHARE = 0.005, 0.02, 0.05, 0.1, 0.05
"""Shares of a scan's crossings from which on a sentence is worth a person's time."""
SECONDS_PER_DAY = 86_400.0


class NoiseFound(msgspec.Struct, frozen=True):
    """Noise of the stored frames, in counts of the stored depth: variance = read^2 + shot x level, rounding apart."""

    read: float
    """Standard deviation in the dark."""
    shot: float
    """Variance per count of brightness; 1 / shot electrons make a count. 0 where the frames show none."""
    measured: bool
    """False: taken from the configuration, because the frames did not tell."""


class CalibrationUsed(msgspec.Struct, frozen=True):
    """Which calibration the points were made with."""

    source: str
    """``the scan``, or the name of the file given instead."""
    sha256: str
    """Of its text."""
    created_utc: str | None = None
    """None where it does not say."""
    age_days: float | None = None
    """At the time of the scan."""


def noise_found(noise: NoiseModel, full: int) -> NoiseFound:
    """The model of the folded signal in terms of the stored one; full: full scale of a falling edge, else 0."""
    floor, slope = (noise.floor + noise.slope * full, -noise.slope) if full else (noise.floor, noise.slope)
    return NoiseFound(math.sqrt(max(floor - ROUNDING_VARIANCE, 0.0)), max(slope, 0.0), noise.measured)


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


def age_warning(settings: Settings, used: CalibrationUsed | None) -> list[str]:
    """A sentence if the calibration is older than it was meant to become."""
    valid = settings.calibration.valid_for if settings.calibration else None
    if used is None or used.age_days is None or valid is None or not valid.days or used.age_days <= valid.days:
        return []
    return [
        f"the calibration was {used.age_days:.0f} days old, it is meant for {valid.days:g}: "
        "check it with 'sweepscope calibrate check'"
    ]


def quality_warnings(counts: dict[str, int], noise: NoiseFound | None, *, shadow: bool = False) -> list[str]:
    """Sentences on what many pixels of a scan have in common; counts as in ``Maps.counts``.

    shadow: the edge of a shadow is swept through a lit room (falling edge), nothing has to be dark.
    """
    crossings = max(counts["crossings"], 1)
    told = (
        ("saturated", SATURATED_SHARE, "are saturated, their plateau is not known: less exposure or gain"),
        ("plateau_not_reached", CUT_SHARE, "were still within the light's edge at the last frame: sweep further"),
        ("no_dark_level", BRIGHT_SHARE, "have no dark level: begin the sweep earlier, keep stray light out"),
        (
            "lit_at_start",
            BRIGHT_SHARE,
            "were lit in the first frame already and have no point: begin the sweep earlier",
        ),
        ("several", SEVERAL_SHARE, "see the light more than once (shadows, reflections): their points may be wrong"),
        (
            "filtered",
            FILTERED_SHARE,
            "were filtered as uncertain or lonely: more light would keep them",
        ),
    )
    words = [
        f"{counts[name]} pixels ({100 * counts[name] / crossings:.1f} % of the crossings) {what}"
        for name, share, what in told
        if counts.get(name, 0) > share * crossings and not (shadow and name == "no_dark_level")
    ]
    if noise is not None and not noise.measured and counts["crossings"]:
        words.append(f"too few pixels to measure the noise: sigma rests on noise_counts, {noise.read:.2g} counts")
    return words


def damage(damaged: Collection[int]) -> list[str]:
    """A sentence on frames that are committed but do not have their checksum."""
    if not damaged:
        return []
    named = ", ".join(str(k) for k in sorted(damaged)[:5])
    return [f"{len(damaged)} frames do not have their checksum and were left out: {named}"]


def no_cloud(settings: Settings, there_is_one: bool, cloud: Path) -> list[str]:
    """Why there is no cloud, and whose cloud stands there."""
    if there_is_one:
        return []
    stale = [f"{cloud} is left from an earlier run, it does not belong to these maps"]
    return [settings.what_is_missing] + (stale if cloud.exists() else [])
