"""The state of the rig, its faults, and the last message, as shown to the operator."""

from __future__ import annotations

import logging
from typing import Final

import msgspec

from acquire.contract.faults import in_one_line
from acquire.contract.messaging.messages import FaultReport
from acquire.contract.process.clocks import Clock
from acquire.contract.states import State, transition

logger = logging.getLogger(__name__)
MAX_FAULTS: Final = 32
"""Reports that are kept; the oldest go first."""


class StatusBoard:
    """One thread calls everything."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.state = State.DISCONNECTED
        self.message = ""
        self.faults: list[FaultReport] = []
        self.scan = ""
        """Folder name of the scan that runs; faults are reported as of this scan."""
        self.changed = True
        """Something that the status message shows has changed since it was published."""

    def published(self) -> None:
        """The status message was published."""
        self.changed = False

    def touch(self) -> None:
        """Something else has changed that the status message shows."""
        self.changed = True

    def enter(self, state: State) -> None:
        """Change the state by the table of transitions."""
        if state is not self.state:
            self.state = transition(self.state, state)
            self.changed = True

    def close(self) -> None:
        """The devices are disconnected, in whatever state the rig was."""
        self.state = State.DISCONNECTED
        self.changed = True

    def say(self, text: str) -> None:
        """Show a line, and log it."""
        logger.info(text)
        self.message = text
        self.changed = True

    def fault(self, fault: FaultReport) -> None:
        """Show a fault until it is acknowledged; the same fault again replaces its older report."""
        same = [other for other in self.faults if (other.code, other.happened) == (fault.code, fault.happened)]
        if all(other.acknowledged for other in same):
            # logged once: a disk that fails reports it for each frame that waits
            logger.error(in_one_line(fault))
        kept = [other for other in self.faults if other not in same]
        known = msgspec.structs.replace(fault, at_mono_ns=self._clock.now_ns(), scan=fault.scan or self.scan)
        self.faults = [*kept, known][-MAX_FAULTS:]
        self.message = in_one_line(fault)
        self.changed = True

    def acknowledge(self, code: str) -> int:
        """Mark faults as seen (all, where ``code`` is empty); returns how many.

        A rig in FAULT becomes IDLE when all have been seen: whether the stage is still in alarm, it knows itself.
        """
        seen = [fault for fault in self.faults if not fault.acknowledged and code in ("", fault.code)]
        self.faults = [msgspec.structs.replace(f, acknowledged=True) if f in seen else f for f in self.faults]
        if self.state is State.FAULT and all(fault.acknowledged for fault in self.faults):
            self.enter(State.IDLE)
        self.changed = True
        return len(seen)

    def begin_scan(self, scan: str) -> None:
        """A scan begins: what was acknowledged goes, and what was reported of this scan before it is resumed."""
        self.scan = scan
        self.faults = [fault for fault in self.faults if not fault.acknowledged and fault.scan != scan]
        self.message = ""

    def end_scan(self) -> None:
        """It is over: faults that follow are not of this scan."""
        self.scan = ""
