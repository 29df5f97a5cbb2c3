"""The writer service: stores frames in the scan file and acknowledges each as committed, later as durable."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
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
from acquire.contract.process.clocks import mono_ns
from acquire.contract.process.logs import follow_scan
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import lock_service, prepare_run_dir
from acquire.contract.units import NS_PER_MS, NS_PER_S

from .disk_thread import DiskThread
from .malloc_tuning import keep_freed_memory
from .recover import RecoverOptions, recover
from .session import WriterSession

logger = logging.getLogger(__name__)
BEAT_NS: Final = NS_PER_S // 2
MAX_BATCH: Final = 32
"""Frames that one ack answers at most."""


def run_writer(config: LoadedConfig, run_dir: Path) -> None:
    """Serve until SIGTERM or SIGINT; committed frames are synced then, and a running scan stays partial.

    Raises:
        AlreadyRunningError: another writer runs here, or has taken over.
        ConfigError: the socket directory cannot be used.
    """
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="writer %(levelname)s %(message)s")
    lock = lock_service(prepare_run_dir(run_dir), "writer")
    keep_freed_memory()
    context: zmq.Context[Any] = zmq.Context()
    try:
        # do not queue messages while the daemon is away: they would be out of date when it reads them
        socket = connect(context, zmq.DEALER, run_dir, "frames", immediate=True)
        service = WriterService(socket, config)
        try:
            with _stopped_by_signals(service), _recovering_in_background(config.data_dir):
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
def _recovering_in_background(data_dir: Path) -> Iterator[None]:
    """In a thread: verify and mark the scans whose owners died since the last start."""
    leaving = threading.Event()
    thread = threading.Thread(target=_recover, args=(data_dir, leaving), name="recover", daemon=True)
    thread.start()
    try:
        yield
    finally:
        leaving.set()
        # verifying a scan may take longer than a service may take to stop; it can be cut off between any two steps
        thread.join(timeout=5)


def _recover(data_dir: Path, leaving: threading.Event) -> None:
    try:
        for found in recover(data_dir, RecoverOptions(begun_only=True), stop=leaving.is_set):
            logger.info("recovered %s", found.words())
    except OSError as error:
        logger.warning("cannot recover the scans in %s: %s", data_dir, error)


class WriterService:
    """The writer's loop. One thread runs it; :meth:`stop` may be called from anywhere."""

    def __init__(self, socket: zmq.Socket[Any], config: LoadedConfig) -> None:
        self.counters = {"malformed": 0, "unsent": 0}
        self._socket = socket
        self._sender = Sender(socket)
        self._disk = DiskThread()
        self._session = WriterSession(config, self._disk, self._send)
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
        disk_fd = self._disk.fileno()
        poller.register(disk_fd, zmq.POLLIN)
        poller.register(self._stop_fd, zmq.POLLIN)
        notifier = Notifier()
        notifier.ready("the writer waits for scans")
        while not self._stopping:
            sent = self._beat()
            # a heartbeat that could not be sent goes out as soon as the daemon is connected
            poller.register(self._socket, zmq.POLLIN if sent else zmq.POLLIN | zmq.POLLOUT)
            wait_ns = max(0, self._next_beat_ns - mono_ns()) if sent else BEAT_NS
            ready = dict(poller.poll(wait_ns // NS_PER_MS + 1))
            self._drain()
            if disk_fd in ready:
                self._disk.collect()
            self._session.start_disk_work()
            self._watch_owner()
            notifier.alive()

    def close(self) -> None:
        """Sync what is committed and close everything."""
        if not self._disk.wait(self._seal_s):
            logger.error("the disk has not answered within %g s", self._seal_s)
        self._session.leave()
        self._disk.close()
        os.close(self._stop_fd)
        self._socket.close(linger=0)

    def _beat(self) -> bool:
        """Send hello and the state of the scan every half second; False if it was due and could not be sent."""
        now_ns = mono_ns()
        if now_ns < self._next_beat_ns:
            return True
        if not self._send(Hello(pid=os.getpid())):
            return False
        self._next_beat_ns = now_ns + BEAT_NS
        self._session.beat()
        return True

    def _watch_owner(self) -> None:
        """Release the scan of a daemon that died, even if no other daemon is connected."""
        now_ns = mono_ns()
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
        # acknowledge the frames that came before any other message
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
            logger.warning("invalid message %d: %s", count, error)
        if isinstance(error, ProtocolMismatchError):
            self._send(Nack(reason="protocol", detail=str(error)))

    def _send(self, message: Message) -> bool:
        sent = self._sender.send(message)
        if not sent:
            self.counters["unsent"] += 1
        return sent
