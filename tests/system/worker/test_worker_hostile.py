"""Whatever arrives on the worker's sockets: it is counted and ignored, and the next scan is folded as ever."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgpack
import numpy as np
import pytest

from acquire.contract.config.load import load_config
from acquire.contract.messaging.codec import encode
from process.results.write import ResultWriteError
from process.worker import live_scan
from process.worker.service import Worker
from tests.fakes.processes.sweep_source import SweepSource, edge_frames
from tests.waiting import wait_for

FRAMES = 12


@pytest.fixture
def source(run_dir: Path, tmp_path: Path) -> Iterator[SweepSource]:
    made = SweepSource(run_dir, tmp_path / "scan", edge_frames(FRAMES, 64, 48))
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def worker(source: SweepSource) -> Iterator[Worker]:
    made = Worker(load_config(environ={}), source.run_dir, source.context)

    def listens() -> bool:
        source.send_live_raw([b"probe"])
        made.turn()
        return made.malformed > 0

    wait_for(listens, "the worker hears the live lane")
    yield made
    made.close()


def mutations(source: SweepSource, count: int) -> Iterator[list[bytes]]:
    rng = np.random.default_rng(20)
    whole = [encode(source.image(3)), encode(source.start_message), msgpack.packb({"type": "end"})]
    for _ in range(count):
        header = bytearray(whole[int(rng.integers(len(whole)))])
        for at in rng.integers(0, len(header), int(rng.integers(1, 6))):
            header[at] = int(rng.integers(256))
        parts = [bytes(header[: int(rng.integers(1, len(header) + 1))])]
        yield parts + [rng.bytes(int(rng.integers(0, 100)))] * int(rng.integers(0, 3))


HOSTILE = [
    [b""],
    [b"\xdd\xff\xff\xff\xff"],
    [b"\x91" * 5000],
    [b"\xa4\xff\xff\xff\xff"],
    [msgpack.packb({"type": "image", "protocol": [9, 0]})],
    [msgpack.packb({"type": "status", "protocol": [1, 0], "state": "x" * 10_000})],
    [b"x", b"y", b"z", b"w"],
]


def fold_a_scan(worker: Worker, source: SweepSource) -> None:
    source.create()
    source.announce()
    for index in range(FRAMES):
        source.take(index)
    source.end()

    def finished() -> bool:
        worker.turn()
        return worker.publisher.end is not None and worker.publisher.end.scan_uid == source.scan_uid

    wait_for(finished, "a whole scan after all that")


def test_broken_messages_of_every_kind_are_counted_and_the_next_scan_is_whole(worker, source):
    before = worker.malformed
    for parts in [*HOSTILE, *mutations(source, 300)]:
        source.send_live_raw(parts)
        worker.turn()
    assert worker.malformed - before > 100
    fold_a_scan(worker, source)
    assert worker.scan is not None and worker.scan.cursor.folded.all()


def test_a_disk_that_is_full_for_a_while_delays_the_results_and_is_said(worker, source, monkeypatch, caplog):
    write, refusals = live_scan.write_results, [1, 1]

    def full(*args, **options):
        if refusals:
            refusals.pop()
            raise ResultWriteError("cannot write maps.h5: No space left on device")
        return write(*args, **options)

    monkeypatch.setattr(live_scan, "write_results", full)
    monkeypatch.setattr("process.worker.service.RETRY_NS", 1_000_000)
    fold_a_scan(worker, source)
    assert caplog.text.count("no maps: cannot write maps.h5: No space left on device; the scan is safe") == 2
    assert (source.folder / "maps.h5").is_file()


def test_a_worker_that_meets_a_bug_goes_on_and_folds_again(worker, source, monkeypatch):
    write, bugs = live_scan.write_results, [1]

    def buggy(*args, **options):
        if bugs:
            bugs.pop()
            raise ZeroDivisionError("a bug")
        return write(*args, **options)

    monkeypatch.setattr(live_scan, "write_results", buggy)
    monkeypatch.setattr("process.worker.service.RETRY_NS", 1_000_000)
    fold_a_scan(worker, source)
    assert worker.scan is not None and worker.scan.cursor.counts.refolded == FRAMES
