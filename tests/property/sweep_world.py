"""A random stage, camera, writer and operator around one sweep, for sequences of events that nobody thought of."""

from __future__ import annotations

import random
from collections import deque
from typing import Any

import numpy as np

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.messaging.messages import AckItem, End, EndAck, FrameFormat, Image, Nack
from acquire.contract.states import Outcome
from acquire.stages.protocol import Alarm, Held, Moved, Segment, SegmentDone, Stopped, Triggered
from acquire.sweep import actions as do
from acquire.sweep.checks.overlap import OverlapLimits
from acquire.sweep.events import (
    Committed,
    PauseRequested,
    Refused,
    ResumeRequested,
    Sealed,
    StopRequested,
    Tick,
    WriterReady,
)
from acquire.sweep.phases import Phase
from acquire.sweep.settings import ResumeFrom, SweepSettings
from acquire.sweep.state_machine import Sweep
from tests.unit.sweep_bench import MS, settings

FORMAT = FrameFormat(width=16, height=12, bit_depth=8)
SCENE = np.kron(np.random.default_rng(1).integers(20, 180, (6, 8)), np.ones((2, 2))).astype(np.float64)
CALM_AFTER = 120
"""Steps after which nothing goes wrong any more."""
MOST_STEPS = 600
MISHAPS = {
    "camera gone": 1.0,
    "alarm": 0.3,
    "hold": 1.0,
    "stop": 0.5,
    "refusal": 0.3,
    "stopped": 0.2,
    "wrong trigger": 0.1,
    "writer back": 0.5,
    "dead stage": 0.3,
    "light": 1.0,
    "frame": 1.0,
    "long wait": 0.3,
    "no seal": 1.0,
}
"""How often each goes wrong, relative to the others."""
AMBUSHED = (Phase.OVERLAP, Phase.OVERLAP, Phase.RUN, Phase.RUN, Phase.REPEAT, Phase.LIMIT)
AMBUSHES = ("camera gone", "camera gone", "alarm", "stop", "dead stage")


class SweepWorld:
    """Runs one sweep, seeded. The first steps are as wild as the seed wants, the later ones calm."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.wild = self.random.choice([0.0, 0.01, 0.03, 0.1])
        self.ambush = (self.random.choice(AMBUSHED), self.random.choice(AMBUSHES))
        """This goes wrong in this phase when everything else has come, before the stage rests."""
        self.slow_stage = self.random.random() < 0.5
        """The end of a segment takes its time, so that other things happen before it."""
        self.comes_back = self.random.choice([0.02, 0.7])
        """How soon a camera that went away is back."""
        self.now_ns = 10**12
        self.steps = 0
        self.file: dict[int, int] = {}
        """crc32 of each frame that the writer has in its file."""
        self.end: End | None = None
        """The end of a sweep that has had a writer."""
        self.published: list[Image] = []
        self.segment: Segment | None = None
        self.stops = 0
        made = self._settings()
        self.sweep = Sweep(made, self.random.choice([2, 3, 8, 100]))
        self.host_clock = self.random.random() < 0.7
        self._stage: deque[Any] = deque()
        self._camera: deque[Any] = deque()
        self._writer: deque[Any] = deque([self._ready(came_back=False)] if self.random.random() > 0.03 else [])
        self._shot, self._granted, self._held, self._dead = 0, -1, False, False
        self._camera_id, self._triggers, self._light = 7, 0, 1.0
        self._away = self._lamp = False
        self._bad_seal = self.random.random() < 0.1
        self.sweep.start(self.now_ns)

    def run(self) -> None:
        """Until the sweep is done, or it is certain that it will never be."""
        while self.sweep.phase is not Phase.DONE and self.steps < MOST_STEPS:
            self.steps += 1
            self.now_ns += self.random.choice([0, 1, 5]) * MS
            if self.steps > MOST_STEPS - 20:
                self.now_ns += 10**12
            self.feed(self._mishap() or self._next())

    def feed(self, event: Any) -> None:
        """One event, and its actions."""
        for action in self.sweep.handle(event, self.now_ns):
            self._do(action)

    def _settings(self) -> SweepSettings:
        pick, count = self.random.choice, self.random.choice([1, 2, 3, 5, 9])
        past = None
        if self.random.random() < 0.35:
            last = self.random.randrange(count)
            kept = [k for k in range(count) if k <= last or self.random.random() < 0.2]
            self.file = {k: 1000 + k for k in kept}
            stored = np.roll(SCENE, pick([0, 0, 0, 4]), axis=1).astype(np.uint8)
            past = ResumeFrom(last, stored, None, SCENE.astype(np.uint8), OverlapLimits())
        plan = settings(count).plan
        return settings(
            count,
            plan=type(plan)(
                **{name: getattr(plan, name) for name in plan.__struct_fields__} | {"mode": pick(["step", "fly"])}
            ),
            format=FORMAT,
            resume=past,
            max_attempts=pick([1, 3, 5]),
            dark_frames=pick([True, False]),
            repeat_first=pick([True, False]),
            check_limit=pick([True, False]),
            needs_confirmation=pick([True, False]),
            warm_up_ns=pick([0, 20]) * MS,
            camera_away_ns=pick([0, 100, 5000]) * MS,
        )

    # ---- what goes wrong ----

    def _happens(self, what: str) -> bool:
        if self.ambush == (self.sweep.phase, what) and self._only_the_end_is_missing():
            self.ambush = (Phase.DONE, "")
            return True
        return self.steps < CALM_AFTER and self.random.random() < self.wild * MISHAPS[what]

    def _mishap(self) -> Any:
        if self._away and (self.steps >= CALM_AFTER or self.random.random() < self.comes_back):
            self._away = False
            return CameraGone("", back=True)
        if self._happens("camera gone") and not self._away:
            self._away = True
            self._camera.clear()
            return CameraGone("pulled")
        if self._happens("alarm"):
            self.segment = None
            return Alarm(self.random.choice(["F12", "F23"]), "alarm", 0, position_trusted=False)
        if self._happens("hold"):
            return self.random.choice([PauseRequested(), ResumeRequested(), Held("lease", 0), Held("link lost", 0)])
        if self._happens("stop") or self.steps == MOST_STEPS - 60:
            return StopRequested(self.random.choice([Outcome.STOPPED, Outcome.ABORTED]), "stopped")
        if self._happens("refusal"):
            return Refused(Nack(reason=self.random.choice(["no space", "crc", "busy", "immutable"]), frame_index=0))
        if self._happens("stopped") and self.segment is not None and not self._stage:
            self.segment = None
            return Stopped(0, position_trusted=True)
        if self._happens("wrong trigger"):
            return Triggered(99, 3, 999)
        if self._happens("writer back"):
            return self._ready(came_back=True)
        if self._happens("dead stage"):
            self._dead, self.segment = True, None
        if self._happens("light"):
            self._light = self.random.choice([0.6, 1.0])
        return ResumeRequested() if self.sweep.paused and self.steps > CALM_AFTER else None

    # ---- what comes next ----

    def _next(self) -> Any:
        can_fire = self.segment is not None and not self._held and self._shot <= self._granted
        if can_fire and self.random.random() < 0.7:
            self._fire()
        triggers_wait = any(isinstance(event, Triggered) for event in self._stage)
        queues = [queue for queue in (self._writer, [] if triggers_wait else self._camera) if queue]
        if self._stage and (triggers_wait or not self.slow_stage or not queues):
            queues.append(self._stage)
        if queues and self.random.random() < (0.2 if self.slow_stage and self._only_the_end_is_missing() else 0.8):
            return self.random.choice(queues).popleft()
        self.now_ns += self.random.choice([1, 10, 60]) * MS
        if self._happens("long wait"):
            self.now_ns += 6000 * MS
        return Tick(self.now_ns)

    def _only_the_end_is_missing(self) -> bool:
        return bool(self._stage) and not isinstance(self._stage[0], Triggered) and not self._camera and not self._writer

    def _fire(self) -> None:
        assert self.segment is not None
        position = self.segment.first_steps + self._shot * self.segment.pitch_steps
        self._stage.append(
            Triggered(self._triggers, self._shot, position, at_mono_ns=self.now_ns, fired_ns=self.now_ns)
        )
        self._triggers += 1
        self._expose()
        self._shot += 1
        if self._shot == self.segment.count:
            self.segment = None
            self._stage.append(SegmentDone(position))

    def _expose(self) -> None:
        fate = self.random.choice(["lost", "unseen", "shape", "twice"]) if self._happens("frame") else ""
        if self._away or fate == "unseen":
            return
        self._camera_id += 1
        pixels = (SCENE * (self._light if self._lamp else 0.05)).astype(np.uint8)[:, : 15 if fate == "shape" else 16]
        start_ns, camera_ns = (self.now_ns, 0) if self.host_clock else (0, self.now_ns + 77 * MS)
        frame = CameraFrame(np.ascontiguousarray(pixels), self._camera_id, start_ns, camera_ns)
        self._camera.extend([frame] * {"lost": 0, "twice": 2}.get(fate, 1))

    def _ready(self, *, came_back: bool) -> WriterReady:
        held = tuple(AckItem(k, 0, crc32) for k, crc32 in self.file.items())
        return WriterReady(reserved=self.random.random() < 0.9, came_back=came_back, committed=held)

    # ---- what the sweep wants done ----

    def _do(self, action: do.Action) -> None:  # noqa: C901, PLR0912
        match action:
            case do.SetLamp(on):
                self._lamp = on
            case do.Snap():
                self._expose()
            case do.BeginSegment(segment, through):
                assert self.segment is None, "a segment was begun while another runs"
                if not self._dead:
                    self.segment, self._shot, self._granted, self._held = segment, 0, through, False
            case do.Grant(through):
                assert through > self._granted, "credit never shrinks"
                self._granted = through
            case do.HoldStage():
                self._held = True
            case do.ResumeStage():
                self._held = False
            case do.StopStage():
                self.stops += 1
                # an idle stage does not answer: the end of its segment is on the way
                self._stage.extend([] if self.segment is None else [Stopped(0, position_trusted=True)])
                self.segment = None
            case do.CheckLimit():
                self._stage.extend([] if self._dead else [Moved(0, position_trusted=True, steps_lost=0)])
            case do.Publish(image, _pixels):
                self.published.append(image)
                if image.role == "sweep" and image.frame_index in self.file:
                    return
                if image.role == "sweep":
                    self.file[image.frame_index] = image.crc32
                item = AckItem(image.frame_index, image.attempt, image.crc32, image.role)
                self._writer.append(Committed((item,), 0))
            case do.SendEnd(end):
                self.end = end if self.sweep.has_writer else None
                sealed = end.outcome is not Outcome.INTERRUPTED and not self._bad_seal
                ack = EndAck(path="x", sealed=sealed, outcome=end.outcome, committed=0, reason="damaged")
                self._writer.extend([] if self._happens("no seal") else [Sealed(ack)])
