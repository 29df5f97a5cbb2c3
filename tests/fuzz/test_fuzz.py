"""Every subcommand, mutated in every way, ends with one sentence and a documented status."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.fuzz import corpus
from tests.fuzz.cases import CHANGES_MACHINE, commands, make_cases
from tests.fuzz.runner import End, judge

COUNT = 130
"""Each subcommand about twice."""


@pytest.fixture
def cases(tmp_path: Path) -> list:
    return make_cases(500, 1, corpus.build(tmp_path))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_mutated_commands_end_with_one_sentence_and_a_documented_status() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--count", str(COUNT), "--seed", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-2000:]


def test_every_subcommand_is_in_turn(cases) -> None:
    run = [" ".join(case.arguments) for case in cases]
    for words, _ in commands():
        assert any(" ".join(words) in " ".join(line.replace(" --dry-run", "").split()) for line in run), words


def test_nothing_that_changes_the_machine_is_run(cases) -> None:
    found = [case for case in cases if CHANGES_MACHINE.intersection(case.arguments)]
    assert found and all("--dry-run" in case.arguments for case in found)


def test_the_same_seed_makes_the_same_cases(tmp_path) -> None:
    known = corpus.build(tmp_path)
    assert make_cases(50, 7, known) == make_cases(50, 7, known) != make_cases(50, 8, known)


@pytest.mark.parametrize(
    ("status", "err", "wrong"),
    [
        (1, "sweepscope: it failed\n", ""),
        (1, "", "0 sentences"),
        (1, "sweepscope: it failed\nsweepscope: again\n", "2 sentences"),
        (1, "sweepscope: unexpected KeyError: 'x' (a bug: ...)\n", "a bug"),
        (1, "Traceback (most recent call last):\n", "a traceback"),
        (0, "Exception ignored in: <stdout>\n", "a traceback"),
        (120, "", "status 120"),
        (-11, "", "status -11"),
    ],
)
def test_the_judge_sees_what_is_wrong(cases, status, err, wrong) -> None:
    case = next(case for case in cases if case.arguments[0] == "scans" and case.streams == "pipe")
    assert judge(case, End(status, "", err, 0.1, 0.1, told_to_end=False)) == wrong


def test_the_judge_sees_a_silent_command(cases) -> None:
    case = next(case for case in cases if case.arguments[0] == "scans")
    assert "silent" in judge(case, End(0, "", "", 11.0, 11.0, told_to_end=False))
    assert judge(case, End(0, "a\nb\nc\n", "", 11.0, 11.0, told_to_end=False)) == ""


def test_all_commands_have_parameters_of_known_types() -> None:
    """A new type of parameter gets its own mutations."""
    kinds = {type(parameter.type).__name__ for _, command in commands() for parameter in command.params}
    assert kinds <= {"Choice", "Path", "IntRange", "Number", "FloatRange", "_Text", "StringParamType", "BoolParamType",
                     "IntParamType", "FloatParamType", "Position"}  # fmt: skip
