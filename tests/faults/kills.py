"""SIGKILLs of random processes at random times, sweep after sweep: what was committed stays, nobody has to do a thing.

Killed services are started again as their supervisor would; the one step that is the operator's is to resume, and over
the emulated controller, which restarts with the daemon that it belongs to, to home before. There the pins are one more
witness of where each frame was taken.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from acquire.contract.errors import CommandRefusedError, NoServiceError, ScanFileError
from acquire.contract.scan_data.reader import ScanReader
from tests.waiting import Stopwatch

from .firmware_rows import assert_pins, home, set_up
from .harness import Rig, a_rig, assert_frames, assert_promise

VICTIMS = ("daemon", "writer", "worker")
_SPREAD_S, _SPREAD_EMULATED_S = 0.6, 3.0
"""A kill comes within so much time: most of a sweep."""


@dataclass
class Kills:
    """The account of a campaign."""

    kills: int = 0
    sweeps: int = 0
    complete: int = 0
    resumed: int = 0
    lost_or_changed: int = 0
    false_success: int = 0
    manual_steps: int = 0
    ended: Counter[str] = field(default_factory=Counter)
    """How the sweeps ended, by their outcome."""
    detail: str = ""
    over: str = ""
    """What the sweeps ran over, in words; empty: the simulated stage."""

    @property
    def held(self) -> bool:
        """Nothing was lost, nothing was called success that was not, nobody had to help."""
        return not (self.lost_or_changed or self.false_success or self.manual_steps)

    def words(self) -> str:
        """One line for the table."""
        return (
            f"{self.kills} SIGKILLs of a random process (daemon, writer, worker) at random times in {self.sweeps} "
            f"sweeps{self.over}, {self.complete} of them complete in the end, {self.resumed} resumes: "
            f"{self.lost_or_changed} committed frames lost or changed, {self.false_success} scans called success "
            f"that were not, {self.manual_steps} manual steps ({self._ends()}). {self.detail}".strip()
        )

    def _ends(self) -> str:
        never = self.sweeps - self.ended.total()
        return ", ".join(f"{outcome} {count}" for outcome, count in [*self.ended.items(), ("never begun", never)])


def kill_many(count: int, seed: int, *, emulated: bool = False) -> Kills:
    """Run sweeps and kill until ``count`` processes have died; ``emulated``: over the emulated firmware."""
    kills, source = Kills(over=" over the emulated controller" if emulated else ""), random.Random(seed)
    while kills.kills < count:
        with a_rig(source.randrange(2**31), at=0.5) as rig:
            if emulated:
                set_up(rig)
            rig.start(*VICTIMS)
            while kills.kills < count and kills.held:
                _one_sweep(rig, kills, source)
            if not kills.held:
                kills.detail += f" log: {rig.log.read_text(errors='replace')[-3000:]}"
                break
    return kills


def _one_sweep(rig: Rig, kills: Kills, source: random.Random) -> None:
    kills.sweeps += 1
    scan: dict[str, Any] = {}
    for _ in range(source.randrange(1, 5)):
        if not scan:
            scan = _begin(rig, {})
        _kill_one(rig, kills, source)
        _check(scan, rig, kills)
    watch = Stopwatch()
    while watch.elapsed_s < 90:
        if _sealed(scan):
            break
        kills.resumed += bool(_begin(rig, scan))
        _wait_for_rest(rig)
    _settle(scan, rig, kills)


def _kill_one(rig: Rig, kills: Kills, source: random.Random) -> None:
    rig.pause(source.random() * (_SPREAD_EMULATED_S if kills.over else _SPREAD_S))
    victim = source.choice(VICTIMS)
    rig.kill(victim)
    kills.kills += 1
    rig.pause(source.random() * 0.3)
    rig.start(victim)


def _begin(rig: Rig, scan: dict[str, Any]) -> dict[str, Any]:
    """Start a scan, or resume one that was interrupted; {} if the rig did not want to yet."""
    try:
        with rig.client() as client:
            rig.until_status(client, lambda s: s.state == "idle" and s.writer_alive or s.state != "idle", "the rig")
            status = client.status()
            if status.state == "idle" and not status.position_trusted:
                home(rig, client)
            if not scan:
                return rig.begin(client)
            if status.state != "idle":
                return {}
            # a controller that restarted counts its triggers anew
            scan["before"] = _present(scan)
            client.request("resume_scan", path=scan["path"])
            return scan
    except (CommandRefusedError, NoServiceError):
        return {}


def _present(scan: dict[str, Any]) -> frozenset[int]:
    try:
        with ScanReader(Path(scan["path"])) as reader:
            return frozenset(map(int, np.flatnonzero(reader.present())))
    except ScanFileError:
        return frozenset()  # its file was never made


def _wait_for_rest(rig: Rig) -> None:
    try:
        with rig.client() as client:
            rig.until_status(client, lambda s: s.state == "idle", "the sweep is over")
    except NoServiceError:
        return


def _sealed(scan: dict[str, Any]) -> bool:
    return not scan or (Path(scan["path"]) / "scan.h5").exists() or not Path(scan["path"]).exists()


def _check(scan: dict[str, Any], rig: Rig, kills: Kills) -> None:
    """What is called committed right now is exact, and at least what was acked."""
    try:
        there = assert_frames(Path(scan["path"]), rig.light)
        with ScanReader(Path(scan["path"])) as reader:
            seen = rig.seen.get(reader.layout.scan_uid)
        if seen is not None and there < seen.committed:
            kills.lost_or_changed += seen.committed - there
    except AssertionError as error:
        kills.lost_or_changed += 1
        kills.detail += f" {error}"
    except Exception:
        # no file yet, or no scan: nothing was acked
        return


def _settle(scan: dict[str, Any], rig: Rig, kills: Kills) -> None:
    path = Path(scan.get("path", "/nonexistent"))
    if not path.exists():
        return
    if not (path / "scan.h5").exists():
        kills.manual_steps += 1
        kills.detail += f" {path} was not brought to an end"
        return
    try:
        with ScanReader(path) as reader:
            outcome = reader.outcome
        assert_promise(path, rig, outcome)
        if kills.over and outcome == "complete":
            assert_pins(path, scan.get("before", frozenset()))
        assert outcome == "complete" or not _present(scan), f"{path} is {outcome} and could have gone on"
        kills.ended[outcome] += 1
        kills.complete += outcome == "complete"
    except AssertionError as error:
        kills.lost_or_changed += 1
        kills.false_success += "SAVED" in str(error)
        kills.detail += f" {error}"
