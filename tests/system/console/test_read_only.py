"""A program and a home that cannot be written to: everything works, only slower."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.fakes.scans.small_scans import make_scan
from tests.needs import missing_here

_RUN = (
    "import os, sys; from pathlib import Path; from tests.fuzz.read_only_world import enter_read_only_world; "
    "enter_read_only_world(Path(sys.argv[1])); os.chdir(sys.argv[1]); "
    "os.execv(sys.executable, [sys.executable, '-m', 'tui.cli', *sys.argv[2:]])"
)


def read_only(folder: Path, *arguments: str, **environ: str) -> subprocess.CompletedProcess[str]:
    """The command in a world where only ``folder`` can be written to."""
    if os.getuid() != 0:
        missing_here("only root can make mounts")
    known = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA", "XDG", "SWEEPSCOPE"))}
    known |= {"PYTHONPATH": str(ROOT), "HOME": "/proc/nowhere", "SWEEPSCOPE_RUN": str(folder / "run")}
    command = [sys.executable, "-c", _RUN, str(folder), *arguments]
    return subprocess.run(command, env=known | environ, capture_output=True, text=True, check=False, cwd=folder)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_scan_is_reconstructed_uncached_and_one_line_says_why_it_takes_long(tmp_path):
    make_scan(tmp_path / "scan")
    done = read_only(tmp_path, "reconstruct", "scan")
    assert "(a bug" not in done.stderr and "Traceback" not in done.stderr
    assert (tmp_path / "scan/maps.h5").is_file()
    assert done.stderr.count("NUMBA_CACHE_DIR") == 1


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (("verify", "scan"), 0),
        (("info", "scan"), 0),
        (("scans", "."), 0),
        (("config",), 0),
        (("keys", "make"), 1),
        (("reconstruct", "scan", "--out", "/proc/nowhere"), 1),
        (("copy", "scan", "/etc"), 1),
        (("report", "/etc/report.tar.gz"), 1),
        (("status",), 3),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else str(value),
)
def test_each_command_works_or_ends_with_one_sentence(tmp_path, arguments, status):
    make_scan(tmp_path / "scan")
    done = read_only(tmp_path, *arguments, **({"NUMBA_CACHE_DIR": "/proc/nowhere"} if status == 0 else {}))
    assert done.returncode == status, done.stderr
    assert "(a bug" not in done.stderr and "Traceback" not in done.stderr
    if status:
        assert sum(line.startswith("sweepscope: ") for line in done.stderr.splitlines()) == 1


def test_a_run_directory_that_cannot_be_written_is_one_sentence(tmp_path):
    done = read_only(tmp_path, "writer", SWEEPSCOPE_RUN="/etc/sweepscope-run")
    assert done.returncode == 1 and done.stderr.startswith("sweepscope: cannot create the socket directory")
