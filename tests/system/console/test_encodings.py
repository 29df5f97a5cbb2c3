"""Nothing that is printed, named or read ends a command by one of its characters."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from tests.fakes.fake_daemon import SWEEPING, FakeDaemon
from tests.fakes.processes.pty_console import PtyConsole
from tests.system.console.test_cli import assert_one_line, sweepscope
from tests.waiting import run

LOCALES: list[dict[str, str]] = [
    {"PYTHONIOENCODING": "iso8859-1"},
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "cp1252:strict"},
    {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"LC_ALL": "xx_YY.nonsense", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
]
BAD = os.fsdecode(b"bad\xff")
ODD = msgspec.structs.replace(SWEEPING, scan_path="/data/\u4e2d\u00e9\u2502-stapes", message="f\u00fcr \u2026")


def named(locale: dict[str, str]) -> str:
    return " ".join(locale.values())


@pytest.mark.parametrize("locale", LOCALES, ids=named)
def test_the_status_is_shown_in_every_locale(run_dir, locale):
    environ = {**os.environ, "SWEEPSCOPE_RUN": str(run_dir), **locale}
    with FakeDaemon(run_dir, ODD):
        done = subprocess.run(
            [sys.executable, "-m", "tui.cli", "status"], env=environ, capture_output=True, check=False
        )
    assert done.returncode == 0, done.stderr
    assert b"SWEEPING" in done.stdout and done.stderr == b""


def test_an_ascii_stream_gets_nothing_but_ascii(run_dir):
    with FakeDaemon(run_dir, ODD):
        done = sweepscope("status", run_dir=run_dir, PYTHONIOENCODING="ascii")
    assert done.stdout.isascii() and "\\u4e2d" in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("scan", "--name", BAD),
        ("scan", "--tag", BAD),
        ("estimate", "--operator", BAD),
        ("camera", "capture", BAD),
        ("notes", BAD, "--notes", BAD),
        ("resume", BAD),
        ("keys", "allow", BAD, "x"),
        ("info", BAD),
        ("verify", BAD),
        ("reconstruct", BAD),
        ("recover", BAD),
        ("copy", BAD, BAD),
        ("import", BAD, BAD),
        ("--config", BAD, "config"),
        (BAD,),
    ],
    ids=lambda arguments: ascii(" ".join(arguments)),
)
def test_a_name_with_an_undecodable_byte_is_one_sentence(run_dir, arguments):
    with FakeDaemon(run_dir):
        done = sweepscope(*arguments, run_dir=run_dir)
    assert done.returncode in (1, 2)
    assert_one_line(done)
    assert "(a bug" not in done.stderr


@pytest.mark.parametrize("variable", ["SWEEPSCOPE_STORAGE__DATA_DIR", "SWEEPSCOPE_RUN", "SWEEPSCOPE_CONFIG", "HOME"])
def test_a_variable_with_an_undecodable_byte_is_one_sentence(variable):
    environ = {name: value for name, value in os.environ.items() if not name.startswith("SWEEPSCOPE_")}
    command = [sys.executable, "-m", "tui.cli", "up" if variable == "SWEEPSCOPE_RUN" else "scans"]
    done = run(command, env=environ | {variable: "/tmp/" + BAD})
    assert done.returncode == 1
    assert_one_line(done)
    assert "(a bug" not in done.stderr


def test_a_user_whose_name_is_no_utf8_can_ask(run_dir):
    master, slave = pty.openpty()
    try:
        with FakeDaemon(run_dir) as fake:
            environ = {**os.environ, "SWEEPSCOPE_RUN": str(run_dir), "LOGNAME": BAD}
            run([sys.executable, "-m", "tui.cli", "stop"], env=environ, stdin=slave, check=True)
            assert [name for name, _ in fake.commands] == ["stop"]
    finally:
        os.close(master)
        os.close(slave)


def test_a_configuration_from_a_windows_editor_is_read(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_bytes(b"\xef\xbb\xbf[camera]\r\ngain = 3.5\r\n")
    done = sweepscope("--config", str(path), "config")
    assert done.returncode == 0 and "gain = 3.5" in done.stdout


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[camera]\ngain = 3.5\n".encode("utf-16"), "UTF-16"),
        (b"[camera]\n# f\xfcr\n", "line 2"),
        (b"[camera]\0\n", "NUL"),
        (b"a = " + b"[" * 100_000, "not valid TOML"),
        (b"a = " + b"9" * 10_000, "not valid TOML"),
    ],
)
def test_a_configuration_that_is_no_text_is_one_sentence(tmp_path, content, words):
    path = tmp_path / "rig.toml"
    path.write_bytes(content)
    done = sweepscope("--config", str(path), "config")
    assert done.returncode == 1
    assert_one_line(done, str(path), words)


def test_a_reader_that_ends_early_is_no_error():
    done = subprocess.run(
        ["sh", "-c", f"{sys.executable} -m tui.cli config | head -1"], stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    assert done.stderr == ""


def test_a_full_disk_behind_the_output_is_one_sentence():
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-m", "tui.cli", "config"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr == "sweepscope: No space left on device: fix that, then try again\n"


def test_the_console_draws_ascii_where_the_locale_lacks_its_signs(run_dir, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "iso8859-1")
    with FakeDaemon(run_dir, ODD), PtyConsole(run_dir) as console:
        console.wait_for("SWEEPING")
        painted = console.painted
    assert b"\\u" not in painted
    painted.decode("iso8859-1")
    assert not [byte for byte in painted if 0x80 <= byte < 0xA0]


def test_the_console_refuses_a_terminal_that_cannot_place_a_cursor():
    master, slave = pty.openpty()
    try:
        process = subprocess.run(
            [sys.executable, "-m", "tui.cli", "console"],
            stdin=slave, stdout=slave, stderr=slave, env={**os.environ, "TERM": "dumb"}, check=False,
        )  # fmt: skip
        assert process.returncode == 1 and b"TERM=dumb" in os.read(master, 4096)
    finally:
        os.close(master)
        os.close(slave)
