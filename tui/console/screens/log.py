"""The log screen: all lines of this session, filtered by level and text."""

from __future__ import annotations

from collections.abc import Iterable

from textual.app import ComposeResult
from textual.binding import Binding

from tui.console.link.rig_view import RigView
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import FormDialog, FormField
from tui.console.shell import Shell
from tui.console.state.session_log import LogLine
from tui.console.widgets.log_pane import LogPane

LEVELS = (("all", ("info", "warning", "error")), ("warnings and errors", ("warning", "error")), ("errors", ("error",)))


def filtered(lines: Iterable[LogLine], level: int, text: str) -> list[LogLine]:
    """The lines of the levels ``LEVELS[level]`` that contain every word of ``text``."""
    levels, words = LEVELS[level][1], text.lower().split()
    return [line for line in lines if line.level in levels and all(word in line.text.lower() for word in words)]


class LogScreen(RigScreenBase):
    """Every line of this session."""

    NAME = "log"
    SUMMARY = "What the services themselves write is in the journal: 'sweepscope logs'."
    SHOWS_LOG = True
    BINDINGS = [
        Binding("up", "scroll_rows(1)", "back", show=False),
        Binding("down", "scroll_rows(-1)", "forward", show=False),
        Binding("pageup", "scroll_page(1)", "back", id="log.back", tooltip="a page back"),
        Binding("pagedown", "scroll_page(-1)", "forward", id="log.further", tooltip="a page towards the newest"),
        Binding("end", "follow", "newest", id="log.follow", tooltip="the newest line, and follow"),
        Binding("l", "level", "level", id="log.level", tooltip="all, warnings and errors, errors only"),
        Binding("slash", "search", "filter", id="log.filter", tooltip="only lines that contain these words"),
        Binding("escape", "clear", "no filter", id="log.clear", tooltip="show all lines again"),
        Binding("c", "copy", "copy", id="log.copy", tooltip="the lines in the filter to the clipboard"),
    ]

    def __init__(self, shell: Shell) -> None:
        super().__init__(shell)
        self._log = LogPane(())
        self._level, self._text = 0, ""

    def body(self) -> ComposeResult:
        """One pane."""
        yield self._log

    @property
    def _lines(self) -> list[LogLine]:
        return filtered(self.shell.state.log.lines, self._level, self._text)

    def show(self, view: RigView) -> None:
        """The lines in the filter."""
        log, lines = self.shell.state.log, self._lines
        dropped = log.count - len(log.lines)
        title = f"log: {LEVELS[self._level][0]}" + (f", with '{self._text}'" if self._text else "")
        title += f"  {len(lines)} of {log.count} lines" + (f", the oldest {dropped} dropped" if dropped else "")
        self._log.border_title = title + ("" if not self._log.back else "  (scrolled back: End follows)")
        self._log.show(lines)

    def why_not(self, action: str) -> str:
        """What would change nothing is not offered."""
        if action == "clear" and not self._text and not self._level:
            return "nothing is hidden"
        return "it follows already" if action == "follow" and not self._log.back else ""

    def action_scroll_rows(self, rows: int) -> None:
        """Scroll."""
        self._log.scroll_rows(rows)
        self.show_all(self.view)

    def action_scroll_page(self, direction: int) -> None:
        """Scroll by a page."""
        self.action_scroll_rows(direction * max(1, self._log.content_size.height - 1))

    def action_follow(self) -> None:
        """To the newest line."""
        self.action_scroll_rows(-self._log.back)

    def action_level(self) -> None:
        """The next level."""
        self._set((self._level + 1) % len(LEVELS), self._text)

    def action_search(self) -> None:
        """Ask for words."""
        field = FormField("text", "words", self._text)
        form = FormDialog("filter", [field], lambda texts: texts["text"])
        self.ask(form, lambda text: self._set(self._level, text))

    def action_clear(self) -> None:
        """Show all lines."""
        self._set(0, "")

    def _set(self, level: int, text: str) -> None:
        self._level, self._text, self._log.back = level, text, 0
        self.show_all(self.view)

    def action_copy(self) -> None:
        """Copy the lines in the filter."""
        lines = self._lines
        self.app.copy_to_clipboard("".join(f"{line.at} {line.level}: {line.text}\n" for line in lines))
        self.say(f"{len(lines)} lines copied as text, where the terminal lets programs do that (OSC 52)")
