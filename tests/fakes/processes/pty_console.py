"""A real console on a pseudo-terminal whose reader the test plays: it may read slowly, stop, answer, or hang up."""

from __future__ import annotations

import fcntl
import os
import re
import select
import struct
import subprocess
import sys
import termios
import threading
from pathlib import Path
from typing import Self

from tests.waiting import DEADLINE_S, exit_status, wait_for


class PtyConsole:
    """Reads what the console paints at a given rate and answers its questions as a terminal would."""

    def __init__(
        self, run_dir: Path, *, rate_bytes_per_s: float = 50_000_000, size: tuple[int, int] = (80, 24)
    ) -> None:
        self.run_dir, self.rate_bytes_per_s, self._size = run_dir, rate_bytes_per_s, size
        self.painted = b""
        self.read_bytes = 0
        self.stalled = threading.Event()
        """Set: nothing is read until it is cleared."""
        self._changed = threading.Condition()
        self._ending = threading.Event()

    def __enter__(self) -> Self:
        self._master, slave = os.openpty()
        columns, rows = self._size
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        environ = {**os.environ, "SWEEPSCOPE_RUN": str(self.run_dir), "TERM": "xterm-256color"}
        for name in ("TMUX", "COLORTERM", "NO_COLOR"):
            environ.pop(name, None)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tui.cli", "console"],
            stdin=slave, stdout=slave, stderr=slave, env=environ, start_new_session=True,
        )  # fmt: skip
        os.close(slave)
        self._thread = threading.Thread(target=self._read, name="pty-reader", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self.stalled.clear()
        self._thread.join(5)
        self.process.kill()
        exit_status(self.process)
        if self._master >= 0:
            os.close(self._master)

    def _read(self) -> None:
        while not self._ending.is_set():
            if self.stalled.is_set() or not select.select([self._master], [], [], 0.05)[0]:
                self._ending.wait(0.01)
                continue
            try:
                data = os.read(self._master, 1024)
            except OSError:
                return  # the console has gone
            self._take(data)
            self._ending.wait(len(data) / self.rate_bytes_per_s)

    def _take(self, data: bytes) -> None:
        with self._changed:
            self.read_bytes += len(data)
            questions = (self.painted[-3:] + data).count(b"\x1b[6n") - self.painted[-3:].count(b"\x1b[6n")
            self.painted = (self.painted + data)[-400_000:]
            self._changed.notify_all()
        for _ in range(questions):
            self.type(b"\x1b[1;1R")

    def type(self, keys: bytes) -> None:
        os.write(self._master, keys)

    def forget(self) -> None:
        with self._changed:
            self.painted = b""

    def wait_for(self, words: str, deadline_s: float = DEADLINE_S) -> None:
        """Until ``words`` was painted in one piece since :meth:`forget`."""

        def came() -> bool:
            with self._changed:
                return self._changed.wait_for(lambda: words in self.text, 0.2)

        wait_for(came, f"{words!r} on the screen", deadline_s, why=lambda: self.text[-3000:])

    @property
    def text(self) -> str:
        """What was painted, without its styles."""
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.painted.decode(errors="replace"))

    def stick(self, keys: bytes) -> None:
        """Stop reading and type ``keys`` until the echoes fill the terminal's own buffer: further output blocks."""
        self.stalled.set()
        counts = [-1, self._unread()]

        def full() -> bool:
            self.type(keys)
            self._ending.wait(0.3)
            counts.append(self._unread())
            return counts[-1] == counts[-2] >= 1000

        wait_for(full, "output that fills the terminal", why=lambda: counts)

    def _unread(self) -> int:
        count = fcntl.ioctl(self._master, termios.FIONREAD, b"\0\0\0\0")
        return int(struct.unpack("i", count)[0])

    def hang_up(self) -> None:
        """The line drops: the terminal is gone."""
        self._ending.set()
        self._thread.join(5)
        os.close(self._master)
        self._master = -1
