"""A bench for the pure sweep: a stage, a camera and a writer that answer in zero time, with knobs for faults."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.messaging.messages import AckItem, EndAck, FaultReport, FrameFormat, Image
from acquire.contract.plan import SweepPlan
from acquire.contract.states import Outcome
from acquire.stages.protocol import Held, Moved, Segment, SegmentDone, Stopped, Triggered
from acquire.sweep import actions as do
from acquire.sweep.events import Committed, Sealed, SweepEvent, Tick, WriterReady
from acquire.sweep.phases import Phase
from acquire.sweep.settings import SweepSettings
from acquire.sweep.state_machine import Sweep

MS = 1_000_000
FORMAT = FrameFormat(width=5, height=4, bit_depth=8)


def settings(count: int = 10, **changes: object) -> SweepSettings:
    plan = SweepPlan(
        first_steps=30, last_steps=30 + 3 * (count - 1), steps_per_frame=3, um_per_microstep=3.175, exposure_ms=10
    )
    known = {
        "scan_uid": "u",
        "plan": plan,
        "format": FORMAT,
        "run_up_steps": 10,
        "period_ms": 0,
        "frame_timeout_ns": 100 * MS,
        "max_attempts": 3,
        "writer_start_ns": 5000 * MS,
        "seal_ns": 5000 * MS,
        "motion_ns": 5000 * MS,
        "camera_away_ns": 5000 * MS,
        "check_limit": True,
    }
    return SweepSettings(**(known | changes))


@dataclass
class Bench:
    """Carries out actions at once and feeds back what follows, until nothing follows any more."""

    sweep: Sweep
    now_ns: int = 1_000_000 * MS
    lamp: bool = False
    acking: bool = True
    stage_is_dead: bool = False
    """The stage takes commands and says nothing."""
    tells_time: bool = True
    """Whether the camera says when it exposed."""
    spoil: Callable[[int, int], str] = lambda frame_index, attempt: ""
    """Returns for a shot what goes wrong: ``lose``, ``missed`` (no id used up), ``shape``, ``gone`` (after it)."""
    committed: tuple[AckItem, ...] = ()
    """What the file holds already when the writer is ready."""
    picture: NDArray[np.uint8] | None = None
    """What the camera shows; None: all pixels 1 with the lamp on, else 0."""
    published: list[Image] = field(default_factory=list)
    faults: list[FaultReport] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    triggers: list[tuple[int, int]] = field(default_factory=list)
    """(frame index, position) of every trigger that was fired."""
    unacked: list[Image] = field(default_factory=list)
    """Frames that the writer has not committed yet."""
    end: do.SendEnd | None = None
    sealed: EndAck | None = None
    """What the writer says to the end; None: all is well."""
    stops: int = 0
    """How often the stage was told to stop."""
    _events: deque[SweepEvent] = field(default_factory=deque)
    segment: Segment | None = None
    """The segment that the stage runs."""
    _next_shot: int = 0
    _granted: int = -1
    _held: bool = False
    _camera_id: int = 50
    _tries: dict[int, int] = field(default_factory=dict)

    def feed(self, event: SweepEvent) -> None:
        """Give the sweep an event and all that follows from it."""
        self._events.append(event)
        while self._events:
            for action in self.sweep.handle(self._events.popleft(), self.now_ns):
                self._do(action)
            self._shoot()

    def tick(self, ms: float) -> None:
        """Let time pass."""
        self.now_ns += round(ms * MS)
        self.feed(Tick())

    def start(self) -> None:
        """The writer is ready and the lamp is warm."""
        self.sweep.start(self.now_ns)
        self.feed(WriterReady(reserved=True, came_back=False, committed=self.committed))
        self.tick(1)

    def ack(self, count: int = 1) -> None:
        """The writer commits the frames that have waited longest."""
        acked, self.unacked = self.unacked[:count], self.unacked[count:]
        self.feed(Committed(tuple(ack_of(image) for image in acked), 0))

    def ack_all(self) -> None:
        """The writer commits everything that waits."""
        self.ack(len(self.unacked))

    @property
    def positions(self) -> list[int]:
        return [position for _frame, position in self.triggers]

    def _do(self, action: do.Action) -> None:
        match action:
            case do.SetLamp(on):
                self.lamp = on
            case do.Snap():
                self._deliver(-1)
            case do.BeginSegment(segment, through):
                assert self.segment is None, "a segment was begun while another runs"
                self.segment, self._next_shot, self._granted, self._held = segment, 0, through, False
            case do.Grant(through):
                self._granted = through
            case do.HoldStage():
                self._held = True
                if not self.stage_is_dead:
                    self._events.append(Held("requested", 0))
            case do.ResumeStage():
                self._held = False
            case do.StopStage():
                self.segment = None
                self.stops += 1
                if not self.stage_is_dead:
                    self._events.append(Stopped(0, position_trusted=True))
            case do.CheckLimit():
                self._events.append(Moved(0, position_trusted=True, steps_lost=0))
            case do.Publish(image, _pixels):
                self.published.append(image)
                if self.acking:
                    self._events.append(Committed((ack_of(image),), 0))
                else:
                    self.unacked.append(image)
            case do.SendEnd():
                self.end = action
                sealed = action.end.outcome is not Outcome.INTERRUPTED
                usual = EndAck(path="x", sealed=sealed, outcome=action.end.outcome, committed=0)
                self._events.append(Sealed(self.sealed or usual))
            case do.RaiseFault(fault):
                self.faults.append(fault)
            case do.Say(text):
                self.said.append(text)

    def _shoot(self) -> None:
        segment = self.segment
        if self.stage_is_dead or segment is None or self._held or self._events or self._next_shot > self._granted:
            return
        position = segment.first_steps + self._next_shot * segment.pitch_steps
        plan = self.sweep.settings.plan
        frame_index = (position - plan.first_steps) // plan.pitch_steps
        self.triggers.append((frame_index, position))
        self._events.append(Triggered(len(self.triggers), self._next_shot, position, at_mono_ns=self.now_ns))
        self._deliver(frame_index)
        self._next_shot += 1
        if self._next_shot == segment.count:
            self.segment = None
            self._events.append(SegmentDone(position))

    def _deliver(self, frame_index: int) -> None:
        attempt = self._tries.get(frame_index, 0)
        self._tries[frame_index] = attempt + 1
        how = self.spoil(frame_index, attempt)
        if how == "missed":
            return
        self._camera_id += 1
        if how == "lose":
            return
        shape = (4, 4) if how == "shape" else (4, 5)
        pixels = np.full(shape, self.lamp, np.uint8) if self.picture is None else self.picture.copy()
        self._events.append(CameraFrame(pixels, self._camera_id, self.now_ns if self.tells_time else 0))
        if how == "gone":
            self._events.append(CameraGone("pulled"))


def ack_of(image: Image) -> AckItem:
    return AckItem(image.frame_index, image.attempt, image.crc32, image.role)


def bench(count: int = 10, slots: int = 100, **changes: object) -> Bench:
    """A bench with a fresh sweep."""
    return Bench(Sweep(settings(count, **changes), slots))


def done(on: Bench) -> bool:
    """The sweep has come to its end."""
    return on.sweep.phase is Phase.DONE
