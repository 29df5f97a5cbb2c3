"""Work in child processes: progress, results, reasons, cancelling, and nothing left behind."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable

import pytest

from tui.console import jobs as jobs_module
from tui.console.jobs import Job, Jobs

DEADLINE_S = 60.0
WAITS = 'import sys, time; print(\'{"done": 1, "total": 4}\'); sys.stdout.flush(); time.sleep(60)'


@pytest.fixture(autouse=True)
def bare_python(monkeypatch):
    """The arguments of a job are Python code."""
    monkeypatch.setattr(jobs_module, "PROGRAM", [sys.executable, "-S", "-c"])


class Desk:
    """Jobs whose changes can be waited for."""

    def __init__(self) -> None:
        self.log: list[tuple[str, str]] = []
        self._changed = asyncio.Event()
        self.jobs = Jobs(lambda *line: self.log.append(line), self._changed.set, lambda work, *args: work(*args))

    async def until(self, condition: Callable[[], object]) -> None:
        while not condition():
            await self._changed.wait()
            self._changed.clear()

    async def run(self, code: str, **more) -> Job:
        """A job from its start to its end."""
        job = self.jobs.start("count", [code], "scan", **more)
        assert job is not None
        await self.until(lambda: not job.running)
        return job

    async def waiting(self, title: str = "wait", subject: str = "scan", code: str = WAITS) -> Job:
        """A job that runs until it is cancelled."""
        job = self.jobs.start(title, [code], subject)
        assert job is not None
        await self.until(lambda: job.done == 1)
        return job


def play(script: Callable[[Desk], Awaitable[None]]) -> None:
    async def run() -> None:
        desk = Desk()
        try:
            await script(desk)
        finally:
            await desk.jobs.close()

    asyncio.run(asyncio.wait_for(run(), DEADLINE_S))


def test_progress_and_results_are_reported_and_the_end_is_good():
    async def script(desk):
        results: list[dict] = []
        ends: list[Job] = []
        code = 'print("{\\"done\\": 2, \\"total\\": 8}"); print("{\\"points\\": 7}")'
        job = await desk.run(code, on_result=results.append, on_end=ends.append)
        assert (job.ok, job.share, job.result) == (True, 0.25, {"points": 7})
        assert results == [{"points": 7}] and ends == [job]
        assert desk.log == [("count: started", "info"), ("count: done", "info")]

    play(script)


def test_a_failure_is_reported_in_the_words_of_the_child():
    async def script(desk):
        job = await desk.run("import sys; print('sweepscope: the disk is full', file=sys.stderr); sys.exit(1)")
        assert not job.ok and desk.log[-1] == ("count: the disk is full", "error")

    play(script)


def test_a_program_that_cannot_be_started_is_a_failure_with_its_reason(monkeypatch):
    monkeypatch.setattr(jobs_module, "PROGRAM", ["/nonexistent/program"])

    async def script(desk):
        job = await desk.run("")
        assert not job.ok and "No such file" in desk.log[-1][0]

    play(script)


def test_a_scan_that_lacks_frames_is_no_failure_of_the_work():
    async def script(desk):
        assert (await desk.run("import sys; sys.exit(4)")).ok

    play(script)


def test_a_quiet_job_is_not_logged_and_not_missed():
    async def script(desk):
        job = desk.jobs.start("look", [WAITS], "board", quiet=True)
        await desk.until(lambda: job.done == 1)
        assert desk.jobs.running == [job] and desk.jobs.work == []
        desk.jobs.cancel(job)
        await desk.until(lambda: not job.running)
        assert desk.log == []

    play(script)


def test_a_cancelled_job_can_clean_up_and_is_called_cancelled(tmp_path):
    mark = tmp_path / "cleaned"

    async def script(desk):
        code = f"import pathlib\ntry:\n exec({WAITS!r})\nfinally:\n pathlib.Path({str(mark)!r}).touch()"
        job = await desk.waiting(code=code)
        desk.jobs.cancel(job)
        await desk.until(lambda: not job.running)
        assert desk.log[-1] == ("wait: cancelled", "warning")

    play(script)
    assert mark.exists()


def test_a_job_that_is_cancelled_before_its_child_is_there_ends_too():
    async def script(desk):
        job = desk.jobs.start("wait", [WAITS], "scan")
        desk.jobs.cancel(job)
        await desk.until(lambda: not job.running)
        assert desk.log[-1] == ("wait: cancelled", "warning")

    play(script)


def test_a_child_that_ignores_the_request_is_killed(monkeypatch):
    monkeypatch.setattr(jobs_module, "CANCEL_S", 0.1)

    async def script(desk):
        job = await desk.waiting(code=f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); {WAITS}")
        desk.jobs.cancel(job)
        await desk.until(lambda: not job.running)
        assert job.exit_status == -9

    play(script)


def test_two_jobs_on_one_scan_are_refused_and_a_second_scan_is_not():
    async def script(desk):
        first = await desk.waiting("first", "scan a")
        assert desk.jobs.start("second", [WAITS], "scan a") is None
        assert desk.log[-1] == ("second: other work on it runs already; wait, or cancel that", "warning")
        third = await desk.waiting("third", "scan b")
        assert [desk.jobs.running_on(f"scan {name}") for name in "abc"] == [first, third, None]

    play(script)


def test_closing_ends_what_runs_and_nothing_can_be_started_after_it():
    async def script(desk):
        job = await desk.waiting()
        await desk.jobs.close()
        assert not job.running and desk.jobs.running == []
        assert desk.jobs.start("more", [WAITS], "other") is None

    play(script)


def test_noise_on_the_output_is_no_result_and_an_endless_line_is_skipped(monkeypatch):
    monkeypatch.setattr(jobs_module, "MAX_LINE_BYTES", 1000)

    async def script(desk):
        code = """print('{broken'); print('x' * 5000); print('[1]'); print('{"done": -1, "total": "x"}')"""
        job = await desk.run(code)
        assert (job.ok, job.result, job.done, job.total, job.words) == (True, None, 0, 0, "[1]")

    play(script)
