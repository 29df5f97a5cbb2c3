"""The scan screen: the picture, the stage, the light, and a sweep from its plan to its end."""

from __future__ import annotations

from dataclasses import replace

from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.events import Resize
from textual.timer import Timer

from tui.console.link.messages import CommandAnswered
from tui.console.link.rig_view import RigView
from tui.console.screens import scan_keys
from tui.console.screens.adjust import Adjust, LatestValue
from tui.console.screens.camera_screen import CameraScreen
from tui.console.screens.dialogs import Field, Form
from tui.console.screens.jogging import Jogging
from tui.console.state.estimate import Estimate
from tui.console.state.scan_draft import Draft
from tui.console.state.scan_forms import parse_name, parse_plan, parse_words
from tui.console.widgets.log_tail import LogTail
from tui.console.widgets.picture import MODES
from tui.console.widgets.picture_pane import PicturePane
from tui.console.widgets.scan_panes import LightPane, PlanPane, ProgressPane, StagePane
from tui.text.status_text import is_running, scan_name

TALL = 33
"""From this height on plan and progress are both in view."""
SETTLE_S = 0.3
"""The estimate is asked for when the plan has not changed for so long."""
_SETTINGS = {
    "exposure_ms": ("exposure", "ms", (0.01, 1000.0)),
    "gain": ("gain", "dB", (0.0, 48.0)),
    "brightness_percent": ("black level", "%", (0.0, 100.0)),
}


class ScanScreen(CameraScreen):
    """Prepare a sweep and watch it."""

    NAME = "scan"
    SUMMARY = "Set the light with the specimen under it, set first and last, look at the estimate, start."
    SHOWS_LOG = True
    CHANGES = scan_keys.CHANGES
    IN_PANES = scan_keys.IN_PANES
    BINDINGS = scan_keys.BINDINGS
    DEFAULT_CSS = """
    ScanScreen #left { width: 1fr; height: 100%; }
    ScanScreen #right { width: 44; height: 100%; }
    ScanScreen.wide #right { width: 54; }
    ScanScreen #log { height: 5; }
    ScanScreen.tall #log { height: 8; }
    ScanScreen.running.short PlanPane { display: none; }
    ScanScreen.resting.short ProgressPane { display: none; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(ascii_only=ascii_only)
        self._picture = PicturePane(mode="half", ascii_only=ascii_only)
        self._stage = StagePane(self.key_of, ascii_only=ascii_only)
        self._light = LightPane(self.key_of, ascii_only=ascii_only)
        self._plan = PlanPane(self.key_of, ascii_only=ascii_only)
        self._progress = ProgressPane(self.key_of, ascii_only=ascii_only)
        self._log = LogTail(ascii_only=ascii_only)
        self._jogging = Jogging(self)
        self._settling: Timer | None = None
        self._estimated: tuple[Draft, float | None] | None = None

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

    def on_mount(self) -> None:
        """The picture as this console was told to draw it."""
        self._picture.live.set_mode(self.shell.options.picture)

    def on_resize(self, event: Resize) -> None:
        """Choose the layout."""
        super().on_resize(event)
        self.set_class(event.size.height >= TALL, "tall")
        self.set_class(event.size.height < TALL, "short")

    def why_not(self, action: str) -> str:
        """A jog that the daemon would refuse because of our own move may be pressed: it waits for the move's end."""
        return "" if action == "jog" and self._jogging.in_flight else super().why_not(action)

    # ---- news ----

    def show(self, view: RigView) -> None:
        """Hand the newest values to the panes."""
        running = is_running(view.status)
        self.set_class(running, "running")
        self.set_class(not running, "resting")
        self._stage.fine_steps, self._plan.draft = self._jogging.fine_steps, self.shell.draft
        self._progress.note(view, self.shell.now_s())
        for pane in (self._stage, self._light, self._plan, self._progress):
            pane.show(view)
        self._log.show(self.shell.logbook)
        self._show_picture(view)
        self._jogging.follow(view)
        self._estimate_when_settled(view)

    def _show_picture(self, view: RigView) -> None:
        meter = self.shell.meter
        if self._picture.offer(
            view, meter.governor.detail, may_paint=meter.may_send_picture(), now_s=self.shell.now_s()
        ):
            self.call_after_refresh(self.shell.ask_terminal)

    def key_of(self, action: str) -> tuple[str, bool]:
        """The key of an action and whether it can be done now."""
        for binding in self.actions():
            if binding.action == action:
                return self.shell.key_words(binding), not self.why_not_now(action)
        return "", False

    # ---- the plan and what it takes ----

    def _change(self, draft: Draft | None) -> None:
        if draft is not None:
            self.shell.draft = draft
            self.show_all(self.view)

    def _estimate_when_settled(self, view: RigView) -> None:
        status = view.status
        if not view.connected or status is None or is_running(status) or not status.position_trusted:
            return
        wanted = (self.shell.draft, status.camera.get("exposure_ms"))
        if wanted == self._estimated:
            return
        self._estimated = wanted
        self._plan.estimate = Estimate()
        if self._settling is not None:
            self._settling.stop()
        self._settling = self.set_timer(SETTLE_S, self._ask_estimate)

    def _ask_estimate(self) -> None:
        draft = self.shell.draft

        def take(answer: CommandAnswered) -> None:
            if draft == self.shell.draft:
                self._plan.estimate = Estimate.of_answer(ok=answer.ok, detail=answer.detail, result=answer.result)
                self._plan.changed()

        self.send("estimate", take, **draft.scan_args())

    def action_set_first(self) -> None:
        """First position from where the stage is."""
        assert self.view.status is not None
        self._change(replace(self.shell.draft, first_steps=self.view.status.position_steps))

    def action_set_last(self) -> None:
        """Last position from where the stage is."""
        assert self.view.status is not None
        self._change(replace(self.shell.draft, last_steps=self.view.status.position_steps))

    def action_plan(self) -> None:
        """Type the plan."""
        draft, status = self.shell.draft, self.view.status
        travel = status.travel_steps if status is not None else (0, 0)
        fields = [
            Field("first", "first", str(draft.first_steps), help="microsteps, or um (5010um), or mm (5.01mm)"),
            Field("last", "last", str(draft.last_steps), help="below first sweeps the other way"),
            Field("steps", "steps per frame", str(draft.steps_per_frame)),
            Field("settle", "settle ms", f"{draft.settle_ms:g}"),
            Field("mode", "mode", draft.mode, help="step stops for each frame, fly triggers at constant speed"),
        ]
        self.shell.push_screen(Form("plan", fields, lambda texts: parse_plan(texts, draft, travel)), self._change)

    def action_mode(self) -> None:
        """Step or fly."""
        self._change(replace(self.shell.draft, mode="step" if self.shell.draft.mode == "fly" else "fly"))

    def action_words(self) -> None:
        """Name, specimen, operator, notes, tags."""
        draft = self.shell.draft
        fields = [
            Field("name", "name", draft.name),
            Field("specimen", "specimen", draft.specimen, words=True),
            Field("operator", "operator", draft.operator, words=True),
            Field("notes", "notes", draft.notes, words=True),
            Field("tags", "tags", " ".join(draft.tags), words=True, help="separated by spaces or commas"),
        ]
        self.shell.push_screen(Form("what is scanned", fields, lambda texts: parse_words(texts, draft)), self._change)

    def action_prescan(self) -> None:
        """A quick look that proposes the bounds."""
        self.send("prescan")

    def action_use_proposal(self) -> None:
        """Take over bounds and exposure of the pre-scan."""
        status = self.view.status
        if status is None or status.proposal is None:
            return
        self._change(self.shell.draft.with_proposal(status.proposal))
        if not self.why_not_now("adjust") and status.camera.get("exposure_ms") != status.proposal.exposure_ms:
            self.send("camera", exposure_ms=status.proposal.exposure_ms)

    # ---- the sweep ----

    def action_start(self) -> None:
        """Ask for a name and start a sweep."""
        draft, status = self.shell.draft, self.view.status
        previous = scan_name(status).partition("-")[2] if status is not None else ""
        name = draft.name if draft.name != Draft.name or not previous else previous

        def start(chosen: str | None) -> None:
            if chosen is not None:
                self.shell.draft = replace(self.shell.draft, name=chosen)
                self.send("scan", **self.shell.draft.scan_args())

        estimate = self._plan.estimate
        lines = [estimate.words(draft), *(f"! {words}" for words in estimate.warnings)]
        if estimate.refused:
            lines.append(f"! it would be refused: {estimate.refused}")
        fields = [Field("name", "name", name)]
        form = Form("start a sweep", fields, lambda texts: parse_name(texts["name"]), done="starts it", lines=lines)
        self.shell.push_screen(form, start)

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
        setter = LatestValue(self, setting)
        self.shell.push_screen(Adjust(title, unit, value, limits, setter.set))

    def action_picture(self) -> None:
        """The next way to draw the picture."""
        mode = MODES[(MODES.index(self._picture.live.mode) + 1) % len(MODES)]
        self._picture.live.set_mode(mode)
        self.say(f"picture: {'half blocks' if mode == 'half' else 'characters' if mode == 'mono' else 'off'}")

    # ---- the stage ----

    def action_jog(self, steps: int) -> None:
        """One bounded move."""
        assert self.view.status is not None
        self._jogging.press(steps, self.view.status)

    def action_hold(self, direction: int) -> None:
        """Move on while the key is held."""
        self._jogging.hold(direction)

    def action_size(self, direction: int) -> None:
        """Another fine step."""
        self._jogging.resize(direction)
        self.show_all(self.view)

    def action_home(self) -> None:
        """Find the zero."""
        self.send("home")

    def action_zero(self) -> None:
        """Make this position the zero."""
        self.send("zero")
