"""The panes of the calibrate screen: what to do next with its coverage map, and what came of it."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.text import Text

from tui.console.calibration.texts import Verdict
from tui.console.widgets.lines import Lines
from tui.text.width import shorten

_SHADES = (" ", "░", "▒", "▓", "█")
_ASCII_SHADES = (" ", ".", "+", "#", "@")


@dataclass(frozen=True)
class GuideView:
    """What the guide pane shows."""

    goal: str = ""
    board: str = ""
    live: str = ""
    """What the camera sees now, in words."""
    facts: dict[str, Any] = field(default_factory=dict)
    """The newest object of ``sweepscope calibrate watch``."""
    verdict: Verdict | None = None
    hint: str = ""


class GuidePane(Lines):
    """Goal, coverage, advice, views; after the fit its verdict."""

    DEFAULT_CSS = """
    GuidePane { height: 1fr; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="guide", ascii_only=ascii_only)
        self._guide = GuideView()

    def show(self, guide: GuideView) -> None:
        """Take the newest values."""
        self._guide = guide
        self.changed()

    def text_for(self, width: int) -> Text:
        """From the goal downwards, as much as there is room for."""
        guide, text = self._guide, Text(no_wrap=True)
        self._say(text, guide.goal, width, "bold")
        self._say(text, guide.board, width, "dim")
        if guide.verdict is not None:
            self._verdict(text, guide.verdict, width)
        self._say(text, guide.live, width, "")
        advice = [str(words) for words in guide.facts.get("advice") or []]
        if guide.facts and guide.verdict is None:
            text.append_text(self._coverage(guide.facts.get("coverage") or []))
            for number, words in enumerate(advice[:3], 1):
                self._say(text, f"{number}. {words}", width, "bold" if number == 1 else "")
            if not advice:
                self._say(text, "there is enough: g calibrates", width, "bold green")
        self._say(text, guide.hint, width, "dim")
        for view in reversed(guide.facts.get("views") or []):
            if guide.verdict is None:
                mark = "" if view.get("found") else "NO BOARD: "
                text.append(
                    shorten(f"{str(view.get('name')).removesuffix('.png')} {mark}{view.get('words')}", width) + "\n",
                    style="dim",
                )
        text.right_crop(1)
        return text

    def _say(self, text: Text, words: str, width: int, style: str) -> None:
        for line in textwrap.wrap(words, max(16, width)):
            text.append(line + "\n", style=style)

    def _verdict(self, text: Text, verdict: Verdict, width: int) -> None:
        self._say(text, verdict.headline, width, "bold green" if verdict.passed else "bold red")
        for line in verdict.lines:
            self._say(text, line, width, "")

    def _coverage(self, coverage: Sequence[Sequence[int]]) -> Text:
        """The picture's field, each cell with how many views have corners there."""
        shades = _ASCII_SHADES if self.ascii_only else _SHADES
        text = Text()
        for number, row in enumerate(coverage):
            text.append("covered " if number == 0 else "        ", style="dim")
            for count in row:
                shade = shades[min(int(count), 8) * 4 // 8 if count else 0]
                text.append(f"[{shade * 2}{int(count):>2}]", style="" if count else "bold yellow")
            text.append("\n")
        return text
