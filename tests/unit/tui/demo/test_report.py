"""The demonstration's verdict on its own scan."""

from __future__ import annotations

import json

import pytest
from msgspec.structs import replace

from acquire.contract.errors import ConfigError, ScanFileError
from acquire.contract.scan_data.report_file import Report, TruthErrors
from acquire.contract.states import Outcome, State
from tests.fakes.fake_daemon import SWEEPING
from tui.demo.report import DemoVerdict, is_final, report_of
from tui.demo.rig import DemoOptions, DemoRig

SAVED = replace(SWEEPING, state=State.IDLE, outcome=Outcome.COMPLETE, committed=527, durable=527)
TRUTH = {
    "median_um": 0.44, "rms_um": 14.5, "p95_um": 1.22, "share": 0.999, "visible_over_contrast": 71_601,
}  # fmt: skip


def verdict(status=SAVED, **truth) -> DemoVerdict:
    errors = TruthErrors(points=73_177, points_beside=0, reconstructed=71_529, **TRUTH | truth)
    return DemoVerdict(status, Report(outcome="complete", counts={"points": 73_177}, truth=errors))


def test_a_complete_scan_near_the_truth_succeeds():
    assert verdict().failures == []
    assert verdict().exit_status == 0


@pytest.mark.parametrize(
    ("name", "value"), [("share", 0.899), ("median_um", 3.0), ("share", None), ("median_um", None)]
)
def test_too_few_points_or_too_large_an_error_fail(name, value):
    found = verdict(**{name: value})
    assert found.failures and found.exit_status == 1
    assert any("FAILED" in line for line in found.lines(""))


def test_a_report_without_truth_fails():
    assert DemoVerdict(SAVED, Report(counts={})).exit_status == 1


def test_a_scan_that_lacks_frames_is_incomplete_whatever_its_points():
    stopped = replace(SAVED, outcome=Outcome.STOPPED, committed=400, missing=127)
    assert verdict(stopped).exit_status == 4


def test_the_summary_has_points_error_timings_and_the_address():
    text = "\n".join(verdict().lines("http://127.0.0.1:1/?token=x"))
    for words in ("SAVED", "73177", "99.9 %", "median 0.44 um", "sweep 27.6 s", "http://127.0.0.1:1/?token=x"):
        assert words in text


def test_a_report_is_final_when_it_has_the_outcome_and_the_truth():
    assert not is_final(None, "complete")
    report = verdict().report
    assert not is_final(replace(report, outcome="running"), "complete")
    assert not is_final(replace(report, truth=None), "complete")
    assert is_final(report, "complete")


def test_a_damaged_report_is_told_by_its_path(tmp_path):
    assert report_of(tmp_path) is None
    (tmp_path / "report.json").write_text("{")
    with pytest.raises(ScanFileError, match=r"report\.json"):
        report_of(tmp_path)
    (tmp_path / "report.json").write_text(json.dumps([1]))
    with pytest.raises(ScanFileError, match="not a readable report"):
        report_of(tmp_path)


def test_the_demonstration_reads_no_configuration_of_this_machine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text('[stage]\nkind = "uno"\n')
    monkeypatch.setenv("SWEEPSCOPE_CAMERA__KIND", "genicam")
    rig = DemoRig(DemoOptions(size=(256, 192), frames=100, data_dir=tmp_path / "d"), print)
    try:
        loaded = rig.config.rig
        assert (loaded.stage.kind, loaded.camera.kind, loaded.viewer.port) == ("simulated", "simulated", 0)
        assert (loaded.camera.width, loaded.camera.height) == (256, 192)
        assert loaded.sweep.last_steps // loaded.sweep.steps_per_frame + 1 == 100
        assert not [name for name in rig.supervisor.environ if name.startswith("SWEEPSCOPE_CAMERA")]
    finally:
        import shutil

        shutil.rmtree(rig.run_dir)


def test_a_setting_out_of_bounds_leaves_no_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "t"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "t").mkdir()
    with pytest.raises(ConfigError, match="camera.width"):
        DemoRig(DemoOptions(size=(1, 1), data_dir=tmp_path / "d"), print)
    assert list((tmp_path / "t").iterdir()) == []
