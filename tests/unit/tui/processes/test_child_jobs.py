"""Work in child processes: progress, results, reasons, cancelling, and nothing left behind."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator

import pytest

from acquire.contract.errors import SweepscopeError
from tests.waiting import wait_for
from tui.processes import child_jobs
from tui.processes.child_jobs import Job, JobBoard

PROGRAM = [sys.executable, "-S", "-c"]
WAITS = 'import sys, time; print(\'{"done": 1, "total": 4}\'); sys.stdout.flush(); time.sleep(60)'


class Watch:
    """Hears every change and waits for one."""

    def __init__(self) -> None:
        self.seen: list[Job] = []
        self._changed = threading.Condition()

    def __call__(self, job: Job) -> None:
        with self._changed:
            self.seen.append(job)
            self._changed.notify_all()

    def wait_for(self, wanted) -> Job:
        def found() -> Job | None:
            with self._changed:
                return next((job for job in reversed(self.seen) if wanted(job)), None)

        return wait_for(found, "such a job", why=lambda: self.seen)


@pytest.fixture
def watch() -> Watch:
    return Watch()


@pytest.fixture
def board(watch: Watch) -> Iterator[JobBoard]:
    made = JobBoard(watch, PROGRAM)
    yield made
    made.close()


def ended(job: Job) -> bool:
    return not job.running


def test_progress_and_result_are_told_and_the_end_is_good(board, watch):
    code = 'print("{\\"done\\": 2, \\"total\\": 8}"); print("{\\"points\\": 7}")'
    results: list[dict] = []
    board.start("count", [code], "scan", results.append)
    job = watch.wait_for(ended)
    assert (job.ok, job.share, job.result, results) == (True, 0.25, {"points": 7}, [{"points": 7}])
    assert job.end_words() == "count: done"


def test_a_failure_is_told_with_the_childs_own_words(board, watch):
    board.start("count", ["import sys; print('sweepscope: the disk is full', file=sys.stderr); sys.exit(1)"], "scan")
    job = watch.wait_for(ended)
    assert not job.ok and job.end_words() == "count: the disk is full"


def test_a_scan_that_lacks_frames_is_no_failure_of_the_work(board, watch):
    board.start("verify", ["import sys; sys.exit(4)"], "scan")
    assert watch.wait_for(ended).ok


def test_a_cancelled_job_can_clean_up_and_is_called_cancelled(board, watch, tmp_path):
    mark = tmp_path / "cleaned"
    code = f"import pathlib\ntry:\n exec({WAITS!r})\nfinally:\n pathlib.Path({str(mark)!r}).touch()"
    job = board.start("wait", [code], "scan")
    watch.wait_for(lambda job: job.done == 1)
    board.cancel(job.number)
    assert watch.wait_for(ended).end_words() == "wait: cancelled"
    assert mark.exists()


def test_a_child_that_ignores_the_request_is_killed(board, watch, monkeypatch):
    monkeypatch.setattr(child_jobs, "CANCEL_S", 0.1)
    job = board.start("wait", [f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); {WAITS}"], "scan")
    watch.wait_for(lambda job: job.done == 1)
    board.cancel(job.number)
    assert watch.wait_for(ended).exit_status == -9


def test_two_jobs_on_one_scan_are_refused_and_a_second_scan_is_not(board, watch):
    board.start("first", [WAITS], "scan a")
    with pytest.raises(SweepscopeError, match="runs already"):
        board.start("second", [WAITS], "scan a")
    board.start("third", [WAITS], "scan b")
    assert board.running_on("scan a") and board.running_on("scan b") and not board.running_on("scan c")


def test_closing_ends_what_runs_and_nothing_can_be_started_after_it(board, watch):
    board.start("wait", [WAITS], "scan")
    watch.wait_for(lambda job: job.done == 1)
    board.close()
    assert not board.jobs[0].running
    with pytest.raises(SweepscopeError):
        board.start("more", [WAITS], "other")


def test_noise_on_the_output_is_no_result(board, watch):
    board.start("noise", ["print('{broken'); print('[1]'); print('{\"done\": -1, \"total\": \"x\"}')"], "scan")
    job = watch.wait_for(ended)
    assert (job.result, job.done, job.total) == (None, 0, 0)
