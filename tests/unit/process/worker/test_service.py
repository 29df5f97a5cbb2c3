"""What the worker does first: frames that wait, in the socket or in the file, come before anything that can be late."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from acquire.contract.config.load import load_config
from process.worker import live_scan
from process.worker.live_scan import LiveScan
from process.worker.service import FILE_WAIT_MS, Worker
from tests.fakes.processes.sweep_source import SweepSource, edge_frames
from tests.waiting import wait_for

FRAMES, WIDTH, HEIGHT = 120, 64, 48
SHOWN = 90
"""Frames that come live before the live lane loses the rest; enough to estimate from."""


@pytest.fixture
def source(run_dir: Path, tmp_path: Path) -> Iterator[SweepSource]:
    made = SweepSource(run_dir, tmp_path / "scan", edge_frames(FRAMES, WIDTH, HEIGHT))
    toml = "[reconstruct]\ncontrast = 60\nmedian = 3\nmethod = 'auto'\n"
    made.start_message = replace(made.start_message, config_toml=toml)
    yield made
    made.close()


@pytest.fixture
def worker(source: SweepSource, monkeypatch: pytest.MonkeyPatch) -> Iterator[Worker]:
    """A worker that reads one frame of a file at a time, with a scan that was announced."""
    monkeypatch.setattr(live_scan, "FILE_BYTES_AT_ONCE", 1)
    made = Worker(load_config(environ={}), source.run_dir, source.context)
    source.create()

    def begun() -> bool:
        source.announce()
        made.turn()
        return made.scan is not None

    wait_for(begun, "the worker takes the scan")
    yield made
    made.close()


def turn_until(worker: Worker, condition) -> None:
    wait_for(lambda: (worker.turn(), condition())[1], "the worker gets on")


def lose(source: SweepSource, frames: range) -> None:
    """Frames that the live lane loses, all but the last of them."""
    for index in frames:
        source.take(index, live=index == frames[-1])


def test_no_estimate_is_made_early_while_frames_wait_to_be_folded(worker, source, monkeypatch):
    fit_early, was_behind = LiveScan.fit_early, []

    def recorded(scan: LiveScan) -> None:
        was_behind.append(scan.lag_frames > 0)
        fit_early(scan)

    monkeypatch.setattr(LiveScan, "fit_early", recorded)
    for index in range(SHOWN):
        source.take(index)
    turn_until(worker, lambda: worker.scan.may_fit_early)
    was_behind.clear()
    lose(source, range(SHOWN, FRAMES - 1))
    turn_until(worker, lambda: worker.scan.cursor.next_index == FRAMES - 1 and was_behind)
    assert worker.scan.cursor.counts.from_file > 20 and not any(was_behind)


def test_nothing_is_waited_for_while_the_file_has_frames(worker, source):
    source.send_live(40)
    turn_until(worker, lambda: worker.scan.lag_frames)
    worker.turn()
    assert worker.patience_ms() == FILE_WAIT_MS, "the frames before it are not in the file yet"
    for index in range(40):
        source.commit(index)
    patience = []
    while worker.scan.lag_frames:
        worker.turn()
        patience.append(worker.patience_ms())
    assert len(patience) > 30 and set(patience[:-1]) == {0}
