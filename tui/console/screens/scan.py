"""The scan screen: the picture, the stage, the light, and a sweep from its plan to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.events import Resize
from textual.timer import Timer

from tui.console.link.messages import CommandAnswered
from tui.console.link.rig_view import RigView
from tui.console.screens.base import action_name
from tui.console.screens.camera_screen import CameraScreen
from tui.console.screens.dialogs import Confirm
from tui.console.screens.jogging import Jogging
from tui.console.screens.scan_dialogs import (
    AdjustDialog,
    LatestValue,
    plan_dialog,
    start_dialog,
    start_lines,
    words_dialog,
)
from tui.console.shell import Shell
from tui.console.state.estimate import Estimate
from tui.console.state.jog import FAST_FACTOR
from tui.console.state.next_scan import NextScan
from tui.console.widgets.log_pane import LogPane
from tui.console.widgets.picture import MODES
from tui.console.widgets.picture_pane import PicturePane
from tui.console.widgets.scan_panes import LightPane, PlanPane, ProgressPane, StagePane
from tui.text.status_text import is_running

TALL = 33
"""From this height on plan and progress are both in view."""
SETTLE_S = 0.3
"""The estimate is requested when the plan has not changed for so long."""
MAX_UNDO = 50
"""Changes of the plan that can be taken back."""
_SETTINGS = {
    "exposure_ms": ("exposure", "ms", (0.01, 1000.0)),
    "gain": ("gain", "dB", (0.0, 48.0)),
    "brightness_percent": ("black level", "%", (0.0, 100.0)),
}
_MODE_WORDS = {"half": "half blocks", "mono": "characters", "off": "off"}
_ON_KEY_LINE = [
    Binding("s", "start", "start", id="scan.start", tooltip="start the sweep (asks for its name)"),
    Binding("p", "pause", "pause", id="scan.pause", tooltip="the stage holds, nothing is lost"),
    Binding("r", "resume", "resume", id="scan.resume", tooltip="go on with a paused sweep"),
    Binding("V", "picture", "picture", id="scan.picture", tooltip="half blocks, characters, or no picture"),
]
_IN_PANES = [
    Binding("v", "preview", "preview", id="scan.preview", tooltip="camera pictures without a sweep, on or off"),
    Binding("L", "lamp", "lamp", id="scan.lamp", tooltip="lamp on or off"),
    Binding("x", "expose", "expose", id="scan.expose", tooltip="search the exposure, light over the specimen"),
    Binding("e", "adjust('exposure_ms')", "exposure", id="scan.exposure", tooltip="change the exposure"),
    Binding("g", "adjust('gain')", "gain", id="scan.gain", tooltip="change the gain"),
    Binding("b", "adjust('brightness_percent')", "black", id="scan.black", tooltip="change the black level"),
    Binding("comma,left", "jog(-1)", "jog back", id="scan.jog_back", tooltip="one fine step back"),
    Binding("full_stop,right", "jog(1)", "jog on", id="scan.jog_on", tooltip="one fine step forward"),
    Binding(
        "less_than_sign,shift+left", f"jog(-{FAST_FACTOR})", "fast back", id="scan.fast_back", tooltip="ten steps back"
    ),
    Binding(
        "greater_than_sign,shift+right", f"jog({FAST_FACTOR})", "fast on", id="scan.fast_on", tooltip="ten forward"
    ),
    Binding("j", "hold(-1)", "hold back", id="scan.hold_back", tooltip="move back while the key is held"),
    Binding("k", "hold(1)", "hold on", id="scan.hold_on", tooltip="move forward while the key is held"),
    Binding("left_square_bracket", "size(-1)", "finer", id="scan.finer", tooltip="smaller fine step"),
    Binding("right_square_bracket", "size(1)", "coarser", id="scan.coarser", tooltip="larger fine step"),
    Binding("h", "home", "home", id="scan.home", tooltip="find the zero of the stage"),
    Binding("z", "zero", "zero", id="scan.zero", tooltip="make this position the zero"),
    Binding("t", "goto", "go to", id="scan.goto", tooltip="move to a position"),
    Binding("f", "set_first", "first", id="scan.first", tooltip="first position: where the stage is"),
    Binding("l", "set_last", "last", id="scan.last", tooltip="last position: where the stage is"),
    Binding("n", "plan", "plan", id="scan.plan", tooltip="type first, last, steps per frame, settle, mode"),
    Binding("m", "mode", "mode", id="scan.mode", tooltip="stop for each frame, or trigger on the fly"),
    Binding("w", "prescan", "pre-scan", id="scan.prescan", tooltip="a coarse sweep that proposes the bounds"),
    Binding("U", "undo", "undo", id="scan.undo", tooltip="take back the last change of the plan"),
    Binding("u", "use_proposal", "use it", id="scan.use_proposal", tooltip="use the proposal of the pre-scan"),
    Binding("i", "words", "name", id="scan.words", tooltip="name, specimen, operator, notes, tags"),
]


class ScanScreen(CameraScreen):
    """Prepare a sweep and watch it."""

    NAME = "scan"
    SUMMARY = "Set the light with the specimen under it, set first and last, look at the estimate, start."
    SHOWS_LOG = True
    CHANGES = CameraScreen.OF_CAMERA | {
        *("start", "pause", "resume", "adjust", "jog", "hold", "home", "zero", "prescan", "use_proposal")
    }
    IN_PANES = frozenset(str(binding.id) for binding in _IN_PANES)
    BINDINGS = [*_ON_KEY_LINE, *_IN_PANES]
    DEFAULT_CSS = """
    ScanScreen #left { width: 1fr; height: 100%; }
    ScanScreen #right { width: 44; height: 100%; }
    ScanScreen.wide #right { width: 54; }
    ScanScreen LogPane { height: 5; }
    ScanScreen.tall LogPane { height: 8; }
    ScanScreen.running.short PlanPane { display: none; }
    ScanScreen.resting.short ProgressPane { display: none; }
    """

    def __init__(self, shell: Shell) -> None:
        super().__init__(shell)
        self._picture = PicturePane(mode=shell.options.picture)
        self._stage, self._light = StagePane(self.key_of), LightPane(self.key_of)
        self._plan, self._progress = PlanPane(self.key_of), ProgressPane(self.key_of)
        self._log = LogPane(())
        self._jogging = Jogging(self)
        self._settling: Timer | None = None
        self._estimated: tuple[NextScan, float | None] | None = None
        self._earlier: list[NextScan] = []

    def body(self) -> ComposeResult:
        """Picture and log on the left, the panes on the right."""
        with Horizontal():
            with Vertical(id="left"):
                yield self._picture
                yield self._log
            with Vertical(id="right"):
                yield self._stage
                yield self._light
                yield self._plan
                yield self._progress

    def on_resize(self, event: Resize) -> None:
        """Choose the layout."""
        super().on_resize(event)
        self.set_class(event.size.height >= TALL, "tall")
        self.set_class(event.size.height < TALL, "short")

    # ---- what is shown ----

    def show(self, view: RigView) -> None:
        """Hand the newest values to the panes."""
        running = is_running(view.status)
        self.set_class(running, "running")
        self.set_class(not running, "resting")
        self._stage.fine_steps, self._plan.next_scan = self._jogging.fine_steps, self.next_scan
        self._progress.note(view, self.shell.now_s())
        for pane in (self._stage, self._light, self._plan, self._progress):
            pane.show(view)
        self._log.show(list(self.shell.state.log.lines))
        meter = self.shell.meter
        if self._picture.offer(view, meter.rate.detail, may_paint=meter.may_send_picture(), now_s=self.shell.now_s()):
            self.call_after_refresh(self.shell.ask_terminal)
        self._jogging.follow(view)
        self._estimate_when_settled(view)

    def key_of(self, action: str) -> tuple[str, bool]:
        """The key of an action and whether it can be done now."""
        binding = next(binding for binding in self.own_bindings if binding.action == action)
        if not self.check_action(action_name(action), ()):
            return "", False
        return self.shell.key_label(binding), not self.why_not_now(action)

    def why_not(self, action: str) -> str:
        """A jog that would be refused because of our own move may be pressed: it waits for the end of the move."""
        if action == "undo":
            return "" if self._earlier else "nothing to undo"
        return "" if action == "jog" and self._jogging.in_flight else super().why_not(action)

    # ---- the plan and its estimate ----

    def _change(self, scan: NextScan) -> None:
        if scan != self.next_scan:
            self._earlier = [*self._earlier, self.next_scan][-MAX_UNDO:]
        self.shell.state.next_scan = scan
        self.show_all(self.view)

    def action_undo(self) -> None:
        """Take back the last change of the plan."""
        self.shell.state.next_scan = self._earlier.pop()
        self.show_all(self.view)

    def _estimate_when_settled(self, view: RigView) -> None:
        status = view.status
        if not view.connected or status is None or is_running(status) or not status.position_trusted:
            return
        wanted = (self.next_scan, status.camera.get("exposure_ms"))
        if wanted == self._estimated:
            return
        self._estimated = wanted
        self._plan.estimate = Estimate()
        if self._settling is not None:
            self._settling.stop()
        self._settling = self.set_timer(SETTLE_S, self._request_estimate)

    def _request_estimate(self, then: Callable[[], object] = lambda: None) -> None:
        scan = self.next_scan

        def take(answer: CommandAnswered) -> None:
            if scan == self.next_scan:
                self._plan.estimate = Estimate.of_answer(ok=answer.ok, detail=answer.detail, result=answer.result)
                self._plan.changed()
                then()

        self.send("estimate", take, **scan.scan_args())

    def action_set_first(self) -> None:
        """First position: where the stage is."""
        assert self.view.status is not None
        self._change(replace(self.next_scan, first_steps=self.view.status.position_steps))

    def action_set_last(self) -> None:
        """Last position: where the stage is."""
        assert self.view.status is not None
        self._change(replace(self.next_scan, last_steps=self.view.status.position_steps))

    def action_plan(self) -> None:
        """Type the plan."""
        self.ask(plan_dialog(self.next_scan, self.view.status), self._change)

    def action_mode(self) -> None:
        """Step or fly."""
        self._change(replace(self.next_scan, mode="step" if self.next_scan.mode == "fly" else "fly"))

    def action_words(self) -> None:
        """Type name, specimen, operator, notes, tags."""
        self.ask(words_dialog(self.next_scan), self._change)

    def action_prescan(self) -> None:
        """A coarse sweep that proposes the bounds."""
        self.send("prescan")

    def action_use_proposal(self) -> None:
        """Use the bounds and the exposure that the pre-scan proposes."""
        status = self.view.status
        if status is None or status.proposal is None:
            return
        self._change(self.next_scan.with_proposal(status.proposal))
        if not self.why_not_now("adjust") and status.camera.get("exposure_ms") != status.proposal.exposure_ms:
            self.send("camera", exposure_ms=status.proposal.exposure_ms)

    # ---- the sweep ----

    def action_start(self) -> None:
        """Ask what is scanned and start a sweep."""

        def start(scan: NextScan) -> None:
            self._change(scan)
            self.send("scan", **self.next_scan.scan_args())

        dialog = start_dialog(self.next_scan, self._plan.estimate, self.view.status)
        self.ask(dialog, start)
        # asked anew: meanwhile the disk may have filled
        self._request_estimate(lambda: dialog.show_lines(start_lines(self.next_scan, self._plan.estimate)))

    def action_pause(self) -> None:
        """Hold the sweep."""
        self.send("pause")

    def action_resume(self) -> None:
        """Go on."""
        self.send("resume")

    # ---- light and camera ----

    def action_adjust(self, setting: str) -> None:
        """Change one setting of the camera."""
        status = self.view.status
        assert status is not None
        title, unit, widest = _SETTINGS[setting]
        limits = status.camera_limits.get(setting, widest)
        value = status.camera.get(setting, limits[0])
        self.app.push_screen(AdjustDialog(title, unit, value, limits, LatestValue(self, setting).set))

    def action_picture(self) -> None:
        """The next way to draw the picture."""
        mode = MODES[(MODES.index(self._picture.live.mode) + 1) % len(MODES)]
        self._picture.live.set_mode(mode)
        self.say(f"picture: {_MODE_WORDS[mode]}")

    # ---- the stage ----

    def action_jog(self, steps: int) -> None:
        """One bounded move of so many fine steps."""
        assert self.view.status is not None
        self._jogging.press(steps, self.view.status)

    def action_hold(self, direction: int) -> None:
        """Move while the key is held."""
        self._jogging.hold(direction)

    def action_size(self, direction: int) -> None:
        """Another fine step: 1 larger, -1 smaller."""
        self._jogging.resize(direction)
        self.show_all(self.view)

    def action_home(self) -> None:
        """Find the zero."""
        self.send("home")

    def action_zero(self) -> None:
        """Ask, then make this position the zero."""
        lines = ("Make this position the zero?", "The plan and later scans count from here; this cannot be undone.")
        self.ask(Confirm(lines, "set zero"), lambda _yes: self.send("zero"))
