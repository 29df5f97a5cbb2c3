"""Session with the firmware over the serial port: one thread that sends, sends again, and reconnects.

Each command is carried out exactly once (:mod:`.send_window`). When the port is lost, the thread opens it again and
shakes hands until the controller answers; commands under way fail with ``LinkLostError``.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

import serial

from acquire.contract.errors import SweepscopeError
from acquire.stages.uno.framing import Block, BlockReader, encode_block

from .handshake import new_nonce, shake_hands
from .identify import LOOK_S
from .send_window import SendWindow, SerialCommand, Timing
from .serial_io import LinkLostError, read_now, wait_readable, write_now
from .wire_format import AckBody, Cmd, EventBody, HelloReplyBody, Msg, ReportBody, Result, unpack_report

logger = logging.getLogger(__name__)

_IDLE_S = 0.02
"""Longest wait of the thread; it asks the handler for its poll at least this often."""
_REOPEN_S = 0.2


class LinkHandler(Protocol):
    """Receives what comes over the link; called from the link's thread."""

    def on_report(self, report: ReportBody, events: tuple[EventBody, ...]) -> None:
        """The firmware's state and new trigger events."""
        ...

    def on_lost(self, detail: str) -> None:
        """The connection is lost; the link tries to reconnect."""
        ...

    def on_back(self, hello: HelloReplyBody, *, same_session: bool) -> None:
        """Connected again; ``same_session`` is False if the controller has restarted meanwhile."""
        ...

    def poll(self) -> bytes | None:
        """Body of the next status question, or None to stay silent (the lease then runs out)."""
        ...


@dataclass(frozen=True)
class LinkTiming:
    """Waits of the link in seconds."""

    hello_s: float = 4.0
    """How long a handshake may take; an Uno's boot loader takes two seconds after a reset."""
    silence_s: float = 1.5
    """The connection counts as lost after this time without an answer."""
    sending: Timing = Timing()


class Link:
    """One controller on one port. ``open_port`` is called again whenever the port was lost."""

    def __init__(self, open_port: Callable[[], serial.Serial], handler: LinkHandler, timing: LinkTiming) -> None:
        self._open_port = open_port
        self._handler = handler
        self._timing = timing
        self._window = SendWindow(timing.sending)
        self._reader = BlockReader()
        self._lock = threading.Lock()
        self._port: serial.Serial | None = None
        self._thread: threading.Thread | None = None
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._closing = False
        self._realtime = b""
        self._nonce = 0
        self._boot_id = -1
        self._heard_s = 0.0
        self._unanswered_since_s: float | None = None
        self._first_hello: Future[HelloReplyBody] = Future()
        self.lost_count = 0

    # ---- for the owner ----

    def open(self) -> HelloReplyBody:
        """Open the port and shake hands.

        Raises:
            PortError: the port cannot be opened.
            LinkLostError: nothing answers.
            FirmwareMismatchError: another firmware answers.
        """
        self._port = self._open_port()
        within_s = self._timing.hello_s + LOOK_S + 2.0
        self._thread = threading.Thread(target=self._run, name="stage-link", daemon=True)
        self._thread.start()
        try:
            return self._first_hello.result(timeout=within_s)
        except TimeoutError:
            self.close()
            raise LinkLostError(
                f"the stage's port did not do anything for {within_s:g} s: pull it, plug it in"
            ) from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the thread and close the port; idempotent."""
        self._closing = True
        self._wake()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=5)
            self._thread = None
        self._drop_port()
        self._fail_all("the link is closed")
        for fd in (self._wake_read, self._wake_write):
            if fd >= 0:
                os.close(fd)
        self._wake_read = self._wake_write = -1

    def send(self, kind: Cmd, body: bytes = b"") -> Future[Block]:
        """Queue a command; the future holds its answer, or LinkLostError."""
        command = SerialCommand(kind, body)
        with self._lock:
            if self._closing or self._port is None or self._nonce == 0:
                command.answer.set_exception(LinkLostError("the stage's controller is not connected"))
            elif not self._window.put(command):
                command.answer.set_exception(LinkLostError("the stage's controller does not answer"))
        self._wake()
        return command.answer

    def ask(self, kind: Cmd, body: bytes = b"", timeout_s: float = 3.0) -> Block:
        """Send a command and wait for its answer.

        Raises:
            LinkLostError: no answer within ``timeout_s``.
        """
        try:
            return self.send(kind, body).result(timeout=timeout_s)
        except TimeoutError as error:
            raise LinkLostError(f"the stage's controller did not answer {kind.name} in {timeout_s} s") from error

    def realtime(self, data: bytes) -> None:
        """Bytes that overtake all queued commands."""
        with self._lock:
            self._realtime += b"\0" + data
        self._wake()

    @property
    def connected(self) -> bool:
        """True while a session stands."""
        return self._nonce != 0

    def counters(self) -> dict[str, int]:
        """Blocks damaged on arrival, blocks sent again, sessions lost."""
        return {"damaged": self._reader.damaged, "resent": self._window.resent, "lost": self.lost_count}

    # ---- the thread ----

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            os.write(self._wake_write, b"w")

    def _run(self) -> None:
        try:
            hello, _same = self._shake_hands(new_nonce(), 0)
        except (SweepscopeError, OSError) as error:
            self._first_hello.set_exception(
                error if isinstance(error, SweepscopeError) else LinkLostError(f"the stage's port failed: {error}")
            )
            return
        self._first_hello.set_result(hello)
        while not self._closing:
            try:
                self._turn()
            except (OSError, LinkLostError) as error:
                self._lose(str(error))

    def _turn(self) -> None:
        port = self._need_port()
        self._write(port)
        self._wait(port)
        self._read(port)
        self._watch_silence()
        # one status request at a time: the next report answers it, or is even newer
        with self._lock:
            asked = self._window.holds(Cmd.STATUS)
        body = None if asked else self._handler.poll()
        if body is not None:
            with self._lock:
                self._window.put(SerialCommand(Cmd.STATUS, body))

    def _need_port(self) -> serial.Serial:
        if self._port is None:
            raise LinkLostError("the stage's port is closed")
        return self._port

    def _write(self, port: serial.Serial) -> None:
        with self._lock:
            now_s = time.monotonic()
            out, self._realtime = self._realtime, b""
            out += b"".join(encode_block(block) for block in self._window.due(now_s))
        write_now(port, out)

    def _wait(self, port: serial.Serial) -> None:
        deadline_s = self._window.deadline_s
        rest_s = _IDLE_S if deadline_s is None else min(max(deadline_s - time.monotonic(), 0.0), _IDLE_S)
        wait_readable(rest_s, port.fileno(), self._wake_read)
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 4096)

    def _read(self, port: serial.Serial) -> None:
        for block in self._reader.feed(read_now(port)):
            self._heard_s = time.monotonic()
            self._take(port, block)

    def _take(self, port: serial.Serial, block: Block) -> None:
        try:
            if block.kind == Msg.ACK and AckBody.unpack(block.body).result == Result.NO_SESSION:
                raise LinkLostError("the stage's controller has restarted")
            with self._lock:
                again = self._window.take(block, time.monotonic())
            write_now(port, b"".join(encode_block(each) for each in again))
            if block.kind == Msg.REPORT:
                self._handler.on_report(*unpack_report(block.body))
        except ValueError as error:
            logger.warning("a valid block has contents that make no sense: %s", error)

    def _watch_silence(self) -> None:
        now_s = time.monotonic()
        if self._window.idle:
            self._unanswered_since_s = None
        elif self._unanswered_since_s is None:
            self._unanswered_since_s = now_s
        elif now_s - max(self._heard_s, self._unanswered_since_s) > self._timing.silence_s:
            raise LinkLostError(f"the stage's controller was silent for {self._timing.silence_s} s")

    # ---- connection lost, and reconnecting ----

    def _lose(self, detail: str) -> None:
        if self._closing:
            return
        self.lost_count += 1
        old_nonce, self._nonce = self._nonce, 0
        nonce = new_nonce()  # one for all tries: the firmware may have accepted it although its answer was lost
        self._fail_all(detail)
        self._handler.on_lost(detail)
        while not self._closing:
            try:
                self._drop_port()
                self._port = self._open_port()
                hello, same = self._shake_hands(nonce, old_nonce)
            except (SweepscopeError, OSError) as error:
                logger.info("the stage's controller is not back yet: %s", error)
                self._pause(_REOPEN_S)
                continue
            self._handler.on_back(hello, same_session=same)
            return

    def _pause(self, duration_s: float) -> None:
        wait_readable(duration_s, self._wake_read)
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 4096)

    def _drop_port(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None

    def _fail_all(self, detail: str) -> None:
        with self._lock:
            lost = self._window.reset()
        for command in lost:
            command.answer.set_exception(LinkLostError(detail))

    def _shake_hands(self, nonce: int, old_nonce: int) -> tuple[HelloReplyBody, bool]:
        """Begin a session; True if the controller has kept its state since the old one."""
        within_s = self._timing.hello_s
        is_new = old_nonce == 0
        hello = shake_hands(self._need_port(), self._reader, nonce, within_s, lambda: self._closing, is_new=is_new)
        same = not is_new and hello.previous_nonce == old_nonce and hello.boot_id == self._boot_id
        with self._lock:
            self._window.reset()
            self._nonce, self._boot_id = nonce, hello.boot_id
            self._heard_s = time.monotonic()
        return hello, same
