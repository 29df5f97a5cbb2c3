"""Base class of stages whose segments run in the host: one activity at a time, in a thread that can be stopped.

Implements the thread, credit, holds and stops. A subclass implements single moves and triggers.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError

from .protocol import Held, Moved, StageEvent, StageSink

_LOOK_S = 1.0
_JOIN_S = 5.0


class StopRequestedError(Exception):
    """Raised in the stage's thread to unwind the running activity."""


class HostDrivenStage:
    """Runs one activity after another; a stop takes effect at each wait."""

    def __init__(self, config: StageConfig, name: str) -> None:
        """``name`` is that of the thread."""
        self._config = config
        self._name = name
        self._sink: StageSink = lambda _event: None
        self._changed = threading.Condition()
        self._activity: Callable[[], None] | None = None
        self._thread: threading.Thread | None = None
        self._position = self._triggers = 0
        self._granted = -1
        self._holding = self._stopping = self._closing = False

    # ---- protocol ----

    def check_limit(self) -> None:
        """Touch the limit switch again, if there is one."""
        self._start(self._touch)

    def grant(self, may_trigger_through: int) -> None:
        """Raise the absolute credit."""
        with self._changed:
            self._granted = max(self._granted, may_trigger_through)
            self._changed.notify_all()

    def hold(self) -> None:
        """Hold before the next trigger."""
        with self._changed:
            self._holding = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Continue after a hold."""
        with self._changed:
            self._holding = False
            self._changed.notify_all()

    def stop(self) -> None:
        """End the activity; nothing happens when there is none."""
        with self._changed:
            self._stopping = self._activity is not None
            self._changed.notify_all()

    # ---- for subclasses to implement ----

    def _touch(self) -> None:
        raise NotImplementedError

    def _ended_early(self, error: OSError | None) -> StageEvent:
        """The event for an activity that was stopped, or whose device failed with ``error``."""
        raise NotImplementedError

    def _moved(self, steps_lost: int | None = None) -> Moved:
        """The event for a motion that ended."""
        raise NotImplementedError

    # ---- the thread ----

    def _begin_serving(self, sink: StageSink) -> None:
        self._sink = sink
        self._closing = False
        self._thread = threading.Thread(target=self._serve, name=self._name, daemon=True)
        self._thread.start()

    def _end_serving(self) -> None:
        with self._changed:
            self._closing = self._stopping = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(timeout=_JOIN_S)
            self._thread = None

    def _start(self, activity: Callable[[], None]) -> None:
        with self._changed:
            if self._thread is None:
                raise CommandRefusedError("the stage is not open")
            if self._activity is not None:
                raise CommandRefusedError("the stage is moving: wait for it, or stop it")
            self._holding = self._stopping = False
            self._activity = activity
            self._changed.notify_all()

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._activity is not None)
                activity = self._activity
            if self._closing or activity is None:
                return
            try:
                activity()
            except StopRequestedError:
                self._end_with(self._ended_early(None))
            except OSError as error:
                self._end_with(self._ended_early(error))

    def _end_with(self, event: StageEvent) -> None:
        """Become idle before the end is reported, because the receiver may start the next activity at once."""
        with self._changed:
            self._activity = None
            self._stopping = False
        self._sink(event)

    # ---- for activities ----

    def _has_credit(self, shot_index: int) -> bool:
        return not self._holding and self._granted >= shot_index

    def _wait_for_credit(self, shot_index: int, *, tell_no_credit: bool = False) -> None:
        """Wait for credit and for the end of a hold; a requested hold is reported once."""
        with self._changed:
            told = False
            while not self._stopping and not self._has_credit(shot_index):
                if not told and (self._holding or tell_no_credit):
                    told = True
                    self._sink(Held("requested" if self._holding else "no credit", self._position))
                self._changed.wait(timeout=_LOOK_S)
        self._raise_if_stopped()

    def _wait(self, duration_s: float) -> None:
        """Wait; raises StopRequestedError on a stop."""
        if duration_s > 0:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping, timeout=duration_s)
        self._raise_if_stopped()

    def _raise_if_stopped(self) -> None:
        if self._stopping:
            raise StopRequestedError

    def _check_travel(self, position_steps: int) -> None:
        low, high = self._config.travel_min_steps, self._config.travel_max_steps
        if not low <= position_steps <= high:
            raise CommandRefusedError(f"{position_steps} microsteps is outside the travel {low}..{high}")

    def _run_up_from(self, first_steps: int, pitch_steps: int, run_up_steps: int) -> int:
        """Where the approach of ``first_steps`` begins: outside, as far as the travel goes."""
        direction = 1 if pitch_steps >= 0 else -1
        low, high = self._config.travel_min_steps, self._config.travel_max_steps
        return min(max(first_steps - direction * run_up_steps, low), high)
