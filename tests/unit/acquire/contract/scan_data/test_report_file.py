"""report.json: what is written is read back, also from earlier versions; what is no report is refused or left out."""

from __future__ import annotations

import json

import pytest

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.report_file import (
    Report,
    Speed,
    SweepChecks,
    find_report,
    read_report,
    report_bytes,
)


def report() -> Report:
    return Report(
        counts={"points": 3},
        timings_s={"fold": 0.5},
        contrast_histogram=[0] * 256,
        speed=Speed(9.5),
        outcome="complete",
        digest="ab",
        sweep=SweepChecks(drift_px=0.5),
        warnings=[],
        settings={"contrast": 70},
        versions={},
    )


def test_a_report_of_an_earlier_version_can_be_read(tmp_path):
    (tmp_path / "report.json").write_bytes(report_bytes(report()))
    fields = json.loads((tmp_path / "report.json").read_text())
    for later in ("noise", "calibration", "processor_s"):
        del fields[later]
    (tmp_path / "report.json").write_text(json.dumps(fields))
    assert read_report(tmp_path / "report.json") == report()


def test_a_report_reads_back_as_it_was_written(tmp_path):
    (tmp_path / "report.json").write_bytes(report_bytes(report()))
    assert read_report(tmp_path / "report.json") == report()


def test_what_is_not_known_stands_there_as_null(tmp_path):
    (tmp_path / "report.json").write_bytes(report_bytes(report()))
    found = json.loads((tmp_path / "report.json").read_text())
    unknown = {"steps_lost": None, "brightness_change": None, "light_changed_at": None}
    assert found["sweep"] == {"drift_px": 0.5, **unknown}
    assert found["speed"]["ratio"] is None and found["truth"] is None


def test_a_report_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(ScanFileError, match=r"report\.json"):
        read_report(tmp_path / "report.json")


def test_only_the_checks_that_were_measured_are_taken():
    assert SweepChecks.of({"drift_px": 1.0, "other": 2.0}) == SweepChecks(drift_px=1.0)


@pytest.mark.parametrize("text", ["", "{", "[1]", "{}", '{"counts": {"points": "many"}}', "[" * 100_000])
def test_a_list_of_scans_does_without_a_report_that_cannot_be_read(tmp_path, text):
    assert find_report(tmp_path) is None
    (tmp_path / "report.json").write_text(text)
    assert find_report(tmp_path) is None


def test_a_report_that_is_too_large_is_refused_unread(tmp_path):
    with (tmp_path / "report.json").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(ScanFileError, match="not a readable report: it is over"):
        read_report(tmp_path / "report.json")
