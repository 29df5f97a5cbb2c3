"""Judges the scan of the demonstration by its report.json, which compares the cloud with the simulated truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquire.contract.errors import EXIT_FAILED, EXIT_INCOMPLETE
from acquire.contract.messaging.messages import Status
from acquire.contract.scan_data.dataset_names import CLOUD_NAME, MAPS_NAME, REPORT_NAME, SEALED_NAME, TRUTH_NAME
from acquire.contract.scan_data.report_file import Report, read_report
from acquire.contract.states import Outcome
from tui.text.status_text import outcome_line

LEAST_SHARE = 0.9
"""Share of the visible pixels over the contrast that must have a point."""
MOST_MEDIAN_UM = 3.0


@dataclass(frozen=True)
class DemoVerdict:
    """The outcome of the demonstration's scan, and whether it succeeded."""

    status: Status
    """The daemon's last status of the scan."""
    report: Report
    results_s: float | None = None
    """Time from the last frame to maps and cloud on disk; None if the worker did not report it."""

    @property
    def folder(self) -> Path:
        """The scan's folder."""
        return Path(self.status.scan_path)

    @property
    def failures(self) -> list[str]:
        """Why the demonstration failed; empty if it succeeded."""
        truth = self.report.truth
        found = []
        if not outcome_line(self.status).startswith("SAVED"):
            found.append(f"the scan is not complete ({outcome_line(self.status)})")
        if truth is None or truth.share is None or truth.median_um is None:
            found.append("the report holds no comparison with the truth")
            return found
        if truth.share < LEAST_SHARE:
            percent = f"{100 * truth.share:.1f} %"
            found.append(f"only {percent} of the visible pixels have a point, less than {100 * LEAST_SHARE:.0f} %")
        if truth.median_um >= MOST_MEDIAN_UM:
            found.append(f"the median error of {truth.median_um:.2f} um is not below {MOST_MEDIAN_UM:g} um")
        return found

    @property
    def exit_status(self) -> int:
        """0 if nothing failed; 4 if frames are missing."""
        if self.status.outcome != Outcome.COMPLETE:
            return EXIT_INCOMPLETE
        return EXIT_FAILED if self.failures else 0

    def findings(self) -> list[str]:
        """The result in a few lines."""
        lines = [
            f"outcome  {outcome_line(self.status)}",
            f"points   {self.report.points or 0}{self._share()}",
            f"error    {self._error()}",
        ]
        return lines + [f"FAILED   {failure}" for failure in self.failures]

    def lines(self, url: str) -> list[str]:
        """The whole summary."""
        counts, timings = self.report.counts, self.report.timings_s
        stages = "".join(f", {name.replace('_', ' ')} {seconds:.2f} s" for name, seconds in timings.items())
        on_disk = (
            "" if self.results_s is None else f", maps and cloud on disk {self.results_s:.2f} s after the last frame"
        )
        names = (SEALED_NAME, MAPS_NAME, CLOUD_NAME, REPORT_NAME, TRUTH_NAME)
        return [
            *self.findings(),
            f"frames   {self.status.triggered} triggered, {self.status.retaken} retaken, "
            f"{counts.get('from_live', 0)} folded live, {counts.get('from_file', 0)} from the file",
            f"timings  sweep {self.status.elapsed_s:.1f} s{on_disk}{stages}",
            *(f"file     {self.folder / name}" for name in names if (self.folder / name).is_file()),
            *([f"page     {url}"] if url else []),
        ]

    def _share(self) -> str:
        truth = self.report.truth
        if truth is None or truth.share is None:
            return ""
        return f" ({100 * truth.share:.1f} % of {truth.visible_over_contrast} visible pixels over the contrast)"

    def _error(self) -> str:
        truth = self.report.truth
        if truth is None or truth.median_um is None:
            return "unknown: the scan has no truth"
        return (
            f"median {truth.median_um:.2f} um, RMS {truth.rms_um:.2f} um, "
            f"95 % below {truth.p95_um:.2f} um (against the simulated truth)"
        )


def report_of(folder: Path) -> Report | None:
    """report.json of a scan's folder; None if there is none yet.

    Raises:
        ScanFileError: it exists but cannot be read.
    """
    path = folder / REPORT_NAME
    return read_report(path) if path.is_file() else None


def is_final(report: Report | None, outcome: str) -> bool:
    """True if the report has the outcome of the scan and the comparison with the truth."""
    return report is not None and report.outcome == outcome and report.truth is not None
