"""Owns the page of a scan: verdict in words, pictures, counts, and where it all came from, in one HTML file."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from acquire.contract.states import outcome_words
from process.atomic_write import replacing

from .figures import contrast_picture, crossing_picture, histogram_picture, section_picture, two_digits
from .load import ScanResults

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:64em;margin:2em auto;padding:0 1em;color:#222}
h1{font-size:1.5em;margin:0 0 .2em}h2{font-size:1.1em;margin:2em 0 .4em;border-bottom:1px solid #ddd}
.verdict{padding:.7em 1em;border-left:6px solid;margin:1em 0;background:#f7f7f7}
.good{border-color:#2e7d32}.fair{border-color:#e08e0b}.bad{border-color:#b00020}
figure{margin:1.2em 0}img{max-width:100%;display:block}figcaption{color:#666;font-size:.9em}
table{border-collapse:collapse}td,th{padding:.15em 1.2em .15em 0;text-align:left;vertical-align:top;font-weight:normal}
th{color:#666}td.n{text-align:right;font-variant-numeric:tabular-nums}code{font-size:.85em;overflow-wrap:anywhere}
.side{display:grid;grid-template-columns:repeat(auto-fit,minmax(20em,1fr));gap:0 2em}
"""


class Verdict(NamedTuple):
    """What a person should think of a scan."""

    kind: str
    """good, fair, bad."""
    headline: str
    remarks: list[str]


def verdict(results: ScanResults) -> Verdict:
    """Bad without points or frames, fair with anything to remark, else good."""
    report = results.report
    counts = report.counts
    saved = outcome_words(report.outcome, counts["committed"], counts["frames"])
    if not counts["points"]:
        return Verdict("bad", f"No points. {saved}.", report.warnings)
    sigma = results.cloud["sigma_um"] if results.cloud is not None else np.zeros(0)
    known = f", each known to {two_digits(np.median(sigma))} um (median standard deviation)" if sigma.size else ""
    headline = f"{grouped(counts['points'])} points{known}. {saved}."
    incomplete = report.outcome != "complete" or counts["missing"] > 0
    kind = "bad" if incomplete else "fair" if report.warnings else "good"
    return Verdict(kind, headline, report.warnings)


def page(results: ScanResults) -> str:
    """The whole page; pictures are in it as PNG."""
    name = str(results.layout.user.get("name") or results.layout.path.parent.name)
    said = verdict(results)
    remarks = "".join(f"<li>{html.escape(line)}</li>" for line in said.remarks) or "<li>Nothing to remark.</li>"
    pictures = (crossing_picture, contrast_picture, section_picture, histogram_picture)
    images = "".join(_image(figure) for make in pictures if (figure := make(results)) is not None)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(name)}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{html.escape(name)}</h1>"
        f"<div>{html.escape(results.layout.start_time)}</div>"
        f'<div class="verdict {said.kind}"><b>{html.escape(said.headline)}</b><ul>{remarks}</ul></div>'
        f'{images}<div class="side"><div><h2>Counts</h2>{_table(_counts(results), number=True)}</div>'
        f"<div><h2>Measured</h2>{_table(_measured(results))}<h2>Settings</h2>{_table(_settings(results))}</div></div>"
        f"<h2>Provenance</h2>{_table(_provenance(results))}</body></html>\n"
    )


def write_page(path: Path, results: ScanResults) -> None:
    """Write the page.

    Raises:
        ResultWriteError: the folder cannot be written to.
    """
    text = page(results)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


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


def _table(rows: Iterable[tuple[str, str]], *, number: bool = False) -> str:
    kind = ' class="n"' if number else ""
    cells = "".join(f"<tr><th>{html.escape(name)}</th><td{kind}>{_value(value)}</td></tr>" for name, value in rows)
    return f"<table>{cells}</table>"


def _value(text: str) -> str:
    long = len(text) >= 32 and " " not in text
    return f"<code>{html.escape(text)}</code>" if long else html.escape(text)


def _image(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    title = html.escape("; ".join(axes.get_title() for axes in figure.axes if axes.get_title()))
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<figure><img alt="{title}" src="data:image/png;base64,{data}"></figure>'
