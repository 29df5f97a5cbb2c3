"""The page of a scan: verdict in words, pictures, counts, and where it all came from, in one HTML file."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from acquire.contract.states import outcome_words
from process.html_templates import png_url, render
from process.results.write import write_result

from .figures import contrast_picture, crossing_picture, histogram_picture, section_picture, two_digits
from .load import ScanResults

_TEMPLATE = Path(__file__).with_name("scan_page.html")
_DPI = 130


class ScanAssessment(NamedTuple):
    """What a person should think of a scan."""

    kind: str
    """good, fair, bad."""
    headline: str
    remarks: list[str]


def assess(results: ScanResults) -> ScanAssessment:
    """Bad without points or frames, fair with anything to remark, else good."""
    report = results.report
    counts = report.counts
    saved = outcome_words(report.outcome, counts["committed"], counts["frames"])
    if not counts["points"]:
        return ScanAssessment("bad", f"No points. {saved}.", report.warnings)
    sigma = results.cloud["sigma_um"] if results.cloud is not None else np.zeros(0)
    known = f", each known to {two_digits(np.median(sigma))} um (median standard deviation)" if sigma.size else ""
    headline = f"{grouped(counts['points'])} points{known}. {saved}."
    incomplete = report.outcome != "complete" or counts["missing"] > 0
    kind = "bad" if incomplete else "fair" if report.warnings else "good"
    return ScanAssessment(kind, headline, report.warnings)


def page(results: ScanResults) -> str:
    """The whole page; pictures are in it as PNG."""
    makers = (crossing_picture, contrast_picture, section_picture, histogram_picture)
    figures = [figure for make in makers if (figure := make(results)) is not None]
    return render(
        _TEMPLATE,
        name=str(results.layout.user.get("name") or results.layout.path.parent.name),
        start_time=results.layout.start_time,
        verdict=assess(results),
        pictures=[(_title(figure), png_url(figure, _DPI)) for figure in figures],
        counts=_counts(results),
        measured=_measured(results),
        settings=_settings(results),
        provenance=_provenance(results),
    )


def write_page(path: Path, results: ScanResults) -> None:
    """Write the page.

    Raises:
        ResultWriteError: the folder cannot be written to.
    """
    write_result(path, page(results).encode(errors="backslashreplace"))


def grouped(number: int) -> str:
    """With a thin space between thousands, from five digits on."""
    return f"{number:,}".replace(",", "\u2009") if number >= 10_000 else str(number)


def _counts(results: ScanResults) -> Iterable[tuple[str, str]]:
    for name, number in results.report.counts.items():
        if number or name in ("frames", "points", "missing", "retaken"):
            yield name.replace("_", " "), grouped(number)


def _measured(results: ScanResults) -> Iterable[tuple[str, str]]:
    report = results.report
    if report.noise is not None:
        how = "measured in the frames" if report.noise.measured else "assumed"
        shot = f", 1 count = {1 / report.noise.shot:.0f} electrons" if report.noise.shot > 0 else ""
        yield "noise", f"{report.noise.read:.2f} counts in the dark{shot} ({how})"
    speed = report.speed
    if speed.commanded_um_per_frame is not None:
        yield "commanded", f"{speed.commanded_um_per_frame:.3f} um per frame"
    if speed.ratio is not None:
        yield "calibrated / commanded speed", f"{speed.ratio:.4f}"
    for name, value, unit in (
        ("drift", report.sweep.drift_px, "px"),
        ("steps lost", report.sweep.steps_lost, ""),
        ("brightness change", report.sweep.brightness_change, ""),
    ):
        yield name, "not measured" if value is None else f"{value:.3f} {unit}".strip()
    truth = report.truth
    if truth is not None and truth.median_um is not None and truth.rms_um is not None:
        yield "error against truth", f"median {truth.median_um:.2f} um, RMS {truth.rms_um:.2f} um"


def _settings(results: ScanResults) -> Iterable[tuple[str, str]]:
    for name, value in results.report.settings.items():
        yield name.replace("_", " "), f"{value:g}" if isinstance(value, float) and math.isfinite(value) else str(value)


def _provenance(results: ScanResults) -> Iterable[tuple[str, str]]:
    layout, report = results.layout, results.report
    for key in ("specimen", "operator", "notes", "tags"):
        if value := layout.user.get(key):
            yield key, ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    form = layout.format
    yield "frames", f"{layout.count} of {form.width} x {form.height}, {form.bit_depth} bit, {form.pixel_format}"
    yield "scan", layout.scan_uid
    yield "file", str(layout.path.name)
    yield "digest of the frames", report.digest
    used = report.calibration
    if used is None:
        yield "calibration", "none"
    else:
        age = "of unknown age" if used.age_days is None else f"{used.age_days:.1f} days old at the scan"
        yield "calibration", f"from {used.source}, {age}"
        yield "digest of the calibration", used.sha256
    yield "versions", ", ".join(f"{name} {number}" for name, number in report.versions.items())


def _title(figure: Figure) -> str:
    return "; ".join(axes.get_title() for axes in figure.axes if axes.get_title())
