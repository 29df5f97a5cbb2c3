"""One thread for slow disk calls (sync, seal); a file descriptor tells the event loop when a job is done."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any


class DiskThread:
    """Runs one job at a time; what the job returns or raises is handed to ``then`` on the caller's own thread."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="disk")
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._future: Future[Any] | None = None
        self._then: Callable[[Future[Any]], None] | None = None

    def fileno(self) -> int:
        """Readable when a job is done: to be polled."""
        return self._wake_fd

    @property
    def busy(self) -> bool:
        """A job runs, or its result has not been collected."""
        return self._future is not None

    def submit(self, job: Callable[[], Any], then: Callable[[Future[Any]], None]) -> None:
        """Begin a job; there must be none (``busy``)."""
        assert self._future is None
        self._then = then
        self._future = self._pool.submit(job)
        self._future.add_done_callback(lambda _: os.eventfd_write(self._wake_fd, 1))

    def collect(self) -> None:
        """Hand the result of a finished job to its ``then``; nothing happens while it still runs."""
        # read even where no job is left, or the poller would report it for ever
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake_fd)
        if self._future is not None and self._future.done():
            self._finish()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the job that runs and hand its result over; False if it did not end in time."""
        if self._future is None:
            return True
        try:
            self._future.exception(timeout_s)
        except TimeoutError:
            return False
        self._finish()
        return True

    def close(self) -> None:
        """End the thread; waits for a running job, because a system call on the disk cannot be interrupted."""
        self._pool.shutdown(wait=True)
        os.close(self._wake_fd)

    def _finish(self) -> None:
        future, then = self._future, self._then
        assert future is not None and then is not None
        self._future = self._then = None
        then(future)
