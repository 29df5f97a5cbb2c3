"""Runs the preview and one activity at a time while no scan runs. A scan ends both, and never waits for them.

The daemon's loop hands over every device event while no scan runs, and calls :meth:`ActivityRunner.tick` at each turn.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import msgspec

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.config.model import RigConfig
from acquire.contract.errors import SweepscopeError
from acquire.contract.faults import report
from acquire.contract.messaging.messages import Proposal
from acquire.contract.states import TRANSITIONS, State
from acquire.contract.units import NS_PER_S, ns_from_ms, steps_to_um
from acquire.rigs.base import DeviceEvent, Rig
from acquire.rigs.status_board import StatusBoard
from acquire.stages.protocol import Alarm, Moved, SegmentDone, Stopped

from .base import Activity, Rest
from .images import PreviewFrame
from .preview_publisher import PreviewPublisher

DEFAULT_RATE_HZ: Final = 5.0
_MOVING = (State.MOVING, State.HOMING)


class ActivityStatus(msgspec.Struct, frozen=True):
    """What the status message shows of the runner; the fields bear the names that they have there."""

    activity: str
    """Name of the activity, or ``preview``; empty while nothing runs."""
    activity_share: float
    """How far the activity is, 0..1."""
    proposal: Proposal | None


class ActivityRunner:
    """Preview and activities. One thread calls everything."""

    def __init__(self, rig: Rig, config: RigConfig, board: StatusBoard, preview: PreviewPublisher) -> None:
        self._rig, self._config, self._board, self._preview = rig, config, board, preview
        self.rate_hz = DEFAULT_RATE_HZ
        """Of the preview."""
        self.activity: Activity | None = None
        self.counters = {"pictures_late": 0, "pictures_damaged": 0, "activities_done": 0, "activities_failed": 0}
        self._preview_on = False
        self._proposal: Proposal | None = None
        self._next_ns = 0
        self.owed_until_ns = 0
        """A picture was asked for and may come until then; 0: none was."""
        self._asker: Activity | None = None
        """The activity that asked for it; None: the preview."""
        self._asked = (0, 0.0)
        """Position in microsteps and exposure in ms when it was asked for."""
        self._next_wanted = False
        """An activity waits for its own picture until the one before has come."""
        self._scan_began_ns = 0

    def status(self) -> ActivityStatus:
        """What runs now."""
        if self.activity is not None:
            return ActivityStatus(self.activity.name, self.activity.share, self._proposal)
        return ActivityStatus("preview" if self._preview_on else "", 0.0, self._proposal)

    # ---- for commands ----

    def set_preview(self, *, on: bool, rate_hz: float) -> None:
        """Pictures on or off; moves go on meanwhile."""
        self._preview_on, self.rate_hz = on, rate_hz
        if self._board.state in (State.IDLE, State.PREVIEW):
            self._settle()

    def run(self, activity: Activity, now_ns: int) -> None:
        """Begin an activity; one that cannot begin raises and leaves nothing behind.

        Raises:
            SweepscopeError: a device refuses.
        """
        self.activity = activity
        try:
            activity.begin(now_ns)
        except SweepscopeError:
            self.activity = None
            raise
        self._settle()

    def moving(self, state: State) -> None:
        """The stage was told to move (or to home)."""
        self._go(state)

    def propose(self, proposal: Proposal) -> None:
        """Show what a pre-scan proposes until the next scan begins."""
        self._proposal = proposal

    def stop(self) -> None:
        """End the activity; the caller stops the stage. The preview goes on: it moves nothing."""
        if self.activity is not None:
            self._give_up(self.activity, "stopped")
            self._finish()

    def end_for_scan(self, now_ns: int) -> None:
        """A scan begins: the preview ends, and a picture that is still on its way does not belong to the scan."""
        self._preview_on, self._proposal = False, None
        self._scan_began_ns = now_ns

    # ---- for the daemon's loop ----

    def is_stale(self, event: DeviceEvent, now_ns: int) -> bool:
        """True for a picture that is still owed to the preview when it arrives during a scan; it is dropped, once."""
        if not isinstance(event, CameraFrame):
            return False
        in_time, self.owed_until_ns = now_ns < self.owed_until_ns, 0
        # a frame whose exposure began after the scan did belongs to the scan: the picture before it was lost
        return in_time and event.exposure_start_ns < self._scan_began_ns

    def take(self, event: DeviceEvent, now_ns: int) -> None:
        """A device event while no scan runs."""
        if isinstance(event, CameraFrame):
            self._take_frame(event, now_ns)
        elif isinstance(event, CameraGone):
            self.owed_until_ns = 0
            if not event.back:
                self._board.fault(report("F18", detail=event.detail, committed=0, expected=0))
            else:
                self._board.say("the camera is back")
        elif isinstance(event, Alarm):
            self._alarm(event)
        elif isinstance(event, (Moved, Stopped, SegmentDone)):
            self._take_rest(event, now_ns)

    def tick(self, now_ns: int) -> None:
        """Ask for the next picture when it is due; let the activity look at the time."""
        if self.owed_until_ns and now_ns > self.owed_until_ns:
            self.owed_until_ns = 0
            self.counters["pictures_late"] += 1
            self._tell_asker(lambda activity: activity.on_no_frame(now_ns), now_ns)
        self._tell(lambda activity: activity.on_tick(now_ns))
        if self._wants_picture(now_ns):
            self._next_ns = now_ns + round(NS_PER_S / self.rate_hz)
            try:
                self.snap(now_ns)
            except SweepscopeError as error:
                self._preview_on = False
                self._settle()
                self._board.say(f"the preview ended: {error}")

    # ---- for activities ----

    def snap(self, now_ns: int) -> None:
        """Take one picture as soon as the last one has come; the activity and the preview's subscribers get it."""
        if self.owed_until_ns:
            self._next_wanted = True
            return
        self._next_wanted = False
        self._asker = self.activity if self.activity is not None and self.activity.snaps else None
        self._asked = self._rig.stage.status().position_steps, self._rig.camera_settings.exposure_ms
        longest_ms = self._rig.camera_settings.exposure_ms * max(1.0, self._config.simulation.time_scale)
        self.owed_until_ns = now_ns + ns_from_ms(longest_ms + self._config.camera.frame_timeout_ms)
        self._rig.camera.snap()

    # ---- pictures ----

    def _wants_picture(self, now_ns: int) -> bool:
        busy = self.activity is not None and self.activity.snaps
        due = now_ns >= self._next_ns and not self.owed_until_ns
        return self._preview_on and due and not busy and self._preview.watched

    def _take_frame(self, frame: CameraFrame, now_ns: int) -> None:
        if not self.owed_until_ns:
            return
        self.owed_until_ns = 0
        if self._rig.camera_info.format.mismatch(frame.pixels):
            self.counters["pictures_damaged"] += 1
            self._tell_asker(lambda activity: activity.on_no_frame(now_ns), now_ns)
            return
        position, exposure_ms = self._asked
        um = steps_to_um(position, self._config.stage.um_per_microstep)
        self._preview.show(PreviewFrame(frame.pixels, position, um, exposure_ms), self._rig.camera_info.format)
        self._tell_asker(lambda activity: activity.on_frame(frame, now_ns), now_ns)

    def _tell_asker(self, what: Callable[[Activity], None], now_ns: int) -> None:
        """Tell the activity about the picture that it asked for, then ask for the next one."""
        if self._asker is not None and self._asker is self.activity:
            self._tell(what)
        if self._next_wanted:
            self._next_wanted = False
            self._tell(lambda _activity: self.snap(now_ns))

    def _take_rest(self, event: Rest, now_ns: int) -> None:
        self._tell(lambda activity: activity.on_rest(event, now_ns))
        if self._board.state in _MOVING:
            self._settle(resting=True)

    def _alarm(self, event: Alarm) -> None:
        self._board.fault(report(event.code, detail=event.detail, committed=0, expected=0))
        if self.activity is not None:
            self.activity.end(event.detail, failed=True)
            self._finish()
        self._preview_on = False
        self._board.enter(State.FAULT)

    def _tell(self, what: Callable[[Activity], None]) -> None:
        """Let the activity act; it may end by that, or by a device that refuses."""
        activity = self.activity
        if activity is None:
            return
        try:
            what(activity)
        except SweepscopeError as error:
            self._give_up(activity, str(error))
            self._rig.stage.stop()
        if activity.ended:
            self._finish()

    @staticmethod
    def _give_up(activity: Activity, text: str) -> None:
        """End an activity and undo its changes; a device that refuses the undoing is named in its last message."""
        activity.end(text, failed=True)
        try:
            activity.cancel()
        except SweepscopeError as error:
            activity.end(f"{text}; and it is not as it was before: {error}", failed=True)

    def _finish(self) -> None:
        activity, self.activity, self._next_wanted = self.activity, None, False
        assert activity is not None
        self.counters["activities_failed" if activity.failed else "activities_done"] += 1
        self._board.say(f"{activity.name}: {activity.ended}")
        self._settle()

    def _settle(self, *, resting: bool = False) -> None:
        """Enter the state that belongs to what runs now, once the stage rests."""
        if self._board.state is State.FAULT:
            return
        if self.activity is not None:
            self._go(State.MOVING if self.activity.moves else State.PREVIEW)
        elif resting or self._board.state not in _MOVING or not self._rig.stage.status().moving:
            self._go(State.PREVIEW if self._preview_on else State.IDLE)

    def _go(self, state: State) -> None:
        """Change the state, by way of IDLE where the table has no direct transition."""
        current = self._board.state
        if state is not current and state not in TRANSITIONS[current]:
            self._board.enter(State.IDLE)
        self._board.enter(state)
