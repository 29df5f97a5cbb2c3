"""Terminals for measuring: tmux, and a pseudo-terminal that is slow or stops reading."""

from __future__ import annotations

import fcntl
import os
import re
import select
import shutil
import signal
import struct
import subprocess
import termios
import threading
import time
from pathlib import Path
from typing import Self

from acquire.contract.errors import SweepscopeError
from tui.processes.supervisor import own_command

CONSOLE = own_command("console")
LOOK_S = 0.002
ANSWER_S = 30.0


def _environment(run_dir: Path) -> dict[str, str]:
    gone = ("TMUX", "NO_COLOR", "COLORTERM")
    kept = {name: value for name, value in os.environ.items() if name not in gone}
    return {**kept, "SWEEPSCOPE_RUN": str(run_dir), "TERM": "xterm-256color", "LANG": "C.UTF-8"}


class Tmux:
    """A separate tmux server with the console in its only window. A context manager."""

    def __init__(self, run_dir: Path, size: tuple[int, int]) -> None:
        """Raises SweepscopeError where there is no tmux."""
        found = shutil.which("tmux")
        if found is None:
            raise SweepscopeError("tmux is not installed: the console is measured in it; apt install tmux")
        self._command = [found, "-S", str(run_dir / "bench-tmux"), "-f", "/dev/null"]
        self._environment, self._size = _environment(run_dir), size

    def _do(self, *words: str) -> str:
        done = subprocess.run(
            [*self._command, *words],
            env=self._environment,
            capture_output=True,
            text=True,
            timeout=ANSWER_S,
            check=True,
        )
        return done.stdout

    def __enter__(self) -> Self:
        columns, rows = (str(side) for side in self._size)
        self._do("new-session", "-d", "-x", columns, "-y", rows, "exec " + " ".join(CONSOLE))
        self.pid = int(self._do("list-panes", "-F", "#{pane_pid}"))
        return self

    def __exit__(self, *_: object) -> None:
        subprocess.run([*self._command, "kill-server"], capture_output=True, timeout=ANSWER_S, check=False)

    def press(self, *keys: str) -> None:
        """Type keys by tmux's names."""
        self._do("send-keys", *keys)

    def wait_for(self, words: str, deadline_s: float = ANSWER_S) -> float:
        """Seconds until ``words`` are on the screen (polled every few ms).

        Raises:
            SweepscopeError: they did not appear.
        """
        begin_s = time.monotonic()
        while words not in self._do("capture-pane", "-p"):
            if time.monotonic() - begin_s > deadline_s:
                raise SweepscopeError(
                    f"the console never showed {words!r}; it shows:\n{self._do('capture-pane', '-p')}"
                )
            time.sleep(LOOK_S)
        return time.monotonic() - begin_s

    def effect_s(self, key: str, words: str) -> float:
        """Seconds from handing a key to tmux until its effect is on the screen."""
        begin_s = time.monotonic()
        self.press(key)
        self.wait_for(words)
        return time.monotonic() - begin_s

    def cpu_s(self) -> float:
        """Processor time of the console so far."""
        fields = Path(f"/proc/{self.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class BareLine:
    """The console on a pseudo-terminal that is read at a given rate, answers its queries, and can stop reading."""

    def __init__(self, run_dir: Path, size: tuple[int, int], rate_bytes_per_s: float) -> None:
        self._run_dir, self._size, self._rate = run_dir, size, rate_bytes_per_s
        self.stuck = False
        self.read_bytes = 0
        self._painted = ""
        self._ending = threading.Event()

    def __enter__(self) -> Self:
        self._master, slave = os.openpty()
        columns, rows = self._size
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        self._process = subprocess.Popen(
            CONSOLE, stdin=slave, stdout=slave, stderr=slave, env=_environment(self._run_dir), start_new_session=True
        )
        os.close(slave)
        self._thread = threading.Thread(target=self._read, name="line", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join(ANSWER_S)
        self._process.send_signal(signal.SIGKILL)
        self._process.wait(ANSWER_S)
        os.close(self._master)

    def _read(self) -> None:
        debt_s = time.monotonic()
        while not self._ending.is_set():
            if self.stuck or not select.select([self._master], [], [], 0.02)[0]:
                self._ending.wait(0.005)
                debt_s = max(debt_s, time.monotonic())
                continue
            data = os.read(self._master, 512)
            self.read_bytes += len(data)
            self._painted = (self._painted + data.decode(errors="replace"))[-200_000:]
            debt_s = max(debt_s, time.monotonic() - 0.05) + len(data) / self._rate
            self._ending.wait(max(0.0, debt_s - time.monotonic()))
            for _ in range(data.count(b"\x1b[6n")):
                self.type("\x1b[1;1R")

    def type(self, keys: str) -> None:
        """Send keys."""
        os.write(self._master, keys.encode())

    def effect_s(self, keys: str, words: str) -> float:
        """Seconds from a key to ``words`` in the output.

        Raises:
            SweepscopeError: they did not appear.
        """
        self._painted = ""
        begin_s = time.monotonic()
        self.type(keys)
        while words not in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self._painted):
            if time.monotonic() - begin_s > ANSWER_S:
                raise SweepscopeError(f"the console never painted {words!r}")
            time.sleep(LOOK_S)
        return time.monotonic() - begin_s

    def stick(self, keys: str) -> None:
        """Stop reading, and type until the echoes fill the buffer: further output of the console blocks."""
        self.stuck = True
        before = -1
        end_s = time.monotonic() + ANSWER_S
        while (waiting := self._unread()) != before or waiting < 1000:
            if time.monotonic() > end_s:
                raise SweepscopeError(f"the console's output never filled the line: {waiting} bytes")
            before = waiting
            self.type(keys)
            time.sleep(0.3)

    def _unread(self) -> int:
        count: int = struct.unpack("i", fcntl.ioctl(self._master, termios.FIONREAD, b"\0\0\0\0"))[0]
        return count
