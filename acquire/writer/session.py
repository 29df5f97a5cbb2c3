"""One scan after another in the writer: messages in, file written, messages out.

A frame is acknowledged as committed only after it was written, and counted as durable only after fdatasync.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Literal

from acquire.contract.config.load import LoadedConfig
from acquire.contract.errors import AlreadyRunningError, ConfigError, ScanFileError
from acquire.contract.messaging.messages import Ack, AckItem, End, EndAck, Image, Message, Nack, Start, StartAck
from acquire.contract.process.log_throttle import log_throttled
from acquire.contract.process.run_dir import FileLock
from acquire.contract.scan_data.dataset_names import OWNER_LOCK_NAME, PARTIAL_NAME, SEALED_NAME
from acquire.contract.states import Outcome

from .disk import DiskError, disk_error, file_system_of
from .disk_thread import DiskThread
from .frame_store import FrameRefusedError
from .recover import NOTHING_IN_IT
from .scan_file import ScanExistsError, ScanFile, Seal, create_scan

logger = logging.getLogger(__name__)
Refusal = Literal["no such scan", "busy", "shape", "crc", "immutable", "protocol", "no space", "io error"]
Send = Callable[[Message], bool]


class WriterSession:
    """Opens, fills and seals the scan that the daemon announces. Not thread-safe."""

    def __init__(self, config: LoadedConfig, disk: DiskThread, send: Send) -> None:
        """``send`` sends an answer; it returns False if the daemon is not connected."""
        self.counters = {"frames": 0, "same": 0, "refused": 0, "disk_errors": 0}
        self._disk = disk
        self._send = send
        self._seal_s = config.rig.limits.seal_s
        self._sync_every = config.rig.storage.sync_every_frames
        self._scan: ScanFile | None = None
        self._acks: list[AckItem] = []
        self._unsynced = 0
        self._ending: End | None = None
        self._source = ""

    @property
    def scan_uid(self) -> str:
        """Uid of the open scan; empty if there is none."""
        return "" if self._scan is None else self._scan.layout.scan_uid

    # ---- start ----

    def start(self, start: Start) -> None:
        """Open the announced scan, new or begun before; answer with its committed frames or the reason of a refusal."""
        try:
            scan = self._scan_for(start)
        except ScanFileError as error:
            logger.error("scan refused: %s", error)
            self._send(Nack(scan_uid=start.scan_uid, reason=_start_refusal(error), detail=str(error)))
            return
        self._send(
            StartAck(
                scan_uid=start.scan_uid,
                path=str(scan.path),
                committed=scan.committed_ranges(),
                crc32=scan.committed_crc32(),
                durable_count=scan.durable_count,
                reserved=scan.reserved,
            )
        )

    def _scan_for(self, start: Start) -> ScanFile:
        # another daemon may announce it after another process has recovered it: read it anew
        scan = self._scan
        is_open = scan is not None and (self.scan_uid, self._source) == (start.scan_uid, start.epoch)
        if scan is not None and is_open and not _is_to_reopen(scan, start):
            _runs_again(scan)
            return scan
        if not self._disk.wait(self._seal_s):
            raise DiskError(f"the disk has not ended the scan before within {self._seal_s:g} s; look at it")
        self.leave()
        self._scan = scan = _open(start)
        self._source = start.epoch
        disk = file_system_of(scan.path)
        logger.info("scan %s: %d of %d frames are in %s", start.scan_uid, scan.committed_count, scan.count, scan.path)
        reserved = "reserved" if scan.reserved else "NOT reserved: a full disk is found only while writing"
        logger.info("%s (%s), space is %s", disk.kind, disk.promise, reserved)
        return scan

    def leave(self) -> None:
        """Sync what is committed and close the scan; its outcome stays as it is."""
        if self._scan is None:
            return
        try:
            if not self._scan.sealed:
                self._scan.sync()
        except DiskError as error:
            logger.error("%s", error)
        self._scan.close()
        self._scan, self._unsynced, self._ending = None, 0, None

    def leave_orphan(self) -> None:
        """Mark the scan of a daemon that has died as interrupted (it can then be resumed) and close it."""
        scan = self._scan
        if scan is None or scan.sealed or self._ending is not None or self._disk.busy:
            return
        lock = _take_dead_owners_lock(scan.path.parent)
        if lock is None:
            return
        try:
            # another process may have sealed it meanwhile
            if scan.path.exists() and not scan.committed_count:
                scan.seal(Outcome.ABORTED, NOTHING_IN_IT)
            elif scan.path.exists() and scan.outcome != Outcome.INTERRUPTED:
                scan.mark_outcome(
                    Outcome.INTERRUPTED, "F01 nobody owns the sweep any more: its daemon ended, or let go of it"
                )
                logger.warning(
                    "nobody owns the sweep any more: %d of %d frames are in %s", scan.prefix, scan.count, scan.path
                )
            self.leave()
        except ScanFileError as error:
            logger.error("%s", error)
        finally:
            lock.release()

    # ---- frames ----

    def image(self, image: Image, pixels: memoryview | None) -> None:
        """Write a frame; its ack is sent by :meth:`flush`, a refusal at once."""
        if self._scan is None or self.scan_uid != image.scan_uid:
            self._refuse(image, "no such scan", f"scan {image.scan_uid[:40]!r} is not open here")
        elif self._ending is not None:
            self._refuse(image, "busy", "the scan is being sealed")
        elif pixels is None:
            self._refuse(image, "shape", "the message has no pixels")
        else:
            self._write(self._scan, image, pixels)

    def _write(self, scan: ScanFile, image: Image, pixels: memoryview) -> None:
        try:
            done = scan.write_frame(image, pixels)
        except FrameRefusedError as error:
            self._refuse(image, error.reason, str(error))
        except DiskError as error:
            self.counters["disk_errors"] += 1
            self._refuse(image, error.nack_reason, str(error))
        else:
            self.counters["frames" if done == "committed" else "same"] += 1
            self._unsynced += 1
            self._acks.append(AckItem(image.frame_index, image.attempt, image.crc32, image.role))

    def _refuse(self, image: Image, reason: Refusal, detail: str) -> None:
        self.counters["refused"] += 1
        text = f"frame {image.frame_index} refused ({reason}): {detail}"
        log_throttled(logger, self.counters["refused"], text)
        self.flush()
        self._send(
            Nack(
                scan_uid=image.scan_uid,
                reason=reason,
                frame_index=image.frame_index,
                attempt=image.attempt,
                role=image.role,
                detail=detail,
            )
        )

    def flush(self) -> None:
        """Acknowledge what was committed since the last ack."""
        if self._acks:
            acks, self._acks = self._acks, []
            self._ack(acks)

    def beat(self) -> None:
        """Report the state of an open scan, and start a sync of what is not durable yet."""
        if self._scan is not None and not self._scan.sealed:
            self._ack([])
            self._sync(at_least=1)

    def _ack(self, frames: list[AckItem]) -> None:
        assert self._scan is not None
        self._send(
            Ack(
                scan_uid=self.scan_uid,
                frames=frames,
                committed_count=self._scan.committed_count,
                durable_count=self._scan.durable_count,
            )
        )

    # ---- the disk ----

    def start_disk_work(self) -> None:
        """Start the disk work that is due: seal, or sync once enough frames are not durable. Acks never wait for it."""
        if self._ending is not None:
            self._begin_seal(self._ending)
        else:
            self._sync(at_least=self._sync_every)

    def _sync(self, *, at_least: int) -> None:
        if self._scan is None or self._unsynced < at_least or self._scan.sealed or self._disk.busy:
            return
        self._unsynced = 0
        self._disk.submit(self._scan.sync, self._synced)

    def _synced(self, done: Future[Any]) -> None:
        error = done.exception()
        if error is None:
            self._ack([])
        elif isinstance(error, DiskError):
            self.counters["disk_errors"] += 1
            # tried again with the next heartbeat
            self._unsynced += 1
            logger.error("%s", error)
            self._send(Nack(scan_uid=self.scan_uid, reason=error.nack_reason, detail=str(error)))
        else:
            raise error

    # ---- end ----

    def end(self, end: End) -> None:
        """Seal the scan once the disk is free; ``EndAck`` follows. A sealed scan is confirmed again.

        One that is ``interrupted`` is marked with the reason and stays partial.
        """
        if self._scan is None or self.scan_uid != end.scan_uid:
            self._send(Nack(scan_uid=end.scan_uid, reason="no such scan", detail="the scan is not open here"))
        elif self._ending is None:
            self._ending = end

    def _begin_seal(self, end: End) -> None:
        scan = self._scan
        if scan is None or self._disk.busy:
            return
        outcome = Outcome(scan.outcome) if scan.sealed else end.outcome
        if outcome is Outcome.INTERRUPTED:
            self._disk.submit(lambda: _interrupt(scan, end.reason), lambda done: self._sealed(scan, end, done))
        else:
            self._disk.submit(
                lambda: scan.seal(outcome, end.reason, end.checks), lambda done: self._sealed(scan, end, done)
            )

    def _sealed(self, scan: ScanFile, end: End, done: Future[Any]) -> None:
        self._ending = None
        error = done.exception()
        if error is None and done.result() is None:
            logger.info("%s is interrupted: %s", scan.path, end.reason)
            self._send(_not_sealed(scan, end, Outcome.INTERRUPTED, end.reason))
        elif error is None:
            self._confirm(end, done.result())
        elif isinstance(error, ScanFileError):
            self._regret(scan, end, error)
        else:
            raise error

    def _confirm(self, end: End, seal: Seal) -> None:
        if end.digest and end.digest != seal.digest:
            logger.error("the source's digest is %s, the file's %s", end.digest, seal.digest)
        logger.info("%s is sealed as %s: %d frames, %s", seal.path, seal.outcome, seal.committed, self.counters)
        self._send(
            EndAck(
                scan_uid=end.scan_uid,
                path=str(seal.path),
                sealed=True,
                outcome=seal.outcome,
                committed=seal.committed,
                missing=seal.missing,
                digest=seal.digest,
            )
        )

    def _regret(self, scan: ScanFile, end: End, error: ScanFileError) -> None:
        logger.error("not sealed: %s", error)
        self._send(_not_sealed(scan, end, Outcome(scan.outcome) if scan.sealed else Outcome.RUNNING, str(error)))


def _not_sealed(scan: ScanFile, end: End, outcome: Outcome, reason: str) -> EndAck:
    return EndAck(
        scan_uid=end.scan_uid,
        path=str(scan.path),
        sealed=scan.sealed,
        outcome=outcome,
        committed=scan.committed_count,
        missing=scan.missing_ranges(),
        reason=reason,
    )


def _interrupt(scan: ScanFile, reason: str) -> None:
    scan.mark_outcome(Outcome.INTERRUPTED, reason)
    scan.sync()


def _open(start: Start) -> ScanFile:
    """The announced scan: the one in its folder if it has the same uid and plan, else a new one."""
    folder = Path(start.path)
    try:
        there = any((folder / name).is_file() for name in (PARTIAL_NAME, SEALED_NAME))
    except OSError as error:
        raise disk_error(error, folder, "look into") from None
    if not there:
        return create_scan(folder, start)
    scan = ScanFile.open_existing(folder)
    layout = scan.layout
    if layout.scan_uid == start.scan_uid and (layout.format, layout.plan) == (start.format, start.plan):
        if _is_to_reopen(scan, start):
            scan.close()
            return ScanFile.reopen(folder)
        _runs_again(scan)
        return scan
    scan.close()
    raise ScanExistsError(f"{folder} holds another scan ({layout.scan_uid}) or another plan; nothing was written")


def _is_to_reopen(scan: ScanFile, start: Start) -> bool:
    return start.reopen and scan.sealed and scan.outcome == Outcome.STOPPED


def _runs_again(scan: ScanFile) -> None:
    if not scan.sealed and scan.outcome != Outcome.RUNNING:
        scan.mark_outcome(Outcome.RUNNING, "")


def _take_dead_owners_lock(folder: Path) -> FileLock | None:
    """Take the owner's lock of a scan; None while its owner lives, or if the scan never had one."""
    path = folder / OWNER_LOCK_NAME
    if not path.exists():
        return None
    try:
        return FileLock(path, "the sweep of this scan")
    except (AlreadyRunningError, ConfigError):
        return None


def _start_refusal(error: ScanFileError) -> Literal["exists", "no space", "io error", "protocol"]:
    if isinstance(error, DiskError):
        return error.nack_reason
    return "exists" if isinstance(error, ScanExistsError) else "protocol"
