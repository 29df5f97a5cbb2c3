"""Owns the worker service: folds each frame as it comes, shows the cloud growing, leaves maps, cloud and report.

It can start, die and start again at any moment: what it missed is in the scan file, and nothing waits for it.
"""

from __future__ import annotations

import logging
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from acquire.contract.config.load import LoadedConfig
from acquire.contract.errors import ProtocolError, ScanFileError, SweepscopeError
from acquire.contract.messaging.lanes import Received, bind, connect, open_socket, receive
from acquire.contract.messaging.messages import End, Image, Message, ResultEnd, Start, Status
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.process.logs import follow_scan
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import endpoint, lock_service
from acquire.contract.units import NS_PER_MS, NS_PER_S
from process.results.scan_frames import open_frames
from process.warmup import warm_up

from .provisional_cloud import Preview, ShownCounts
from .publisher import Outbox
from .scan_description import Announced, announced_by_file, announced_by_start
from .session import ScanSession

logger = logging.getLogger(__name__)

LIVE_QUEUE_BYTES = 256_000_000
"""Live frames that may wait while a preview is made; what does not fit is lost here and read from the file."""
IDLE_MS = 100
FILE_WAIT_MS = 5
MAX_BURST = 32
"""Live messages handled before anything else gets its turn."""
REFRESH_NS = 300 * NS_PER_MS
"""Period of looking whether a finished scan was sealed meanwhile."""
RETRY_NS = 3 * NS_PER_S
MAX_TRIES = 20
REFRESH_FOR_NS = 180 * NS_PER_S


def run_worker(config: LoadedConfig, run_dir: Path) -> None:
    """Run until SIGTERM or SIGINT.

    Raises:
        AlreadyRunningError: another worker holds the lock.
        ConfigError: the socket directory cannot be used.
    """
    lock = lock_service(run_dir, "worker")
    stop = threading.Event()
    context: zmq.Context[Any] = zmq.Context()
    try:
        worker = Worker(config, run_dir, context)
        try:
            warm_up()  # compiling may take a minute and has nothing to save: a signal ends it at once
            if threading.current_thread() is threading.main_thread():
                for number in (signal.SIGTERM, signal.SIGINT):
                    signal.signal(number, lambda *_: stop.set())
            worker.run(stop)
        finally:
            worker.close()
    finally:
        context.term()
        lock.release()


class Worker:
    """The sockets and the one scan that is being folded. One thread calls everything."""

    def __init__(
        self, config: LoadedConfig, run_dir: Path, context: zmq.Context[Any], clock: Clock | None = None
    ) -> None:
        self._config = config
        self._clock = clock or MonotonicClock()
        self._results = bind(context, zmq.XPUB, run_dir, "results")
        self._status = connect(context, zmq.SUB, run_dir, "status")
        self._live = _connect_live(context, run_dir, config)
        self._poller = zmq.Poller()
        for socket in (self._live, self._status, self._results):
            self._poller.register(socket, zmq.POLLIN)
        self.outbox = Outbox(self._results)
        self.session: ScanSession | None = None
        self.malformed = 0
        self._refused_uid = ""
        self._news = False
        self._file_flows = False
        """The file had frames for the fold when it was last asked: it may have more."""
        self._refresh_ns = self._refresh_until_ns = self._retry_ns = self._tries = 0

    def close(self) -> None:
        """Close sockets and file."""
        self._drop_session()
        for socket in (self._live, self._status, self._results):
            socket.close(0)

    def run(self, stop: threading.Event) -> None:
        """Turn until told to stop."""
        logger.info("worker ready")
        notifier = Notifier()
        notifier.ready("the worker waits for frames")
        while not stop.is_set():
            self.turn()
            notifier.alive()

    def turn(self) -> None:
        """Wait for something to do for at most :data:`IDLE_MS`, and do it."""
        ready = dict(self._poller.poll(self._patience_ms()))
        if self._results in ready:
            self.outbox.answer_newcomers(self.session)
        drained = self._live not in ready or self._drain(self._live, MAX_BURST)
        if self._status in ready and drained:  # an end must not overtake the frames that came before it
            self._drain(self._status, MAX_BURST)
        if self.session is not None:
            self._advance(self.session, idle=self._live not in ready)
        now_ns = self._clock.now_ns()
        if self.outbox.progress_due(now_ns, news=self._news):
            self._news = False
            self.outbox.say_progress(self.session, now_ns)

    def _patience_ms(self) -> int:
        session = self.session
        if session is None or session.failure or session.results is not None:
            return IDLE_MS
        if session.behind:
            return 0 if self._file_flows else FILE_WAIT_MS
        if session.may_work_ahead:
            return 0
        return FILE_WAIT_MS if session.wants_file or session.cursor.done else IDLE_MS

    # ---- what comes in ----

    def _drain(self, socket: zmq.Socket[Any], most: int) -> bool:
        """Take up to ``most`` messages; True if no more are there."""
        for _ in range(most):
            try:
                received = receive(socket)
            except ProtocolError as error:
                self.malformed += 1
                logger.warning("ignored: %s", error)
                continue
            if received is None:
                return True
            self._take(received, live=socket is self._live)
        return False

    def _take(self, received: Received, *, live: bool) -> None:
        message = received.message
        if live and isinstance(message, Image) and received.payload is not None:
            if self.session is not None:
                self._news |= self.session.take_image(message, received.payload.buffer)
        elif live and isinstance(message, Start):
            self._begin(announced_by_start(message))
        elif live and isinstance(message, End):
            if self.session is not None and message.scan_uid == self.session.announced.scan_uid:
                self.session.take_end(message)
        elif not live and isinstance(message, Status):
            self._take_status(message)
        else:
            self._ignore(message)

    def _ignore(self, message: Message) -> None:
        self.malformed += 1
        logger.warning("ignored a %s that does not belong here", type(message).__name__)

    def _take_status(self, status: Status) -> None:
        """The newest state; it tells a late worker which scan there is."""
        if not status.scan_uid or not status.scan_path or status.scan_uid == self._refused_uid:
            return
        if self.session is None or self.session.announced.scan_uid != status.scan_uid:
            self._join(status)
        if self.session is not None:
            self.session.take_status(status)

    def _join(self, status: Status) -> None:
        frames = open_frames(Path(status.scan_path), status.scan_uid)
        if frames is None:
            return
        with frames:
            try:
                announced = announced_by_file(frames)
            except ScanFileError as error:
                self._refuse(status.scan_uid, error)
                return
        self._begin(announced)
        if self.session is not None:
            self.session.catch_up()

    def _begin(self, announced: Announced) -> None:
        if self.session is not None and self.session.announced.scan_uid == announced.scan_uid:
            return
        self._drop_session()
        try:
            self.session = ScanSession(announced, self._config.rig.limits.fold_bytes, self._clock)
        except (SweepscopeError, ValueError, MemoryError) as error:
            self._refuse(announced.scan_uid, error)
            return
        follow_scan(announced.scan_uid)
        logger.info("scan %s: %d frames", announced.scan_uid, announced.count)
        self._refresh_ns = self._refresh_until_ns = self._retry_ns = self._tries = 0
        self.outbox.begin(self.session)

    def _refuse(self, scan_uid: str, error: Exception) -> None:
        logger.error("scan %s is not folded: %s", scan_uid, error)
        self._refused_uid = scan_uid
        self.outbox.refuse(scan_uid, str(error) or type(error).__name__)

    def _drop_session(self) -> None:
        if self.session is None:
            return
        if self.session.results is None:
            logger.warning("scan %s is left without maps: 'sweepscope reconstruct' makes them", self.session.folder)
        self.session.close()
        self.session = None

    # ---- what is done ----

    def _advance(self, session: ScanSession, *, idle: bool) -> None:
        """One step: gaps from the file, a preview, the results when all is folded, the report when it is sealed.

        Without anything else to do, estimates that would otherwise be left to the end.
        """
        self._file_flows = False
        if session.failure and not self._tries_again(session):
            return
        try:
            if session.wants_file and session.fill():
                self._news = self._file_flows = True
            if session.ready_to_finish():
                self._finish(session)
            elif session.results is not None:
                self._refresh(session)
            elif self._preview_due(session):
                self.outbox.say_preview(session)
            elif idle and not session.behind and session.may_work_ahead:
                session.work_ahead()
        except SweepscopeError as error:
            self._fail(session, str(error))
        except Exception as error:  # noqa: BLE001 - the worker outlives any scan; what it could not make is made by reconstruct
            logger.exception("scan %s", session.announced.scan_uid)
            session.cursor.restart()
            self._fail(session, f"{type(error).__name__}: {error}")

    def _preview_due(self, session: ScanSession) -> bool:
        """There is something new to show, or to look at, and the end of the sweep does not wait for its results."""
        asked = (self._news and not session.cursor.done) or self.outbox.wants_preview
        return asked and self.outbox.preview_due(self._clock.now_ns(), session.lag_frames)

    def _fail(self, session: ScanSession, why: str) -> None:
        session.failure = f"no maps: {why}; the scan is safe, 'sweepscope reconstruct' makes them"
        logger.error("%s", session.failure)
        self._retry_ns = self._clock.now_ns() + RETRY_NS
        self._tries += 1
        self._news = True

    def _tries_again(self, session: ScanSession) -> bool:
        """A full disk may have room again, a file may have come back: try so often, and no oftener."""
        if self._tries >= MAX_TRIES or self._clock.now_ns() < self._retry_ns:
            return False
        session.failure = ""
        return True

    def _finish(self, session: ScanSession) -> None:
        results = session.finish()
        seconds = (self._clock.now_ns() - session.last_frame_ns) / NS_PER_S
        logger.info("scan %s: results on disk %.3f s after the last frame", session.announced.scan_uid, seconds)
        session.seconds_to_disk = seconds
        if results.cloud is not None:
            still = np.zeros(len(results.cloud), np.bool_)
            self.outbox.say_final(session, Preview(results.cloud, still, ShownCounts()))
        self.outbox.say_maps_on_disk(session)
        self._refresh_ns = 0
        self._refresh_until_ns = self._clock.now_ns() + REFRESH_FOR_NS
        self._news = True
        if session.ended:
            self._say_end(session)

    def _refresh(self, session: ScanSession) -> None:
        now_ns = self._clock.now_ns()
        if not self._refresh_ns <= now_ns <= self._refresh_until_ns:
            return
        self._refresh_ns = now_ns + REFRESH_NS
        if session.refresh() or (session.ended and not session.end_said):
            self._say_end(session)

    def _say_end(self, session: ScanSession) -> None:
        results = session.results
        if results is None or not session.ended:
            return
        session.end_said = True
        self.outbox.say_end(
            ResultEnd(
                scan_uid=session.announced.scan_uid,
                version=0,
                outcome=session.outcome,
                folded_through=session.cursor.fold.folded_through,
                points=results.report.counts["points"],
                maps_path=str(results.paths.maps),
                cloud_path=str(results.paths.cloud) if results.cloud is not None else "",
                report_path=str(results.paths.report),
                seconds=session.seconds_to_disk,
                message=session.settings.what_is_missing,
            )
        )


def _connect_live(context: zmq.Context[Any], run_dir: Path, config: LoadedConfig) -> zmq.Socket[Any]:
    """The live lane with a queue bounded in bytes, deeper than the lane's usual one: previews take a while."""
    camera = config.rig.camera
    socket = open_socket(context, zmq.SUB, "live")
    socket.setsockopt(zmq.RCVHWM, max(16, min(1024, LIVE_QUEUE_BYTES // (camera.width * camera.height * 3))))
    socket.setsockopt(zmq.SUBSCRIBE, b"")
    socket.connect(endpoint(run_dir, "live"))
    return socket
