"""The faults screen: every fault of this session, what is safe, what to do, and whether it was acknowledged."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding

from acquire.contract.faults import headline
from tui.console.link.rig_view import RigView
from tui.console.screens.base import RigScreenBase
from tui.console.shell import Shell
from tui.console.state.fault_log import LoggedFault
from tui.console.widgets.lines import Pane
from tui.console.widgets.rows import RowList, Rows
from tui.text.width import shorten


class FaultDetail(Pane[LoggedFault | None]):
    """One fault in full."""

    BORDER_TITLE = "the chosen fault"
    DEFAULT_CSS = "FaultDetail { height: 9; }"

    def text_for(self, width: int) -> Text:
        """What happened, what is safe, what to do, when, acknowledged or not."""
        fault = self.shown
        if fault is None:
            return Text()
        report = fault.report
        text = Text(no_wrap=True)
        for label, words, style in (
            ("happened", headline(report), "bold"),
            ("safe", report.safe, ""),
            ("to do", report.to_do, "bold"),
            ("when", fault.at + ("" if fault.current else "; the daemon no longer reports it"), "dim"),
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
        Binding("A", "acknowledge_all", "acknowledge all", id="faults.all", tooltip="acknowledge every fault"),
        Binding("c", "copy", "copy", id="faults.copy", tooltip="the chosen fault as text to the clipboard"),
        Binding("C", "copy_all", "copy all", id="faults.copy_all", tooltip="all faults as text to the clipboard"),
    ]

    def __init__(self, shell: Shell) -> None:
        super().__init__(shell)
        self._list = RowList(empty="no fault in this session")
        self._detail = FaultDetail(None)
        self._faults: list[LoggedFault] = []

    def body(self) -> ComposeResult:
        """The list and the chosen fault."""
        yield self._list
        yield self._detail

    def show(self, view: RigView) -> None:
        """List and detail."""
        self._faults = self.shell.state.faults.faults
        width = max(20, self._list.content_size.width - 32)
        header = Text(f"{'time':<20}{'code':<6}{'':<3}what happened")
        rows = [_row(fault, width) for fault in self._faults]
        self._list.show(Rows(header, rows, [fault.key for fault in self._faults]))
        waiting = sum(not fault.report.acknowledged for fault in self._faults)
        self._list.border_title = f"faults: {len(self._faults)}, {waiting} not acknowledged"
        self.on_row_list_moved()

    def on_row_list_moved(self) -> None:
        """Another fault is chosen."""
        self._detail.show(next((fault for fault in self._faults if fault.key == self._list.chosen), None))

    def why_not(self, action: str) -> str:
        """There must be a fault to do it with."""
        if action == "acknowledge_all":
            waits = any(not fault.report.acknowledged and fault.current for fault in self._faults)
            return "" if waits else "every fault is acknowledged"
        return "" if self._faults or action == "move" else "there is no fault"

    def action_move(self, rows: int) -> None:
        """Choose another fault."""
        self._list.move(rows)

    def action_acknowledge_all(self) -> None:
        """Acknowledge every fault."""
        self.send("acknowledge", code="")

    def action_copy(self) -> None:
        """Copy the chosen fault."""
        self._copy([fault for fault in self._faults if fault.key == self._list.chosen])

    def action_copy_all(self) -> None:
        """Copy all faults."""
        self._copy(self._faults)

    def _copy(self, faults: Sequence[LoggedFault]) -> None:
        self.app.copy_to_clipboard("\n".join(fault.as_text() for fault in faults) + "\n")
        count = "the fault" if len(faults) == 1 else f"{len(faults)} faults"
        self.say(f"{count} copied as text, where the terminal lets programs do that (OSC 52)")


def _row(fault: LoggedFault, width: int) -> Text:
    report = fault.report
    row = Text(f"{fault.at:<20}{report.code:<6}")
    mark, style = ("✓", "green") if report.acknowledged else ("✖", "bold red")
    row.append(f"{mark:<3}", style=style)
    return row.append(shorten(report.happened, width), style="dim" if report.acknowledged else "bold")
