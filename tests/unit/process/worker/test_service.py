"""What the worker does first: frames that wait, in the socket or in the file, come before anything that can be late."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zmq

from acquire.contract.config.load import load_config
from process.worker import service as worker_module
from process.worker.service import FILE_WAIT_MS, Worker


class BehindScan:
    """Stands for a scan whose fold is behind: its file gives so many frames, one number for each time it is asked."""

    failure, results, lag_frames = "", None, 1000
    cursor = SimpleNamespace(done=False)

    def __init__(self, *given: int) -> None:
        self.given = list(given)
        self.done: list[str] = []

    @property
    def behind(self) -> bool:
        return bool(self.given)

    wants_file = behind
    may_work_ahead = True

    def fill(self) -> int:
        self.done.append("fill")
        return self.given.pop(0)

    def work_ahead(self) -> None:
        self.done.append("ahead")

    def ready_to_finish(self) -> bool:
        return False


class QuietOutbox:
    wants_preview = False

    def preview_due(self, now_ns: int, lag_frames: int) -> bool:
        return False

    def progress_due(self, now_ns: int, *, news: bool) -> bool:
        return False


@pytest.fixture
def patience_ms(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How long the worker was ready to wait, turn by turn."""
    asked: list[int] = []

    class Poller:
        def register(self, *_: Any) -> None: ...

        def poll(self, timeout_ms: int) -> list[Any]:
            asked.append(timeout_ms)
            return []

    monkeypatch.setattr(worker_module.zmq, "Poller", Poller)
    return asked


@pytest.fixture
def worker(run_dir: Path, patience_ms: list[int]) -> Iterator[Worker]:
    context: zmq.Context[Any] = zmq.Context()
    made = Worker(load_config(environ={}), run_dir, context)
    made.outbox = QuietOutbox()  # type: ignore[assignment]
    yield made
    made.session = None
    made.close()
    context.term()


def test_no_estimate_is_made_ahead_while_frames_wait_to_be_folded(worker):
    worker.session = scan = BehindScan(20, 20, 0, 5)
    for _ in range(4):
        worker.turn()
    assert scan.done == ["fill", "fill", "fill", "fill", "ahead"]


def test_nothing_is_waited_for_while_the_file_has_frames(worker, patience_ms):
    worker.session = BehindScan(20, 20, 0, 5)
    for _ in range(4):
        worker.turn()
    assert patience_ms == [FILE_WAIT_MS, 0, 0, FILE_WAIT_MS]
