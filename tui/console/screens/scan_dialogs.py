"""The dialogs of the scan screen: plan, what is scanned, start, and one setting of the camera."""

from __future__ import annotations

from collections.abc import Callable

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.widgets import Input, Static

from acquire.contract.messaging.messages import Status
from tui.console.link.messages import CommandAnswered
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import Dialog, FormDialog, FormField, LineInput
from tui.console.state.estimate import Estimate
from tui.console.state.next_scan import NextScan
from tui.console.state.scan_forms import numbered, parse_number, parse_plan, parse_start, parse_words
from tui.text.status_text import scan_name


def plan_dialog(scan: NextScan, status: Status | None) -> FormDialog:
    """Answers with the scan and its typed plan."""
    travel = status.travel_steps if status is not None else (0, 0)
    fields = [
        FormField("first", "first", str(scan.first_steps), help="microsteps, or um (5010um), or mm (5.01mm)"),
        FormField("last", "last", str(scan.last_steps), help="below first sweeps the other way"),
        FormField("steps", "steps per frame", str(scan.steps_per_frame)),
        FormField("settle", "settle ms", f"{scan.settle_ms:g}"),
        FormField("mode", "mode", scan.mode, help="step stops for each frame, fly triggers at constant speed"),
    ]
    return FormDialog("plan", fields, lambda texts: parse_plan(texts, scan, travel))


def words_dialog(scan: NextScan) -> FormDialog:
    """Answers with the scan and its typed name, specimen, operator, notes and tags."""
    fields = [
        FormField("name", "name", scan.name),
        FormField("specimen", "specimen", scan.specimen),
        FormField("operator", "operator", scan.operator),
        FormField("notes", "notes", scan.notes),
        FormField("tags", "tags", " ".join(scan.tags), help="separated by spaces or commas"),
    ]
    return FormDialog("what is scanned", fields, lambda texts: parse_words(texts, scan))


def start_lines(scan: NextScan, estimate: Estimate) -> list[str]:
    """What the sweep takes, its warnings, and why it would be refused."""
    refused = [f"! it would be refused: {estimate.refused}"] if estimate.refused else []
    return [estimate.words(scan), *(f"! {words}" for words in estimate.warnings), *refused]


def start_dialog(scan: NextScan, estimate: Estimate, status: Status | None) -> FormDialog:
    """Shows what the sweep takes; answers with the scan, its name, specimen and operator as typed.

    The name is by default the scan's own, else that of the last scan, numbered on.
    """
    last_name = scan_name(status).partition("-")[2] if status is not None else ""
    name = scan.name if scan.name not in (NextScan.name, last_name) or not last_name else numbered(last_name)
    fields = [
        FormField("name", "name", name),
        FormField("specimen", "specimen", scan.specimen),
        FormField("operator", "operator", scan.operator),
    ]
    lines = start_lines(scan, estimate)
    return FormDialog("start a sweep", fields, lambda texts: parse_start(texts, scan), done="starts it", lines=lines)


class AdjustDialog(Dialog[None]):
    """One setting of the camera: arrows step it at once, a number sets it; the picture above stays live."""

    BINDINGS = [
        Binding("escape", "leave", "leave"),
        Binding("up", "step(1)", "more", show=False),
        Binding("down", "step(-1)", "less", show=False),
        Binding("pageup", "step(5)", "much more", show=False),
        Binding("pagedown", "step(-5)", "much less", show=False),
    ]
    DEFAULT_CSS = """
    AdjustDialog { align: right bottom; background: $background 0%; }
    AdjustDialog > Vertical { width: 44; margin: 0 0 2 0; }
    """

    def __init__(
        self, title: str, unit: str, value: float, limits: tuple[float, float], apply: Callable[[float], None]
    ) -> None:
        """``apply`` is called with each new value."""
        super().__init__()
        self._title_words, self._unit, self._limits, self._apply = title, unit, limits, apply
        self.value = value

    def compose(self) -> ComposeResult:
        """The number, its limits, what the keys do."""
        with Vertical() as box:
            box.border_title = f"{self._title_words} ({self._unit})"
            yield LineInput(f"{self.value:g}", id="value", select_on_focus=True)
            limits = f"{self._limits[0]:g} to {self._limits[1]:g} {self._unit}"
            yield Static(f"{limits}; Up and Down change it at once", classes="hint", markup=False)
            yield Static("Enter sets it, Escape leaves; SPACE is STOP", classes="hint", id="wrong", markup=False)

    def action_step(self, count: int) -> None:
        """Change the value by a few percent and apply it."""
        low, high = self._limits
        step = max(0.02 * abs(self.value), (high - low) / 1000.0, 0.01)
        self._set(round(min(high, max(low, self.value + count * step)), 3))

    def _set(self, value: float) -> None:
        if value != self.value:
            self.value = value
            self._apply(value)
        field = self.query_one(LineInput)
        field.value = f"{value:g}"
        field.action_select_all()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Set what was typed and leave, or say what is wrong."""
        try:
            self._set(parse_number(event.value, self._title_words, *self._limits))
        except ValueError as error:
            self.query_one("#wrong", Static).update(str(error))
            return
        self.dismiss(None)


class LatestValue:
    """Sends a setting that changes quickly: one command in flight, then the newest value."""

    def __init__(self, screen: RigScreenBase, setting: str) -> None:
        self._screen, self._setting = screen, setting
        self._in_flight = False
        self._next: float | None = None

    def set(self, value: float) -> None:
        """Send the value, or keep it until the last one was answered."""
        if self._in_flight:
            self._next = value
            return
        self._in_flight = True
        self._screen.send("camera", self._answered, **{self._setting: value})

    def _answered(self, answer: CommandAnswered) -> None:
        self._in_flight = False
        if not answer.ok:
            self._next = None
            self._screen.say(f"camera: {answer.detail}", "error")
        elif self._next is not None:
            value, self._next = self._next, None
            self.set(value)
