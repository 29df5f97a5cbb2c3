"""The worker service: folds each frame as it comes, publishes the growing cloud, leaves maps, cloud and report.

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
from acquire.contract.errors import ScanFileError, SweepscopeError
from acquire.contract.messaging.lanes import Received, arrived, bind, connect
from acquire.contract.messaging.messages import End, Image, ResultProgress, Start, Status
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.process.logs import follow_scan
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import lock_service
from acquire.contract.units import NS_PER_MS, NS_PER_S
from process.results.scan_frames import open_frames
from process.warmup import warm_up

from .live_maps import samples_of, samples_on_disk
from .live_scan import LiveScan
from .publisher import ResultPublisher
from .scan_description import ScanDescription

logger = logging.getLogger(__name__)

LIVE_QUEUE_BYTES = 256_000_000
"""Live frames that may wait while a preview is made; what does not fit is lost here and read from the file."""
IDLE_MS = 100
FILE_WAIT_MS = 5
MAX_BURST = 32
"""Messages of one socket handled before anything else gets its turn."""
REFRESH_NS = 300 * NS_PER_MS
"""Period of looking whether a finished scan was sealed meanwhile."""
REFRESH_FOR_NS = 180 * NS_PER_S
RETRY_NS = 3 * NS_PER_S
MAX_TRIES = 20


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
        camera = config.rig.camera
        queued_frames = LIVE_QUEUE_BYTES // (camera.width * camera.height * 3)
        self._results = bind(context, zmq.XPUB, run_dir, "results")
        self._status = connect(context, zmq.SUB, run_dir, "status")
        self._live = connect(context, zmq.SUB, run_dir, "live", queued=max(16, min(1024, queued_frames)))
        self._poller = zmq.Poller()
        for socket in (self._live, self._status, self._results):
            self._poller.register(socket, zmq.POLLIN)
        self.publisher = ResultPublisher(self._results)
        self.scan: LiveScan | None = None
        self.malformed = 0
        self._refused_uid = ""
        self._changed = False
        """The fold went on since the last progress message."""
        self._preview_wanted = False
        """There is a new subscriber, who gets the maps without waiting for the next frame."""
        self._file_flows = False
        """The file had frames for the fold when it was last asked: it may have more."""
        self._refresh_ns = self._refresh_until_ns = self._retry_ns = self._tries = 0

    def close(self) -> None:
        """Close sockets and file."""
        self._drop_scan()
        for socket in (self._live, self._status, self._results):
            socket.close(0)

    def run(self, stop: threading.Event) -> None:
        """Work until ``stop`` is set."""
        logger.info("worker ready")
        notifier = Notifier()
        notifier.ready("the worker waits for frames")
        while not stop.is_set():
            self.turn()
            notifier.alive()

    def turn(self) -> None:
        """Wait at most :data:`IDLE_MS` for something to do, and do it."""
        ready = dict(self._poller.poll(self.patience_ms()))
        if self._results in ready and self.publisher.answer_newcomers(self._progress()):
            self._preview_wanted = True
        drained = self._live not in ready or self._drain(self._live)
        if self._status in ready and drained:  # an end must not overtake the frames that came before it
            self._drain(self._status)
        if self.scan is not None:
            self._advance(self.scan, idle=self._live not in ready)
        now_ns = self._clock.now_ns()
        if self.publisher.progress_due(now_ns, changed=self._changed):
            self._changed = False
            self.publisher.progress(self._progress(), now_ns)

    def _progress(self) -> ResultProgress | None:
        return None if self.scan is None else self.scan.progress()

    def patience_ms(self) -> int:
        """How long the next turn may wait for a message: not at all while there is work."""
        scan = self.scan
        if scan is None or scan.failure or scan.results is not None:
            return IDLE_MS
        if scan.lag_frames:
            return 0 if self._file_flows else FILE_WAIT_MS
        if scan.may_fit_early:
            return 0
        return FILE_WAIT_MS if scan.wants_file or scan.cursor.done else IDLE_MS

    # ---- what comes in ----

    def _drain(self, socket: zmq.Socket[Any]) -> bool:
        """Take up to :data:`MAX_BURST` messages; True if no more are there."""
        for received in arrived(socket, MAX_BURST, self._ignore):
            self._take(received, live=socket is self._live)
        return not socket.poll(0)

    def _ignore(self, why: object) -> None:
        self.malformed += 1
        logger.warning("ignored: %s", why)

    def _take(self, received: Received, *, live: bool) -> None:
        message = received.message
        if live and isinstance(message, Image) and received.payload is not None:
            if self.scan is not None:
                self._changed |= self.scan.take_image(message, received.payload.buffer)
        elif live and isinstance(message, Start):
            self._begin(ScanDescription.of_start(message))
        elif live and isinstance(message, End):
            if self.scan is not None and message.scan_uid == self.scan.description.scan_uid:
                self.scan.take_end(message)
        elif not live and isinstance(message, Status):
            self._take_status(message)
        else:
            self._ignore(f"a {type(message).__name__} does not belong on this lane")

    def _take_status(self, status: Status) -> None:
        """The newest status; from it a worker that started late learns of the scan."""
        if not status.scan_uid or not status.scan_path or status.scan_uid == self._refused_uid:
            return
        if self.scan is None or self.scan.description.scan_uid != status.scan_uid:
            self._join(status)
        if self.scan is not None:
            self.scan.take_status(status)

    def _join(self, status: Status) -> None:
        frames = open_frames(Path(status.scan_path), status.scan_uid)
        if frames is None:
            return
        with frames:
            try:
                description = ScanDescription.of_file(frames)
            except ScanFileError as error:
                self._refuse(status.scan_uid, error)
                return
        self._begin(description)
        if self.scan is not None:
            self.scan.catch_up()

    def _begin(self, description: ScanDescription) -> None:
        same = self.scan is not None and self.scan.description.scan_uid == description.scan_uid
        if self.scan is not None and same and not (description.reopened and self.scan.ended):
            return
        self._drop_scan()
        try:
            scan = LiveScan(description, self._config.rig.limits.fold_bytes, self._clock)
        except (SweepscopeError, ValueError, MemoryError) as error:
            self._refuse(description.scan_uid, error)
            return
        follow_scan(description.scan_uid)
        logger.info("scan %s: %d frames", description.scan_uid, description.count)
        self.scan = scan
        self._refresh_ns = self._refresh_until_ns = self._retry_ns = self._tries = 0
        self.publisher.begin(description.scan_uid, scan.form, scan.settings.contrast)
        self.publisher.progress(scan.progress(), now_ns=0)

    def _refuse(self, scan_uid: str, error: Exception) -> None:
        logger.error("scan %s is not folded: %s", scan_uid, error)
        self._refused_uid = scan_uid
        self.publisher.refuse(scan_uid, str(error) or type(error).__name__)

    def _drop_scan(self) -> None:
        if self.scan is None:
            return
        if self.scan.results is None:
            folder = self.scan.description.folder
            logger.warning("scan %s is left without maps: 'sweepscope reconstruct' makes them", folder)
        self.scan.close()
        self.scan = None

    # ---- what is done ----

    def _advance(self, scan: LiveScan, *, idle: bool) -> None:
        """One step: gaps from the file, a preview, the results when all is folded, the report when it is sealed.

        Without anything else to do, estimates that would otherwise be left to the end.
        """
        self._file_flows = False
        if scan.failure and not self._tries_again(scan):
            return
        try:
            if scan.wants_file and scan.fill():
                self._changed = self._file_flows = True
            if scan.ready_to_finish():
                self._finish(scan)
            elif scan.results is not None:
                self._refresh(scan)
            elif self._preview_due(scan):
                self._preview(scan)
            elif idle and not scan.lag_frames and scan.may_fit_early:
                scan.fit_early()
        except SweepscopeError as error:
            self._fail(scan, str(error))
        except Exception as error:  # noqa: BLE001 - a scan must not end the worker; `reconstruct` makes what it could not
            logger.exception("scan %s", scan.description.scan_uid)
            scan.restart()
            self._fail(scan, f"{type(error).__name__}: {error}")

    def _preview_due(self, scan: LiveScan) -> bool:
        """True if there is something new to show and the results of the whole sweep are not due instead."""
        wanted = (self._changed and not scan.cursor.done) or self._preview_wanted
        return wanted and self.publisher.preview_due(self._clock.now_ns(), scan.lag_frames)

    def _preview(self, scan: LiveScan) -> None:
        """Publish the points and maps so far; the next preview waits in proportion to the cost of this one."""
        self._preview_wanted = False
        start_ns = self._clock.now_ns()
        found, through = scan.preview(), scan.cursor.fold.folded_through
        if found is not None and found.cloud is not None:
            self.publisher.points(found.cloud, found.provisional, through)
        if found is not None and self.publisher.maps_due(start_ns):
            self.publisher.maps(samples_of(found.maps), through, start_ns)
        self.publisher.preview_made(start_ns, self._clock.now_ns())

    def _finish(self, scan: LiveScan) -> None:
        results = scan.finish()
        seconds = scan.seconds_to_disk
        logger.info("scan %s: results on disk %.3f s after the last frame", scan.description.scan_uid, seconds)
        now_ns, through = self._clock.now_ns(), scan.cursor.fold.folded_through
        if results.cloud is not None:
            settled = np.zeros(len(results.cloud), np.bool_)
            self.publisher.points(results.cloud, settled, through, final=True)
        try:
            self.publisher.maps(samples_on_disk(results.paths.maps), through, now_ns)
        except ScanFileError as error:
            logger.warning("%s", error)  # removed since; subscribers do without
        self._refresh_ns, self._refresh_until_ns = 0, now_ns + REFRESH_FOR_NS
        self._changed = True
        self._publish_end(scan)

    def _refresh(self, scan: LiveScan) -> None:
        now_ns = self._clock.now_ns()
        if self._refresh_ns <= now_ns <= self._refresh_until_ns:
            self._refresh_ns = now_ns + REFRESH_NS
            if scan.refresh() or self.publisher.end is None:
                self._publish_end(scan)

    def _publish_end(self, scan: LiveScan) -> None:
        end = scan.end_message()
        if end is not None:
            self.publisher.results(end)

    def _fail(self, scan: LiveScan, why: str) -> None:
        scan.failure = f"no maps: {why}; the scan is safe, 'sweepscope reconstruct' makes them"
        logger.error("%s", scan.failure)
        self._retry_ns = self._clock.now_ns() + RETRY_NS
        self._tries += 1
        self._changed = True

    def _tries_again(self, scan: LiveScan) -> bool:
        """True if it is time for another try: a full disk may have room again, a file may be back."""
        if self._tries >= MAX_TRIES or self._clock.now_ns() < self._retry_ns:
            return False
        scan.failure = ""
        return True
