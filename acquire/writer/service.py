"""The writer service: owns the scan file; acks a frame only when it is in the file, and says how many are on disk."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import zmq

from acquire.contract.config.load import LoadedConfig
from acquire.contract.errors import AlreadyRunningError, ProtocolError
from acquire.contract.messaging.codec import ProtocolMismatchError
from acquire.contract.messaging.lanes import Received, Sender, connect, receive
from acquire.contract.messaging.messages import End, Hello, Image, Message, Nack, Start
from acquire.contract.process.logs import follow_scan
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import lock_service, prepare_run_dir
from acquire.contract.units import NS_PER_MS, NS_PER_S

from .disk_thread import DiskThread
from .malloc_tuning import keep_freed_memory
from .recover import RecoverOptions, recover
from .session import ScanSession

logger = logging.getLogger(__name__)
BEAT_NS: Final = NS_PER_S // 2
MAX_BATCH: Final = 32
"""Frames that one ack answers at most."""


def run_writer(config: LoadedConfig, run_dir: Path) -> None:
    """Serve until SIGTERM or SIGINT: what is committed is pressed onto the disk, a running scan stays partial.

    Raises:
        AlreadyRunningError: another writer runs here, or has taken over.
        ConfigError: the socket directory cannot be used.
    """
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="writer %(levelname)s %(message)s")
    lock = lock_service(prepare_run_dir(run_dir), "writer")
    keep_freed_memory()
    context: zmq.Context[Any] = zmq.Context()
    try:
        # nothing may pile up for a daemon that is away: what is said to it must be true when it hears it
        socket = connect(context, zmq.DEALER, run_dir, "frames", immediate=True)
        service = WriterService(socket, config)
        try:
            with _stopped_by_signals(service), _looking_after_the_interrupted(config.data_dir):
                logger.info("ready (pid %d), looking for the daemon in %s", os.getpid(), run_dir)
                service.run()
        finally:
            service.close()
    finally:
        context.destroy(linger=0)
        lock.release()


@contextmanager
def _stopped_by_signals(service: WriterService) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, lambda *_: service.stop()) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _looking_after_the_interrupted(data_dir: Path) -> Iterator[None]:
    """Verify and mark, beside the service, the scans whose owners died since the last start."""
    leaving = threading.Event()
    thread = threading.Thread(target=_look_after, args=(data_dir, leaving), name="recover", daemon=True)
    thread.start()
    try:
        yield
    finally:
        leaving.set()
        # verifying one scan may take longer than a service has to leave; each of its steps may be the last
        thread.join(timeout=5)


def _look_after(data_dir: Path, leaving: threading.Event) -> None:
    try:
        for found in recover(data_dir, RecoverOptions(begun_only=True), stop=leaving.is_set):
            logger.info("looked after %s", found.words())
    except OSError as error:
        logger.warning("cannot look after the scans in %s: %s", data_dir, error)


class WriterService:
    """The writer's loop. One thread runs it; :meth:`stop` may be called from anywhere."""

    def __init__(self, socket: zmq.Socket[Any], config: LoadedConfig) -> None:
        self.counters = {"malformed": 0, "unsent": 0}
        self._socket = socket
        self._sender = Sender(socket)
        self._disk = DiskThread()
        self._session = ScanSession(config, self._disk, self._send)
        self._seal_s = config.rig.limits.seal_s
        self._next_beat_ns = self._next_watch_ns = 0
        self._stop_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._stopping = False

    def stop(self) -> None:
        """End :meth:`run` soon; safe in a signal handler."""
        self._stopping = True
        os.eventfd_write(self._stop_fd, 1)

    def run(self) -> None:
        """Handle messages until :meth:`stop`.

        Raises:
            AlreadyRunningError: another writer has taken over.
        """
        poller = zmq.Poller()
        poller.register(self._disk.fileno(), zmq.POLLIN)
        poller.register(self._stop_fd, zmq.POLLIN)
        notifier = Notifier()
        notifier.ready("the writer waits for scans")
        while not self._stopping:
            heard = self._beat()
            # a beat that nobody could hear goes out as soon as somebody is there
            poller.register(self._socket, zmq.POLLIN if heard else zmq.POLLIN | zmq.POLLOUT)
            wait_ns = max(0, self._next_beat_ns - _now_ns()) if heard else BEAT_NS
            poller.poll(wait_ns // NS_PER_MS + 1)
            self._drain()
            self._disk.collect()
            self._session.press_on()
            self._watch_owner()
            notifier.alive()

    def close(self) -> None:
        """Press what is committed onto the disk and leave."""
        if not self._disk.wait(self._seal_s):
            logger.error("the disk has not answered within %g s", self._seal_s)
        self._session.leave()
        self._disk.close()
        os.close(self._stop_fd)
        self._socket.close(linger=0)

    def _beat(self) -> bool:
        """Say hello and how far things are, every half second; False if it was due and nobody could hear it."""
        now_ns = _now_ns()
        if now_ns < self._next_beat_ns:
            return True
        if not self._send(Hello(pid=os.getpid())):
            return False
        self._next_beat_ns = now_ns + BEAT_NS
        self._session.beat()
        return True

    def _watch_owner(self) -> None:
        """Let go of the scan of a daemon that died, also where nobody is there to hear a beat."""
        now_ns = _now_ns()
        if now_ns >= self._next_watch_ns:
            self._next_watch_ns = now_ns + BEAT_NS
            self._session.leave_orphan()

    def _drain(self) -> None:
        for _ in range(MAX_BATCH):
            try:
                received = receive(self._socket)
            except ProtocolError as error:
                self._malformed(error)
                continue
            if received is None:
                break
            self._take(received)
        self._session.flush()

    def _take(self, received: Received) -> None:
        message = received.message
        if isinstance(message, Image):
            self._session.image(message, None if received.payload is None else received.payload.buffer)
            return
        # whatever else comes is answered after the frames before it
        self._session.flush()
        if isinstance(message, Start):
            follow_scan(message.scan_uid)
            self._session.start(message)
        elif isinstance(message, End):
            self._session.end(message)
        elif isinstance(message, Nack) and message.reason == "superseded":
            raise AlreadyRunningError("another writer has taken over; this one has stopped writing")
        else:
            self._malformed(ProtocolError(f"a {type(message).__name__} does not belong here"))

    def _malformed(self, error: ProtocolError) -> None:
        self.counters["malformed"] += 1
        count = self.counters["malformed"]
        if count <= 10 or count % 1000 == 0:
            logger.warning("message %d that cannot be used: %s", count, error)
        if isinstance(error, ProtocolMismatchError):
            self._send(Nack(reason="protocol", detail=str(error)))

    def _send(self, message: Message) -> bool:
        sent = self._sender.send(message)
        if not sent:
            self.counters["unsent"] += 1
        return sent


def _now_ns() -> int:
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)
