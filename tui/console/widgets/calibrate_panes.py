"""The guide of the calibrate screen: what to do next, how the views cover the field, and the result."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.text import Text

from tui.console.calibration.results import CalibrationResult
from tui.console.widgets.lines import Pane
from tui.text.width import shorten

_SHADES = " ░▒▓█"


@dataclass(frozen=True)
class GuideView:
    """What the guide shows."""

    goal: str = ""
    board: str = ""
    live: str = ""
    """What the camera sees now, in words."""
    facts: dict[str, Any] = field(default_factory=dict)
    """The newest object of ``sweepscope calibrate watch``."""
    result: CalibrationResult | None = None
    hint: str = ""


class GuidePane(Pane[GuideView]):
    """Goal, coverage, advice, views; after the fit its result."""

    def text_for(self, width: int) -> Text:
        """From the goal downwards, as much as there is room for."""
        guide, width = self.shown, max(16, width)
        lines = [*_wrapped(guide.goal, width, "bold"), *_wrapped(guide.board, width, "dim")]
        if guide.result is not None:
            lines += _wrapped(guide.result.headline, width, "bold green" if guide.result.passed else "bold red")
            for words in guide.result.lines:
                lines += _wrapped(words, width)
        lines += _wrapped(guide.live, width)
        if guide.facts and guide.result is None:
            lines += [*_coverage(guide.facts.get("coverage") or []), *_advice(guide.facts, width)]
        lines += _wrapped(guide.hint, width, "dim")
        if guide.result is None:
            lines += _views(guide.facts, width)
        return Text("\n", no_wrap=True).join(lines)


def _wrapped(words: str, width: int, style: str = "") -> list[Text]:
    return [Text(line, style=style) for line in textwrap.wrap(words, width)]


def _advice(facts: dict[str, Any], width: int) -> Iterator[Text]:
    advice = [str(words) for words in facts.get("advice") or []]
    for number, words in enumerate(advice[:3], 1):
        yield from _wrapped(f"{number}. {words}", width, "bold" if number == 1 else "")
    if not advice:
        yield from _wrapped("enough views: g calibrates", width, "bold green")


def _coverage(coverage: Sequence[Sequence[int]]) -> Iterator[Text]:
    """The field of view; each cell says how many views have corners there."""
    for number, row in enumerate(coverage):
        text = Text("covered " if number == 0 else "        ", style="dim")
        for count in row:
            shade = _SHADES[min(int(count), 8) // 2 if count else 0]
            text.append(f"[{shade * 2}{int(count):>2}]", style="not dim" if count else "not dim bold yellow")
        yield text


def _views(facts: dict[str, Any], width: int) -> Iterator[Text]:
    for view in reversed(facts.get("views") or []):
        mark = "" if view.get("found") else "NO BOARD: "
        words = f"{str(view.get('name')).removesuffix('.png')} {mark}{view.get('words')}"
        yield Text(shorten(words, width), style="dim")
