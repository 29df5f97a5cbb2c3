"""Interactive check of the stage's wiring: makes small moves, asks the operator, and reports each result."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass

from acquire.stages.uno.stage import UnoStage
from acquire.stages.uno.wire_format import Flag

from .protocol import Alarm, Moved, Segment, SegmentDone, StageEvent, StageInfo, Stopped

DISTANCE_STEPS = 100
_SHOTS = 3
_MOTION_S = 20.0
_PERSON_S = 60.0
_LOOK_S = 0.05


@dataclass(frozen=True)
class WiringResult:
    """Result of one check."""

    wire: str
    good: bool
    saw: str


class StageCheck:
    """One round of checks. ``say`` prints a line, ``ask`` puts a yes-or-no question."""

    def __init__(
        self,
        stage: UnoStage,
        say: Callable[[str], None],
        ask: Callable[[str], bool],
        *,
        person_s: float = _PERSON_S,
    ) -> None:
        self._stage, self._say, self._ask, self._person_s = stage, say, ask, person_s
        self._events: queue.Queue[StageEvent] = queue.Queue()

    def run(self) -> list[WiringResult]:
        """Check serial line, switches, motor, lamp, trigger and strobe, in this order; the stage is closed at the end.

        What needs motion is left out while a switch reads as pressed, what needs a moving stage where it does not move.

        The position is not trusted afterwards: zero lies where the stage stood.

        Raises:
            SweepscopeError: the port cannot be opened, or the controller stops answering.
        """
        info = self._stage.open(self._events.put)
        try:
            findings = [self._line(info), *self._switches()]
            if self._stage.report.flags & (Flag.LIMIT | Flag.ESTOP):
                self._say("the rest is left out: nothing may move while a switch reads as pressed")
                return findings
            findings.append(self._motor())
            return [*findings, self._lamp(), *self._trigger()] if findings[-1].good else findings
        finally:
            self._stage.close()

    def _note(self, wire: str, good: bool, saw: str) -> WiringResult:
        self._say(f"{'ok  ' if good else 'BAD '} {wire}: {saw}")
        return WiringResult(wire, good, saw)

    def _line(self, info: StageInfo) -> WiringResult:
        return self._note("USB", True, f"firmware {info.version}, boot {info.boot_id}")

    def _switches(self) -> list[WiringResult]:
        return [
            self._switch("D4 LIMIT", Flag.LIMIT, "the limit switch"),
            self._switch("D3 ESTOP", Flag.ESTOP, "the emergency stop"),
        ]

    def _switch(self, wire: str, flag: Flag, name: str) -> WiringResult:
        if self._stage.report.flags & flag:
            return self._note(wire, False, f"{name} reads as pressed: released, wired, normally closed to GND?")
        self._say(f"press {name} and hold it, within {self._person_s:.0f} s")
        if not self._until(lambda: bool(self._stage.report.flags & flag), self._person_s):
            return self._note(wire, False, f"nothing came of {name}")
        self._say(f"release {name}")
        released = self._until(lambda: not self._stage.report.flags & flag, self._person_s)
        return self._note(wire, released, "pressed and released" if released else "it stays pressed")

    def _motor(self) -> WiringResult:
        wire = "D9 STEP, D7 DIR, D6 ENABLE"
        self._stage.zero_here()
        if not self._rest():
            return self._note(wire, False, "the controller does not come to rest")
        self._say(f"the stage moves {DISTANCE_STEPS} microsteps away from the limit switch, and back")
        for target_steps in (DISTANCE_STEPS, 0):
            self._stage.move_to(target_steps)
            if not self._rest():
                return self._note(wire, False, "the move did not end; did it run into a switch?")
        good = self._ask("did it move away from the limit switch first, and come back?")
        return self._note(wire, good, "moved" if good else "turned the wrong way or not at all: motor, DIR, supply?")

    def _lamp(self) -> WiringResult:
        self._stage.set_lamp(on=True)
        lit = self._ask("is the lamp lit?")
        self._stage.set_lamp(on=False)
        dark = self._ask("is it dark again?")
        return self._note("D5 LAMP", lit and dark, "on and off" if lit and dark else "it does not follow")

    def _trigger(self) -> list[WiringResult]:
        before = self._stage.report.triggers, self._stage.strobes
        self._say(f"{_SHOTS} triggers go to the camera: it must wait for hardware triggers")
        self._stage.begin_segment(Segment(0, 1, _SHOTS, settle_ms=100.0, dwell_ms=200.0), _SHOTS - 1)
        done = self._rest()
        fired, strobes = self._stage.report.triggers - before[0], self._stage.strobes - before[1]
        return [
            self._note("D10 TRIGGER", done and fired == _SHOTS, f"{fired} of {_SHOTS} fired"),
            self._note("D8 STROBE", strobes == _SHOTS, f"the camera answered {strobes} of {_SHOTS} times"),
        ]

    def _rest(self) -> bool:
        """Wait for the end of a motion; False after an alarm or a time-out."""
        deadline_s = time.monotonic() + _MOTION_S
        while time.monotonic() < deadline_s:
            self._stage.keep_alive()
            try:
                event = self._events.get(timeout=_LOOK_S)
            except queue.Empty:
                continue
            if isinstance(event, (Moved, SegmentDone)):
                return True
            if isinstance(event, (Alarm, Stopped)):
                return False
        return False

    def _until(self, wanted: Callable[[], bool], timeout_s: float) -> bool:
        deadline_s = time.monotonic() + timeout_s
        while not wanted():
            if time.monotonic() > deadline_s:
                return False
            self._stage.keep_alive()
            time.sleep(_LOOK_S)
        return True
