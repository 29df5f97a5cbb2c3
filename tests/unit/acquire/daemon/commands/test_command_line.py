"""Stage, camera, pre-scan and control from the command line, at a daemon with a simulated rig."""

from __future__ import annotations

import json

import pytest

from tests.unit.rig_in_process import RigInProcess
from tui.cli import run


@pytest.fixture
def time_scale():
    return 0.01


@pytest.fixture
def rig(run_dir, tmp_path, monkeypatch, time_scale):
    monkeypatch.setenv("SWEEPSCOPE_RUN", str(run_dir))
    settings = {"sweep.max_rate_hz": 15.0, "simulation.object": "dome", "simulation.time_scale": time_scale}
    with RigInProcess(run_dir, tmp_path / "scans", settings) as found:
        yield found


@pytest.fixture
def sweepscope(capsys):
    """Run a command; returns exit status, stdout, stderr."""

    def call(*arguments: str) -> tuple[int, str, str]:
        status = run(arguments)
        said = capsys.readouterr()
        return status, said.out, said.err

    return call


def test_moves_that_are_waited_for_end_where_they_must(rig, sweepscope):
    status, said, _ = sweepscope("goto", "600", "--wait", "--json")
    assert status == 0 and json.loads(said) == {"ok": True, "target_steps": 600, "position_steps": 600}
    assert sweepscope("jog", "-100", "--wait")[0] == 0 and rig.status()["position_steps"] == 500
    assert sweepscope("home", "--wait")[0] == 0 and rig.status()["position_steps"] == 0


@pytest.mark.parametrize("time_scale", [1.0])
def test_a_move_that_is_stopped_while_it_is_waited_for_is_status_1(rig, sweepscope, monkeypatch):
    import tui.client.wait

    rig.ask("preview", on=True)

    def stop_it(client, longest_s=None):
        client.request("stop")
        return until_rest(client)

    until_rest = tui.client.wait.until_rest
    monkeypatch.setattr(tui.client.wait, "until_rest", stop_it)
    status, _, complaint = sweepscope("goto", "4000", "--wait")
    assert status == 1 and "goto: the stage stopped at" in complaint and complaint.count("\n") == 1


def test_positions_are_given_in_microsteps_um_or_mm(rig, sweepscope):
    for typed, steps in (("1000", 1000), ("0.3175mm", 100), ("635um", 200)):
        assert sweepscope("goto", typed, "--wait")[0] == 0 and rig.status()["position_steps"] == steps
    assert sweepscope("jog", "-63.5um", "--wait")[0] == 0 and rig.status()["position_steps"] == 180


def test_settings_are_set_by_name_and_shown_with_their_limits(rig, sweepscope):
    assert sweepscope("camera", "set", "gain=12", "exposure-ms=20")[0] == 0
    assert rig.status()["camera"] == {"exposure_ms": 20.0, "gain": 12.0, "brightness_percent": 0.0}
    assert "exposure-ms 20  (0.01..75.0)" in sweepscope("camera", "show")[1]
    assert json.loads(sweepscope("camera", "show", "--json")[1])["limits"]["gain"] == [0.0, 20.0]


@pytest.mark.parametrize(
    ("arguments", "exit_status", "words"),
    [
        (("camera", "set", "gain=30"), 1, "gain 30 is outside"),
        (("camera", "set", "gian=9"), 2, "gian=9"),
        (("camera", "set", "gain=loud"), 2, "no number"),
        (("camera", "expose", "--wait"), 1, "the lamp is off"),
        (("goto", "5000"), 1, "stage.travel_max_steps = 4500"),
        (("goto", "15mm"), 1, "stage.travel_max_steps = 4500"),
        (("goto", "10 furlongs"), 2, "type microsteps"),
        (("goto", "5.5"), 2, "write 5.5um"),
        (("jog", "1e400"), 2, "is not a position"),
        (("scan", "--from-proposal"), 1, "sweepscope prescan --wait"),
        (("estimate", "--last-steps", "9000"), 1, "outside the stage's travel"),
        (("control", "take"), 1, "at a terminal only"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(rig, sweepscope, arguments, exit_status, words):
    status, _, complaint = sweepscope(*arguments)
    assert status == exit_status and words in complaint and complaint.count("\n") == 1


def test_a_prescan_is_proposed_and_a_scan_takes_it_over(rig, sweepscope):
    assert sweepscope("lamp", "on")[0] == 0
    status, said, _ = sweepscope("prescan", "--every-steps", "60", "--wait", "--json")
    found = json.loads(said)
    assert status == 0 and found["first_steps"] > 200 and found["last_steps"] < 1100
    status, said, _ = sweepscope("scan", "--from-proposal", "--json", "--purpose", "raw")
    assert status == 0 and json.loads(said)["expected"] == found["frames"]
    assert rig.status()["camera"]["exposure_ms"] == pytest.approx(found["exposure_ms"])


def test_an_activity_that_fails_is_status_1_in_its_words(rig, sweepscope):
    sweepscope("lamp", "on")
    sweepscope("camera", "set", "exposure-ms=1", "gain=0")
    status, _, complaint = sweepscope("camera", "expose", "--wait")
    assert status == 1 and "too dark" in complaint and "1 ms as before" in complaint


def test_an_estimate_is_words_or_one_json_object(rig, sweepscope):
    assert "frames, 0:0" in sweepscope("estimate", "--last-steps", "120")[1]
    assert json.loads(sweepscope("estimate", "--last-steps", "120", "--json")[1])["expected"] == 11


def test_who_sits_at_a_terminal_asks_by_name(rig, sweepscope, monkeypatch):
    monkeypatch.setattr("tui.client.client_name.terminal_name", lambda: "pts/7")
    monkeypatch.setattr("tui.client.client_name.user_name", lambda: "anna")
    assert "anna on pts/7" in sweepscope("control", "take")[1]
    assert rig.status()["control"] == "anna on pts/7"
    monkeypatch.setattr("tui.client.client_name.user_name", lambda: "ben")
    assert "anna on pts/7 holds control" in sweepscope("home")[2]
    assert sweepscope("stop")[0] == 0
