"""The installed command: exit statuses, one line for every error, JSON, quick help."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from acquire.contract.states import State
from tests.fakes.fake_daemon import FakeDaemon
from tests.waiting import output_of, run

SUBCOMMANDS = [
    *("daemon", "writer", "worker", "viewer", "console", "up", "demo"),
    *("import", "reconstruct", "verify", "info", "config", "version"),
    *("status", "scan", "estimate", "pause", "resume", "stop", "goto", "jog", "home", "zero"),
    *("lamp", "camera", "prescan", "control"),
]


def sweepscope(*arguments: str, run_dir: Path | None = None, **environ: str) -> subprocess.CompletedProcess[str]:
    environ |= {"SWEEPSCOPE_RUN": str(run_dir or "/nonexistent")}
    command = [sys.executable, "-m", "tui.cli", *arguments]
    environ = {**os.environ, **environ}
    return run(command, env=environ)


def assert_one_line(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("sweepscope: ")
    for word in words:
        assert word in done.stderr
    assert "Traceback" not in done.stdout + done.stderr


def test_every_subcommand_is_there():
    help_text = sweepscope("--help").stdout
    assert [name for name in SUBCOMMANDS if f"\n  {name} " not in help_text] == []


def test_help_loads_none_of_the_heavy_libraries():
    code = (
        "import sys\nfrom tui.cli import run\nassert run(['--help']) == 0\n"
        "heavy = {'numpy', 'h5py', 'cv2', 'numba', 'zmq', 'textual', 'viser', 'rich', 'msgspec'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    "arguments",
    [("frobnicate",), ("scan", "--frobnicate"), ("goto",), ("goto", "here"), ("reconstruct", "x", "--edge", "soft")],
    ids=" ".join,
)
def test_wrong_usage_is_status_2_with_one_line(arguments: Sequence[str]):
    done = sweepscope(*arguments)
    assert done.returncode == 2
    assert_one_line(done, "--help")


@pytest.mark.parametrize("arguments", [("status",), ("scan",), ("stop",), ("goto", "-5")], ids=" ".join)
def test_no_daemon_is_status_3_with_one_line(arguments: Sequence[str], run_dir):
    done = sweepscope(*arguments, run_dir=run_dir)
    assert done.returncode == 3
    assert_one_line(done, str(run_dir), "sweepscope up")


@pytest.mark.parametrize("command", ["verify", "info", "reconstruct"])
def test_a_scan_that_is_not_there_is_status_1_with_one_line(command, tmp_path):
    done = sweepscope(command, str(tmp_path / "nothing"))
    assert done.returncode == 1
    assert_one_line(done, "nothing")


def test_an_empty_folder_cannot_be_imported(tmp_path):
    done = sweepscope("import", str(tmp_path), str(tmp_path / "scan.h5"))
    assert done.returncode == 1
    assert_one_line(done, str(tmp_path))
    assert not (tmp_path / "scan.h5").exists()


def test_an_unknown_key_in_the_configuration_is_told_with_the_nearest_one(tmp_path):
    (tmp_path / "rig.toml").write_text("[camera]\nexposure_mss = 3\n")
    done = sweepscope("--config", str(tmp_path / "rig.toml"), "config")
    assert done.returncode == 1
    assert_one_line(done, "camera.exposure_mss", "did you mean camera.exposure_ms?")


def test_a_console_without_a_terminal_says_so_in_one_line():
    done = sweepscope("console")
    assert done.returncode == 1
    assert_one_line(done, "needs a terminal", "stdin, stdout, stderr")
    assert "\x1b" not in done.stdout + done.stderr


def test_a_bug_is_one_line_with_a_hint_and_a_traceback_only_when_asked_for(monkeypatch, capsys):
    from tui import cli
    from tui.commands import installation

    def broken(**_):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(installation.version, "callback", broken)
    assert cli.run(["version"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "ZeroDivisionError: oh" in said and "--debug" in said
    assert cli.run(["--debug", "version"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_an_interrupt_is_quiet_and_130(monkeypatch, capsys):
    from tui import cli
    from tui.commands import installation

    def interrupted(**_):
        raise KeyboardInterrupt

    monkeypatch.setattr(installation.version, "callback", interrupted)
    assert cli.run(["version"]) == 130
    assert capsys.readouterr().err.strip() == ""


def test_the_effective_configuration_names_every_origin(tmp_path):
    (tmp_path / "rig.toml").write_text("[sweep]\nlast_steps = 300\n")
    path = str(tmp_path / "rig.toml")
    text = sweepscope("--config", path, "config", SWEEPSCOPE_VIEWER__PORT="0").stdout
    assert f"last_steps = 300  # {path}" in text
    assert "port = 0  # SWEEPSCOPE_VIEWER__PORT" in text
    assert "first_steps = 0  # default" in text
    facts = json.loads(sweepscope("--config", path, "config", "--json").stdout)
    assert facts["values"]["sweep"]["last_steps"] == 300
    assert facts["origins"]["sweep.last_steps"] == path


def test_the_version_is_json_when_asked_for():
    assert set(json.loads(sweepscope("version", "--json").stdout)) == {"program", "protocol", "layout"}


def test_status_is_words_or_one_json_object(run_dir):
    with FakeDaemon(run_dir):
        assert "IDLE" in sweepscope("status", run_dir=run_dir).stdout
        assert json.loads(sweepscope("status", "--json", run_dir=run_dir).stdout)["state"] == State.IDLE


def test_commands_reach_the_daemon_with_their_arguments(run_dir):
    with FakeDaemon(run_dir, frames_per_tick=0) as daemon:
        for arguments in (
            ("scan", "--name", "ear", "--last-steps", "30", "--tag", "a", "--tag", "b"),
            ("pause",), ("resume",), ("stop",), ("goto", "-7"), ("jog", "-3"), ("home",), ("zero",),
        ):  # fmt: skip
            done = sweepscope(*arguments, run_dir=run_dir)
            assert done.returncode == 0, done.stderr
        assert daemon.commands == [
            ("scan", {"name": "ear", "last_steps": 30, "tags": ["a", "b"]}),
            ("pause", {}), ("resume", {}), ("stop", {}), ("goto", {"position_steps": -7}), ("jog", {"steps": -3}),
            ("home", {}), ("zero", {}),
        ]  # fmt: skip


def test_a_refused_command_is_status_1_in_the_daemons_words(run_dir):
    with FakeDaemon(run_dir) as daemon:
        daemon.refuse["home"] = "a scan is running"
        done = sweepscope("home", run_dir=run_dir)
        assert done.returncode == 1
        assert_one_line(done, "home was refused: a scan is running")


def test_a_scan_that_is_waited_for_ends_with_0_when_complete(run_dir):
    with FakeDaemon(run_dir, frames_per_tick=20, expected=60):
        done = sweepscope("scan", "--wait", "--json", run_dir=run_dir)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["outcome"] == "complete"


def test_a_scan_that_is_stopped_while_it_is_waited_for_ends_with_4(run_dir):
    with FakeDaemon(run_dir, frames_per_tick=1, expected=10_000) as daemon:
        command = [sys.executable, "-m", "tui.cli", "scan", "--wait"]
        environ = {**os.environ, "SWEEPSCOPE_RUN": str(run_dir)}
        waiting = subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True)
        daemon.asked("scan")
        sweepscope("stop", run_dir=run_dir)
        said, _ = output_of(waiting)
        assert waiting.returncode == 4
        assert "stopped: " in said
