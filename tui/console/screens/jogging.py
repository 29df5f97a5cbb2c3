"""Moves the stage from the keyboard: one bounded move in flight, one waiting; a held key moves under a lease."""

from __future__ import annotations

from acquire.contract.messaging.messages import Status
from acquire.contract.states import State
from tui.console.link.messages import CommandAnswered
from tui.console.link.rig_view import RigView
from tui.console.screens.base import RigScreenBase
from tui.console.state.jog import STEP_SIZES, JogGate, clip, next_size

HOLD_RATE_STEPS_PER_S = 400.0


class Jogging:
    """Keys in, commands out; limits shorten a move and say so."""

    def __init__(self, screen: RigScreenBase) -> None:
        self._screen = screen
        self._gate = JogGate()
        self.fine_steps = STEP_SIZES[1]
        """Size of the fine step in microsteps."""

    @property
    def in_flight(self) -> bool:
        """True while a move of ours is in flight: a press is not sent, it waits."""
        return self._gate.in_flight(self._screen.shell.now_s())

    def press(self, steps: int, status: Status) -> None:
        """``steps`` fine steps in one bounded move; repeats of the keyboard meanwhile are ignored."""
        wanted = steps * self.fine_steps
        if status.position_trusted:
            um_per_microstep = self._screen.shell.state.next_scan.um_per_microstep
            move = clip(status.position_steps, wanted, status.travel_steps, um_per_microstep)
            wanted = move.steps
            if move.words:
                self._screen.say(f"jog: {move.words}", "warning")
        if wanted:
            self._send(self._gate.press(wanted, self._screen.shell.now_s()))

    def hold(self, direction: int) -> None:
        """Renew the lease: a held key repeats."""
        if self._gate.hold(self._screen.shell.now_s()):
            lease = {"direction": direction, "rate_steps_per_s": HOLD_RATE_STEPS_PER_S}
            self._screen.send("jog_hold", self._hold_answered, **lease)

    def resize(self, direction: int) -> None:
        """Another fine step: 1 larger, -1 smaller."""
        self.fine_steps = next_size(self.fine_steps, direction)

    def follow(self, view: RigView) -> None:
        """A status arrived: the waiting move is sent once the stage rests, or dropped after a STOP."""
        status = view.status
        if status is None:
            return
        if view.stop_words:
            self._gate.forget()
        moving, now_s = status.state == State.MOVING, self._screen.shell.now_s()
        self._send(self._gate.take_status(moving=moving, sent_ns=status.sent_mono_ns, now_s=now_s))

    def _send(self, steps: int) -> None:
        if steps:
            self._screen.send("jog", self._answered, steps=steps)

    def _answered(self, answer: CommandAnswered) -> None:
        self._gate.answered(ok=answer.ok, at_ns=answer.at_mono_ns)
        if not answer.ok:
            self._screen.say(f"jog: {answer.detail}", "error")

    def _hold_answered(self, answer: CommandAnswered) -> None:
        if not answer.ok:
            self._screen.say(f"hold: {answer.detail}", "error")
