"""The faults screen: every fault of this session, what is safe, what to do, and whether somebody has seen it."""

from __future__ import annotations

import textwrap

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding

from tui.console.link.rig_view import RigView
from tui.console.screens.base import RigScreenBase
from tui.console.state.fault_log import BookedFault
from tui.console.widgets.lines import Lines
from tui.console.widgets.rows import RowList
from tui.text.width import shorten


class FaultDetail(Lines):
    """One fault in full."""

    DEFAULT_CSS = """
    FaultDetail { height: 9; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="fault-detail", ascii_only=ascii_only)
        self.border_title = "the chosen fault"
        self.fault: BookedFault | None = None

    def text_for(self, width: int) -> Text:
        """What happened, what is safe, what to do, when, seen or not."""
        if self.fault is None:
            return Text()
        report = self.fault.report
        text = Text(no_wrap=True)
        for label, words, style in (
            ("happened", f"{report.code}  {report.happened}", "bold"),
            ("safe", report.safe, ""),
            ("to do", report.to_do, "bold"),
            ("when", self.fault.at + ("" if self.fault.still_told else "; the daemon no longer tells of it"), "dim"),
            ("seen", "acknowledged" if report.acknowledged else "NOT ACKNOWLEDGED: a acknowledges", "dim"),
        ):
            lines = textwrap.wrap(words, max(20, width - 10)) or [""]
            text.append(f"{label:<10}", style="dim").append("\n          ".join(lines) + "\n", style=style)
        text.right_crop(1)
        return text


class FaultsScreen(RigScreenBase):
    """All faults; acknowledging one takes it off the banner, never off this list."""

    NAME = "faults"
    SUMMARY = "Every fault of this session stays here, acknowledged or not. The codes are explained in docs/faults.md."
    CHANGES = frozenset({"acknowledge_all"})
    BINDINGS = [
        Binding("up", "move(-1)", "previous", show=False),
        Binding("down", "move(1)", "next", show=False),
        Binding("A", "acknowledge_all", "acknowledge all", id="faults.all", tooltip="every fault has been seen"),
        Binding("c", "copy", "copy", id="faults.copy", tooltip="the chosen fault as text to the clipboard"),
        Binding("C", "copy_all", "copy all", id="faults.copy_all", tooltip="all faults as text to the clipboard"),
    ]

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(ascii_only=ascii_only)
        self._list = RowList(id="faults", ascii_only=ascii_only, empty="no fault in this session")
        self._list.border_title = "faults"
        self._detail = FaultDetail(ascii_only=ascii_only)
        self._faults: list[BookedFault] = []

    def body(self) -> ComposeResult:
        """The list and the chosen one."""
        yield self._list
        yield self._detail

    def show(self, view: RigView) -> None:
        """Take the faults."""
        self._faults = self.shell.fault_book.faults
        width = max(20, self._list.content_size.width - 32)
        header = Text(f"{'time':<20}{'code':<6}{'':<3}what happened")
        rows = [self._row(fault, width) for fault in self._faults]
        self._list.show(header, rows, [fault.key for fault in self._faults])
        waiting = sum(not fault.report.acknowledged for fault in self._faults)
        self._list.border_title = f"faults: {len(self._faults)}, {waiting} not acknowledged"
        self._show_detail()

    def _row(self, fault: BookedFault, width: int) -> Text:
        report = fault.report
        seen, waits = ("v", "X") if self.ascii_only else ("✓", "✖")
        row = Text(f"{fault.at:<20}{report.code:<6}")
        row.append(f"{seen if report.acknowledged else waits:<3}", style="green" if report.acknowledged else "bold red")
        return row.append(shorten(report.happened, width), style="dim" if report.acknowledged else "bold")

    def _show_detail(self) -> None:
        self._detail.fault = next((fault for fault in self._faults if fault.key == self._list.chosen), None)
        self._detail.changed()

    def on_row_list_moved(self) -> None:
        """Another one is chosen."""
        self._show_detail()

    def why_not(self, action: str) -> str:
        """There must be something to do it with."""
        if action == "acknowledge_all":
            waits = any(not fault.report.acknowledged and fault.still_told for fault in self._faults)
            return "" if waits else "every fault is acknowledged"
        return "" if self._faults or action == "move" else "there is no fault"

    def action_move(self, rows: int) -> None:
        """Choose another fault."""
        self._list.move(rows)

    def action_acknowledge_all(self) -> None:
        """All have been seen."""
        self.send("acknowledge", code="")

    def action_copy(self) -> None:
        """The chosen fault as text."""
        if self._detail.fault is not None:
            self._copy([self._detail.fault])

    def action_copy_all(self) -> None:
        """All faults as text."""
        self._copy(self._faults)

    def _copy(self, faults: list[BookedFault]) -> None:
        self.shell.copy_to_clipboard("\n".join(fault.as_text() for fault in faults) + "\n")
        count = "the fault" if len(faults) == 1 else f"{len(faults)} faults"
        self.say(f"{count} copied as text, where the terminal lets programs do that (OSC 52)")
