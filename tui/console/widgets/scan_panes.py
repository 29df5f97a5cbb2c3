"""The panes of the scan screen: stage, light, plan, progress; each value stands beside the key that changes it."""

from __future__ import annotations

import textwrap

from rich.text import Text

from acquire.contract.messaging.messages import Status
from acquire.contract.states import State
from acquire.contract.units import format_duration
from tui.console.link.rig_view import RigView
from tui.console.state.estimate import Estimate
from tui.console.state.jog import FAST_FACTOR
from tui.console.state.next_scan import NextScan
from tui.console.widgets.lines import KeyOf, Pane, append_key
from tui.text.sparkline import History, sparkline
from tui.text.status_text import bar, credit_words, fraction_done, is_running, outcome_line, rate_words, scan_name
from tui.text.width import shorten

NOT_CONNECTED = "not connected"


class ScanPane(Pane[RigView]):
    """A pane of the scan screen; what was last known is dim while the daemon does not answer."""

    def __init__(self, key_of: KeyOf) -> None:
        super().__init__(RigView())
        self._key_of = key_of

    def key(self, text: Text, action: str, words: str, style: str = "") -> Text:
        """Append the key of an action with the value that it changes."""
        return append_key(text, self._key_of, action, words, style)

    def text_for(self, width: int) -> Text:
        """The pane's lines."""
        status = self.shown.status
        if status is None:
            return Text(NOT_CONNECTED, style="dim")
        text = Text(no_wrap=True, style="" if self.shown.connected else "dim")
        self.fill(text, status, width)
        return text

    def show(self, value: RigView) -> None:
        """Take the newest values."""
        words = "" if value.connected or value.status is None else NOT_CONNECTED
        if words != (self.border_subtitle or ""):
            self.border_subtitle = words
        super().show(value)

    def fill(self, text: Text, status: Status, width: int) -> None:
        """Append the lines."""
        raise NotImplementedError


class StagePane(ScanPane):
    """Where the stage is, and how to move it."""

    BORDER_TITLE = "stage"
    DEFAULT_CSS = "StagePane { height: 5; }"
    fine_steps = 3

    def fill(self, text: Text, status: Status, width: int) -> None:
        """Position; steps beside their keys; homing and limits."""
        um = f"{status.position_um:,.1f}".replace(",", " ")
        trust = ("trusted", "green") if status.position_trusted else ("NOT TRUSTED: home", "bold yellow")
        text.append(f"{um} um", style="bold").append(f"  {status.position_steps} microsteps  ")
        text.append(shorten(trust[0], max(4, width - text.cell_len)), style=trust[1]).append("\n")
        self.key(text, "jog(-1)", "").append(" ")
        self.key(text, "jog(1)", f"{self.fine_steps} ")
        self.key(text, "size(-1)", "")
        self.key(text, "size(1)", "  ")
        self.key(text, f"jog(-{FAST_FACTOR})", "").append(" ")
        self.key(text, f"jog({FAST_FACTOR})", f"{self.fine_steps * FAST_FACTOR}  ")
        self.key(text, "hold(-1)", "")
        self.key(text, "hold(1)", "hold\n")
        self.key(text, "home", "home  ")
        self.key(text, "zero", "zero  ")
        self.key(text, "goto", "go to  ")
        low, high = status.travel_steps
        text.append(f"{low}..{high}" if low < high else "", style="dim")


class LightPane(ScanPane):
    """Lamp and camera."""

    BORDER_TITLE = "light"
    DEFAULT_CSS = "LightPane { height: 5; }"

    def fill(self, text: Text, status: Status, width: int) -> None:
        """Lamp with its warm-up; the camera's settings; preview and exposure search."""
        warm = f", warm in {format_duration(status.lamp_warm_s)}" if status.lamp_warm_s > 0 else ""
        style = "yellow" if warm else "bold" if status.lamp_on else ""
        self.key(text, "lamp", f"lamp {'on' if status.lamp_on else 'off'}{warm}  ", style)
        self.key(text, "preview", "preview on\n" if status.activity == "preview" else "preview off\n")
        exposure = status.camera.get("exposure_ms")
        self.key(text, "adjust('exposure_ms')", f"{exposure:.2f} ms  " if exposure is not None else "exposure  ")
        self.key(text, "adjust('gain')", f"{status.camera.get('gain', 0):.1f} dB  ")
        self.key(text, "adjust('brightness_percent')", f"{status.camera.get('brightness_percent', 0):.1f} % black\n")
        if status.activity in ("exposure", "prescan"):
            share = bar(status.activity_share, max(4, width - 20))
            text.append(f"{status.activity} ", style="bold").append(f"{share} {100 * status.activity_share:3.0f} %")
        else:
            locked = is_running(status)
            self.key(text, "expose", "set exposure once" if not locked else "exposure locked during the sweep")


class PlanPane(ScanPane):
    """The sweep that is being prepared."""

    BORDER_TITLE = "plan"
    DEFAULT_CSS = "PlanPane { height: 9; }"
    next_scan = NextScan()
    estimate = Estimate()

    def fill(self, text: Text, status: Status, width: int) -> None:
        """Name, bounds, steps, estimate, the proposal of a pre-scan, the worst warning or the last outcome."""
        scan = self.next_scan
        about = "  ".join(part for part in (scan.specimen, scan.operator, " ".join(scan.tags)) if part)
        self.key(text, "words", "").append(shorten(scan.name, width - 2), style="bold")
        text.append(shorten(f"  {about}", max(0, width - 2 - len(scan.name))), style="dim").append("\n")
        self.key(text, "set_first", f"first {scan.first_steps:6} {scan.um(scan.first_steps):9.1f} um\n")
        self.key(text, "set_last", f"last  {scan.last_steps:6} {scan.um(scan.last_steps):9.1f} um\n")
        self.key(text, "plan", f"{scan.steps_per_frame}/frame = {scan.um(scan.steps_per_frame):.1f} um  ")
        self.key(text, "mode", "fly\n" if scan.mode == "fly" else f"step, settle {scan.settle_ms:g} ms\n")
        text.append(shorten(self.estimate.words(scan, width), width), "bold" if self.estimate.known else "")
        text.append("\n")
        self._proposal(text, status)
        text.append("\n")
        warnings = [*self.estimate.warnings, *(status.proposal.warnings if status.proposal else ())]
        worst = self.estimate.refused or next(iter(warnings), "")
        if worst and not is_running(status):
            text.append(shorten(f"! {worst}", width), style="bold yellow")
        else:
            text.append(shorten(outcome_line(status), width), style=outcome_style(status))

    def _proposal(self, text: Text, status: Status) -> None:
        found = status.proposal
        if found is None:
            self.key(text, "prescan", "pre-scan finds the bounds", "dim")
            return
        words = f"take {found.first_steps}..{found.last_steps}, {found.exposure_ms:.1f} ms"
        self.key(text, "use_proposal", words, "bold cyan")


class ProgressPane(ScanPane):
    """The running sweep, or the last one."""

    BORDER_TITLE = "progress"
    DEFAULT_CSS = "ProgressPane { height: 9; }"

    def __init__(self, key_of: KeyOf) -> None:
        super().__init__(key_of)
        self.rates = History()
        self._scan_uid = ""

    def note(self, view: RigView, now_s: float) -> None:
        """Record the rate for the sparkline, also while the pane is hidden."""
        status = view.status
        if status is None:
            return
        if status.scan_uid != self._scan_uid:
            self._scan_uid = status.scan_uid
            self.rates.clear()
        if view.connected and status.state in (State.SWEEPING, State.HOLDING):
            self.rates.add(status.rate_hz, now_s)

    def fill(self, text: Text, status: Status, width: int) -> None:
        """Bar, remaining time, credit or outcome, how far each process is behind, points, rate over time."""
        if not status.expected:
            text.append("no sweep yet: ", style="dim")
            self.key(text, "start", "starts one", "dim")
            return
        percent = f" {status.committed}/{status.expected} {100 * fraction_done(status):3.0f} %"
        text.append(shorten(scan_name(status), width) + "\n", style="dim")
        text.append(bar(fraction_done(status), max(4, width - len(percent))), style="#4aa3ff")
        text.append(percent + "\n", style="bold")
        if is_running(status):
            text.append(shorten(rate_words(status), width) + "\n")
            text.append(shorten(credit_words(status), width) + "\n")
        else:
            took = f"took {format_duration(status.elapsed_s)}" if status.elapsed_s else ""
            text.append(shorten(outcome_line(status), width) + "\n", style=outcome_style(status)).append(f"{took}\n")
        worker = self.shown.progress
        if worker is not None and worker.failed and worker.scan_uid == status.scan_uid:
            wrapped = textwrap.wrap(f"NO CLOUD: {worker.message}", max(width, 10))
            text.append("\n".join(wrapped[:3]), style="bold red")
            return
        text.append(shorten(self._lags(status), width) + "\n").append(shorten(self._points(), width) + "\n")
        self._last(text, status, width)

    def _lags(self, status: Status) -> str:
        worker = self.shown.progress
        lags = [
            ("camera", status.triggered - status.received),
            ("writer", status.received - status.committed),
            ("disk", status.committed - status.durable),
        ]
        if worker is not None:
            lags.append(("worker", worker.lag_frames))
        return "lag: " + " ".join(f"{name} {max(0, lag)}" for name, lag in lags)

    def _points(self) -> str:
        worker = self.shown.progress
        if worker is None:
            return "worker: no report yet"
        if worker.message:
            return f"worker: {worker.message}"
        provisional = f", {worker.points_provisional} provisional" if worker.points_provisional else ""
        return f"{worker.points_settled} points{provisional}"

    def _last(self, text: Text, status: Status, width: int) -> None:
        counts = (("retaken", status.retaken), ("missing", status.missing))
        trouble = "".join(f"{name} {count}  " for name, count in counts if count)
        text.append(trouble, style="bold yellow")
        room = width - len("frames/s ") - len(trouble)
        if self.rates.values and room > 4:
            text.append("frames/s ", style="dim").append(sparkline(self.rates.values, room), style="cyan")


def outcome_style(status: Status) -> str:
    """How an outcome looks; its words say the same."""
    return "bold green" if outcome_line(status).startswith("SAVED") else "bold yellow"
