"""The jobs of one console: tells their ends in the log and to whoever started them, on the screen's own thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from acquire.contract.errors import SweepscopeError
from tui.console.link.messages import JobChanged
from tui.processes.child_jobs import Job, JobBoard

if TYPE_CHECKING:
    from tui.console.app import ConsoleApp

OnJob = Callable[[Job], None]


class JobDesk:
    """Starts jobs for screens; a screen that is not in view any more still hears how its job ended."""

    def __init__(self, shell: ConsoleApp) -> None:
        self._shell = shell
        self.board = JobBoard(lambda job: shell.post_message(JobChanged(job)))
        self._on_end: dict[int, OnJob] = {}
        self._ended: set[int] = set()

    @property
    def running(self) -> list[Job]:
        """What runs now, the oldest first."""
        return [job for job in self.board.jobs if job.running]

    @property
    def work(self) -> list[Job]:
        """What runs now and would be missed: all but what only helps a screen."""
        return [job for job in self.running if -job.number not in self._ended]

    def start(
        self,
        title: str,
        arguments: Sequence[str],
        subject: str,
        on_end: OnJob | None = None,
        *,
        on_result: Callable[[dict[str, Any]], Any] = lambda _: None,
        quiet: bool = False,
    ) -> Job | None:
        """Start a job, or say why not (None).

        ``on_end`` is called on the screen's thread, ``on_result`` on the job's; ``quiet``: its end is no news.
        """
        try:
            job = self.board.start(title, arguments, subject, on_result)
        except (SweepscopeError, OSError) as error:
            self._shell.say(str(error), "warning")
            return None
        if on_end is not None:
            self._on_end[job.number] = on_end
        if quiet:
            self._ended.add(-job.number)
        else:
            self._shell.say(f"{title}: started")
        return job

    def cancel(self, job: Job) -> None:
        """Ask a job to end."""
        self.board.cancel(job.number)

    def heard(self, job: Job) -> None:
        """A job is further, or has ended."""
        if not job.running and job.number not in self._ended:
            self._ended.add(job.number)
            if -job.number not in self._ended:
                self._shell.say(job.end_words(), "info" if job.ok else "warning" if job.cancelled else "error")
            on_end = self._on_end.pop(job.number, None)
            if on_end is not None:
                on_end(job)
        self._shell.refresh_view()

    def close(self) -> None:
        """End them all."""
        self.board.close()
