"""The publisher of the pipeline benchmark: the daemon's sockets without a rig, with the time of each milestone."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import zmq
from numpy.typing import NDArray

from acquire.activities.images import PreviewFrame
from acquire.activities.preview_publisher import MOST_IN_A_SWEEP_HZ, PreviewPublisher
from acquire.contract.errors import NoServiceError, SweepscopeError
from acquire.contract.messaging.lanes import Sender, bind, connect, receive, shared
from acquire.contract.messaging.messages import (
    End,
    EndAck,
    FrameFormat,
    Image,
    ResultEnd,
    ResultProgress,
    Start,
    Status,
)
from acquire.contract.plan import SweepPlan
from acquire.contract.process.clocks import epoch_utc_ns, utc_now_iso
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.states import Outcome, State
from acquire.contract.units import NS_PER_S
from acquire.daemon.frame_sender import FrameSender
from acquire.sweep.credit_window import CreditWindow, slots_for
from acquire.sweep.events import Committed, Sealed

READY_S: Final = 90.0
RUN_S: Final = 300.0
STATUS_NS: Final = NS_PER_S // 5


@dataclass
class Marks:
    """Time of each milestone in ns of CLOCK_MONOTONIC; 0 not reached yet."""

    begin_ns: int = 0
    sent_ns: int = 0
    committed_ns: int = 0
    folded_ns: int = 0
    sealed_ns: int = 0
    results_ns: int = 0
    progress: ResultProgress | None = None
    end_ack: EndAck | None = None
    result_end: ResultEnd | None = None
    live_unsent: int = 0
    pictures_ns: int = 0
    """Time spent on preview pictures."""
    counts: dict[str, int] = field(default_factory=dict)
    worker_s: dict[str, float] = field(default_factory=dict)
    """Processor time of the worker by task, from its report."""
    cpu_s: dict[str, float] = field(default_factory=dict)
    """Processor time from the first frame until everything is on disk, by process."""


class Publisher:
    """Sends a sweep, every frame as soon as there is credit. One thread calls everything."""

    def __init__(
        self,
        context: zmq.Context[Any],
        place: Path,
        ring: NDArray[np.uint8],
        frames: int,
        pids: dict[str, int],
        *,
        pictures: bool = False,
    ) -> None:
        """``pictures``: a subscriber gets preview pictures, as often as in a sweep."""
        self._ring, self._frames = ring, frames
        self.preview = PreviewPublisher(bind(context, zmq.XPUB, place, "preview"))
        self._looks = connect(context, zmq.SUB, place, "preview") if pictures else None
        self._pids = {"publisher": os.getpid(), **pids}
        self._lane = FrameSender(bind(context, zmq.ROUTER, place, "frames"))
        self._live = Sender(bind(context, zmq.PUB, place, "live"))
        self._status = Sender(bind(context, zmq.PUB, place, "status"))
        self._results = connect(context, zmq.SUB, place, "results")
        self._poller = zmq.Poller()
        for socket in (self._lane.socket, self._results):
            self._poller.register(socket, zmq.POLLIN)
        plan = SweepPlan(0, frames - 1, 1, 3.175)
        form = FrameFormat(ring.shape[2], ring.shape[1], 8)
        self._start = Start(
            scan_uid=uuid.uuid4().hex,
            path=str(place / "scan"),
            format=form,
            plan=plan,
            user_json='{"name": "bench", "purpose": "raw"}',
            start_time_utc=utc_now_iso(),
            epoch_utc_ns=epoch_utc_ns(),
        )
        self._window = CreditWindow(slots_for(256_000_000, form.nbytes))
        self._crc32 = np.zeros(frames, dtype=np.uint32)
        self._status_ns = 0
        self.marks = Marks()

    def run(self) -> Marks:
        """Send the sweep; returns when it is sealed and its results are on disk."""
        marks = self.marks
        self._lane.begin(self._start)
        self._until(self._both_are_ready, READY_S, "writer and worker")
        marks.begin_ns, before = _now_ns(), self._cpu_s()
        for frame_index in range(self._frames):
            while self._window.may_trigger_through() < frame_index:
                self._turn(100)
            self._send(frame_index)
            self._turn(0)
        marks.sent_ns = _now_ns()
        self._until(lambda: not self._lane.unacked, RUN_S, "all commits")
        marks.committed_ns = _now_ns()
        end = End(
            scan_uid=self._start.scan_uid,
            outcome=Outcome.COMPLETE,
            expected=self._frames,
            sent=self._frames,
            digest=scan_digest(self._crc32),
        )
        self._lane.finish(end)
        self._live.send(end)
        self._until(lambda: marks.end_ack is not None and marks.result_end is not None, RUN_S, "the end")
        marks.cpu_s = {name: now - before[name] for name, now in self._cpu_s().items()}
        self._check(end.digest)
        self._read_report()
        return marks

    def _read_report(self) -> None:
        """Where the worker's frames came from, and what it spent its time on."""
        assert self.marks.result_end is not None
        report = msgspec.json.decode(Path(self.marks.result_end.report_path).read_bytes())
        self.marks.counts = {name: int(report["counts"][name]) for name in ("from_live", "from_file", "refolded")}
        for stage, seconds in report["processor_s"].items():
            what = {"estimate_early": "ahead"}.get(stage, "fold" if stage.startswith("fold") else "results")
            self.marks.worker_s[what] = self.marks.worker_s.get(what, 0.0) + seconds

    def _cpu_s(self) -> dict[str, float]:
        """Processor time of each process so far, in s."""
        return {name: cpu_seconds(pid) for name, pid in self._pids.items()}

    def _both_are_ready(self) -> bool:
        # a PUB socket does not report its subscribers: send until the worker answers
        if self.marks.progress is None:
            self._live.send(self._start)
        return self._lane.ready and self.marks.progress is not None

    def _send(self, frame_index: int) -> None:
        pixels = self._ring[frame_index * len(self._ring) // self._frames]
        self._crc32[frame_index] = crc32 = frame_crc32(pixels)
        image = Image(
            scan_uid=self._start.scan_uid,
            frame_index=frame_index,
            trigger_id=frame_index,
            camera_frame_id=frame_index,
            position_steps=frame_index,
            position_um=frame_index * 3.175,
            exposure_start_ns=_now_ns(),
            shape=list(pixels.shape),
            dtype="|u1",
            crc32=crc32,
        )
        part = shared(pixels)
        self._window.publish(image)
        self._lane.offer(image, part)
        self.marks.live_unsent += not self._live.send(image, part)
        self.preview.keep(PreviewFrame(pixels, image.position_steps, image.position_um, 0.0, frame_index))

    def _until(self, fact: Callable[[], bool], deadline_s: float, what: str) -> None:
        end_ns = _now_ns() + round(deadline_s * NS_PER_S)
        while not fact():
            if _now_ns() > end_ns:
                raise NoServiceError(f"the benchmark gave up: {what} not within {deadline_s:g} s; nothing is kept")
            self._turn(50)

    def _turn(self, patience_ms: int) -> None:
        if patience_ms:
            self._poller.poll(patience_ms)
        now_ns = _now_ns()
        for event in self._lane.poll(now_ns):
            if isinstance(event, Committed):
                self._window.commit(event.frames)
            elif isinstance(event, Sealed):
                self.marks.end_ack, self.marks.sealed_ns = event.end_ack, now_ns
        self.preview.poll()
        begin_ns = _now_ns()
        self.preview.flush(now_ns, self._start.format, MOST_IN_A_SWEEP_HZ)
        self.marks.pictures_ns += _now_ns() - begin_ns
        if self._looks is not None:
            receive(self._looks)
        while (received := receive(self._results)) is not None:
            self._take_result(received.message, now_ns)
        if now_ns >= self._status_ns:
            self._status_ns = now_ns + STATUS_NS
            self._status.send(self._status_now())

    def _take_result(self, message: Any, now_ns: int) -> None:
        marks = self.marks
        if message.scan_uid != self._start.scan_uid:
            return
        if isinstance(message, ResultProgress):
            marks.progress = message
            if message.folded_through == self._frames - 1 and not marks.folded_ns:
                marks.folded_ns = now_ns
        elif isinstance(message, ResultEnd) and marks.result_end is None:
            marks.result_end, marks.results_ns = message, message.sent_mono_ns
            # progress is published only ten times a second; the end has the time since the last frame was folded
            folded_ns = message.sent_mono_ns - round(message.seconds * NS_PER_S)
            marks.folded_ns = min(marks.folded_ns or folded_ns, folded_ns)

    def _status_now(self) -> Status:
        ack = self.marks.end_ack
        return Status(
            scan_uid=self._start.scan_uid,
            state=State.SWEEPING if ack is None else State.IDLE,
            scan_path=self._start.path,
            plan=self._start.plan,
            format=self._start.format,
            outcome=Outcome.RUNNING if ack is None else ack.outcome,
            expected=self._frames,
            committed=self._window.prefix,
        )

    def _check(self, digest: str) -> None:
        ack, result = self.marks.end_ack, self.marks.result_end
        assert ack is not None and result is not None
        if not (ack.sealed and ack.committed == self._frames and ack.digest == digest):
            raise SweepscopeError(f"frames were lost: {ack.committed} of {self._frames} committed; {ack.reason}")
        if result.folded_through != self._frames - 1:
            raise SweepscopeError(f"frames were lost: folded through {result.folded_through} of {self._frames - 1}")


def cpu_seconds(pid: int) -> float:
    """Processor time of a process so far, user and system, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _now_ns() -> int:
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)
