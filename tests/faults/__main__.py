"""``make faults``: every row over many points and seeds, each protection switched off in turn, kills, bombs; a table.

python -m tests.faults --points 3 --seeds 2 --kills 20 --sabotage --write docs/faults.md
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from acquire.contract.faults import FAULTS

from .bombard import bombard
from .firmware_rows import FIRMWARE_ROWS
from .harness import run_scan
from .kills import kill_many
from .rows import ROWS
from .sabotage import PROTECTIONS, can_be_taken_away

BEGIN, END = "<!-- made by `make faults` -->", "<!-- end of what `make faults` made -->"


CHANCES = 4
"""Seeds with which a protection is taken away before it counts as unnoticed."""


@dataclass
class Account:
    """What became of one row."""

    points: int = 0
    held: int = 0
    failures: list[str] = field(default_factory=list)
    protections: int = 0
    caught: int = 0
    missed: list[str] = field(default_factory=list)


def _try(fault: str, at: float, seed: int, sabotage: str = "", mode: str = "step") -> str:
    """Run once; empty when the promise held, else why not in one line."""
    try:
        run_scan(fault, at, seed, sabotage, mode)
    except KeyboardInterrupt:
        raise
    except pytest.skip.Exception as skipped:
        print(f"  in part only: {skipped}", flush=True)
    except BaseException as error:
        # whatever a test can raise is an answer here
        where = traceback.extract_tb(error.__traceback__)[-1]
        return (str(error).strip().splitlines() or [""])[0][:160] or f"{type(error).__name__}: {where.line}"
    return ""


def _without(fault: str, protection: str, seed: int, mode: str) -> str:
    """Why the promise broke without a protection; noise hurts by chance, so it has some chances to."""
    for chance in range(CHANCES):
        why = _try(fault, 0.4, seed + chance, protection, mode)
        if why:
            return why
    return ""


def _row(fault: str, options: argparse.Namespace) -> Account:
    account = Account()
    for seed in range(options.seed, options.seed + options.seeds):
        for point in range(options.points):
            at = (point + 0.5) / options.points
            account.points += 1
            why = _try(fault, at, seed, mode=options.mode)
            account.held += not why
            if why:
                account.failures.append(f"{fault} at={at:.3f} seed={seed}: {why}")
                print(f"  LOST {account.failures[-1]}", flush=True)
    for name, protection in PROTECTIONS.items():
        if options.sabotage and protection.row == fault:
            account.protections += 1
            assert can_be_taken_away(name), f"{name!r} is not where it is looked for"
            why = _without(fault, name, options.seed, options.mode)
            account.caught += bool(why)
            print(f"  without {name!r}: {'red: ' + why if why else 'STAYED GREEN'}", flush=True)
            if not why:
                account.missed.append(f"{fault} without {name!r} stayed green")
    return account


def _table(accounts: dict[str, Account], options: argparse.Namespace) -> list[str]:
    lines = [
        f"{options.points} points in the sweep, {options.seeds} seeds from {options.seed}, {options.mode} mode.",
        "",
        "| fault | what happens | runs | held | lost | protections switched off | noticed |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for code, row in FAULTS.items():
        if code in accounts:
            one = accounts[code]
            lost = one.points - one.held
            lines.append(
                f"| {code} | {row.happened} | {one.points} | {one.held} | {lost} | {one.protections} | {one.caught} |"
            )
    return lines


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make faults", description=__doc__)
    parser.add_argument("--rows", default=",".join(sorted(ROWS | FIRMWARE_ROWS)), help="such as F01,F03; '': none")
    parser.add_argument("--mode", choices=("step", "fly"), default="step", help="of the sweeps")
    parser.add_argument("--points", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kills", type=int, default=0, help="SIGKILLs of a random process at random times")
    parser.add_argument("--controller", choices=("simulated", "emulator"), default="simulated", help="for the kills")
    parser.add_argument("--bombs", type=int, default=0, help="messages that nobody should send, for each socket")
    parser.add_argument("--sabotage", action="store_true", help="switch each protection off in turn")
    parser.add_argument("--write", type=Path, help="put the table into this file, between its marks")
    return parser.parse_args()


def main() -> int:
    """Run what was asked for; 0 only if everything held and every sabotage was noticed."""
    options, began = _options(), time.monotonic()
    accounts = {fault: _row(fault, options) for fault in filter(None, options.rows.split(","))}
    lines = _table(accounts, options)
    kills = kill_many(options.kills, options.seed, emulated=options.controller == "emulator") if options.kills else None
    if kills is not None:
        lines += ["", kills.words()]
    if options.bombs:
        lines += ["", bombard(options.bombs, options.seed)]
    print("\n".join(lines), f"\n{time.monotonic() - began:.0f} s", flush=True)
    if options.write:
        text = options.write.read_text()
        before, after = text.split(BEGIN)[0], text.split(END)[1]
        options.write.write_text("\n".join([before + BEGIN, "", *lines, "", END + after]))
    wrong = [line for one in accounts.values() for line in one.failures + one.missed]
    print("\n".join(wrong))
    return 1 if wrong or (kills is not None and not kills.held) else 0


if __name__ == "__main__":
    sys.exit(main())
