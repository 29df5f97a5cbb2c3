"""The terminal's driver: STOP is sent from the thread that reads the keys, and all output is measured.

Textual paints through a bounded queue that blocks its loop while the terminal takes no output; keys are read by a
thread of their own. So STOP is sent from there, before anything is painted, and painting pauses while it would queue.
"""

from __future__ import annotations

import math
import threading
import time
from typing import IO, Any, Protocol, cast

from textual import events
from textual.app import App
from textual.drivers.linux_driver import LinuxDriver
from textual.message import Message

from tui.console.keys import TYPING_STOP_KEY
from tui.console.pictures.picture_rate import PictureRate

ASK = "\x1b[6n"
"""Cursor position report: its answer means that the terminal has processed everything before it."""
LAST_ANSWER_S = 0.5
"""At the end, an open answer is awaited for so long: otherwise the shell would get it as typed text."""
TYPING_S = 1.0
"""A space so soon after a letter may belong to a text whose dialog is not open yet."""
STUCK_S = 0.5
"""The event loop has so long to see such a space; then the terminal is stuck, and it counts as STOP."""


class OutputMeter:
    """Bytes on their way to the terminal, and the picture rate that follows from them; safe from any thread."""

    def __init__(self, rate: PictureRate | None = None) -> None:
        self.rate = rate or PictureRate()
        self.handed_bytes = 0
        self.written_bytes = 0
        self.gone = False
        """True once the terminal is gone: further output is dropped."""
        self._lock = threading.Lock()
        self._blocked_since_s: float | None = None
        self._asked_at_bytes = 0
        self.answered_event = threading.Event()

    def handed(self, nbytes: int) -> None:
        """Textual handed over ``nbytes``."""
        with self._lock:
            self.handed_bytes += nbytes

    def begin_write(self) -> None:
        """The writing thread is about to write."""
        self._blocked_since_s = time.monotonic()

    def end_write(self, nbytes: int) -> None:
        """It has written."""
        self._blocked_since_s = None
        with self._lock:
            self.written_bytes += nbytes

    @property
    def backlog_bytes(self) -> int:
        """Handed over and not yet written."""
        return self.handed_bytes - self.written_bytes

    def stalled(self) -> bool:
        """True while the terminal takes no output."""
        since_s = self._blocked_since_s
        now_s = time.monotonic()
        with self._lock:
            return self.rate.stalled(now_s, now_s - since_s if since_s is not None else 0.0)

    def may_send_picture(self) -> bool:
        """True if a picture may be painted now."""
        with self._lock:
            return self.rate.may_send(time.monotonic(), self.backlog_bytes)

    def wants_bare(self) -> bool:
        """True if the terminal should be asked now without a picture before the question."""
        with self._lock:
            return not self.backlog_bytes and self.rate.wants_bare(time.monotonic())

    def asked(self, *, picture: bool) -> None:
        """A question was handed over, behind a picture or alone."""
        with self._lock:
            self.answered_event.clear()
            nbytes = self.handed_bytes - self._asked_at_bytes if picture else 0
            self.rate.asked(time.monotonic(), nbytes, picture=picture)
            self._asked_at_bytes = self.handed_bytes

    def answered(self) -> None:
        """The terminal answered."""
        with self._lock:
            self.rate.answered(time.monotonic())
        self.answered_event.set()

    def words(self) -> str:
        """``link 180 kB/s, picture 3 Hz``."""
        with self._lock:
            return self.rate.words(time.monotonic())


class _MeasuredFile:
    """The terminal as a file that reports each finished write, and that survives the terminal."""

    def __init__(self, file: IO[str], meter: OutputMeter) -> None:
        self._file, self._meter = file, meter

    def write(self, text: str) -> int:
        self._do(self._file.write, text, nbytes=_size(text))
        return len(text)

    def flush(self) -> None:
        self._do(self._file.flush)

    def _do(self, work: Any, *args: Any, nbytes: int = 0) -> None:
        self._meter.begin_write()
        try:
            if not self._meter.gone:
                work(*args)
        except OSError:
            self._meter.gone = True  # the terminal hung up: the loop must end, not wait for it
        finally:
            self._meter.end_write(nbytes)

    def fileno(self) -> int:
        return self._file.fileno()

    def isatty(self) -> bool:
        return self._file.isatty()


def _size(text: str) -> int:
    return len(text.encode("utf-8", "surrogateescape"))  # names of files may hold bytes that are not UTF-8


class _Stoppable(Protocol):
    meter: OutputMeter

    typed_ahead: set[events.Key]

    def means_stop(self, key: str) -> bool: ...

    def stop_early(self) -> None: ...


class ConsoleDriver(LinuxDriver):
    """Textual's driver with STOP before everything else and a meter on the output."""

    def __init__(self, app: App[Any], **options: Any) -> None:
        super().__init__(app, **options)
        self._console = cast(_Stoppable, app)
        self._meter = self._console.meter
        self._file: Any = _MeasuredFile(self._file, self._meter)
        self._letter_s = -math.inf
        """When the last letter was typed, by the monotonic clock."""

    def write(self, data: str) -> None:
        """Hand output to the writing thread."""
        self._meter.handed(_size(data))
        super().write(data)

    def ask(self, *, picture: bool) -> None:
        """Ask the terminal to answer once it has processed everything so far."""
        self._meter.asked(picture=picture)
        if not self._meter.rate.deaf:
            self.write(ASK)

    def process_message(self, message: Message) -> None:
        """Runs in the thread that reads the keys."""
        if isinstance(message, events.Key):
            if self._console.means_stop(message.key):
                self._stop(message)
            elif message.character is not None and message.character.isalnum():
                self._letter_s = time.monotonic()
        elif isinstance(message, events.CursorPosition):
            self._meter.answered()
            return
        super().process_message(message)

    def _stop(self, key: events.Key) -> None:
        """Send STOP at once, but leave to the loop what may be a space in a text that is typed ahead of its dialog."""
        if key.key == TYPING_STOP_KEY or time.monotonic() - self._letter_s > TYPING_S:
            self._console.stop_early()
            return
        self._console.typed_ahead.add(key)
        timer = threading.Timer(STUCK_S, self._stop_if_unseen, (key,))
        timer.daemon = True
        timer.start()

    def _stop_if_unseen(self, key: events.Key) -> None:
        if key in self._console.typed_ahead:
            self._console.typed_ahead.discard(key)
            self._console.stop_early()

    def stop_application_mode(self) -> None:
        """Restore the terminal, after its last answer."""
        if self._meter.rate.asking and not self._meter.gone:
            self._meter.answered_event.wait(LAST_ANSWER_S)
        super().stop_application_mode()
