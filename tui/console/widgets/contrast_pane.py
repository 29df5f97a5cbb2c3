"""The contrast threshold as a slider over the histogram of contrasts, with what it leaves; and the value pointed at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from tui.console.pictures.maps import Counts
from tui.console.widgets.lines import Lines
from tui.text.width import shorten

_BLOCKS = " ▁▂▃▄▅▆▇█"
_ASCII_BLOCKS = " .:-=+*#@"


@dataclass(frozen=True)
class ContrastView:
    """Everything that the pane shows."""

    source: str = ""
    """Which maps these are."""
    contrast: int = 70
    """Counts of 8 bit."""
    counts: Counts | None = None
    histogram: tuple[int, ...] = ()
    """Samples by contrast, over 0..255."""
    values: str = ""
    """The values under the cursor."""
    settings: str = ""
    warning: str = ""


class ContrastPane(Lines):
    """Six lines."""

    DEFAULT_CSS = """
    ContrastPane { height: 7; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="contrast", ascii_only=ascii_only)
        self._view = ContrastView()

    def show(self, view: ContrastView) -> None:
        """Take the newest values."""
        self._view = view
        self.border_title = shorten(view.source, max(10, self.size.width - 8)) or "no maps"
        self.changed()

    def text_for(self, width: int) -> Text:
        """Histogram, slider, counts, values, settings."""
        view = self._view
        room = max(10, width - 17)
        text = Text(no_wrap=True)
        text.append("             ").append_text(self._histogram(room)).append("\n")
        text.append(f"contrast {view.contrast:>3} ", style="bold").append_text(self._slider(room)).append("\n")
        text.append(shorten(self._count_words(), width) + "\n", style="bold")
        text.append(shorten(view.values, width) + "\n")
        style = "yellow" if view.warning else "dim"
        return text.append(shorten(view.warning or view.settings, width), style=style)

    def _histogram(self, room: int) -> Text:
        if not self._view.histogram:
            return Text(" " * room)
        blocks = _ASCII_BLOCKS if self.ascii_only else _BLOCKS
        found = np.array(self._view.histogram, np.float64)
        heights = _resampled(np.sqrt(found), room)
        top = max(1.0, float(heights.max()))
        signs = "".join(blocks[min(8, int(np.ceil(8 * height / top)))] for height in heights)
        split = self._at(room)
        return Text(signs[:split], style="dim").append(signs[split:], style="#4aa3ff")

    def _slider(self, room: int) -> Text:
        at, line, knob = self._at(room), "-" if self.ascii_only else "─", "#" if self.ascii_only else "█"
        text = Text(line * at, style="dim")
        text.append(knob, style="bold #f0b429").append(line * max(0, room - at - 1), style="#4aa3ff")
        return text.append(" 255", style="dim")

    def _at(self, room: int) -> int:
        return min(room - 1, self._view.contrast * room // 256)

    def _count_words(self) -> str:
        counts = self._view.counts
        if counts is None:
            return "no maps yet"
        about = "" if counts.exact else "about "
        over = f"{counts.over_contrast:,}".replace(",", " ")
        crossing = f"{counts.with_crossing:,}".replace(",", " ")
        return f"{about}{over} pixels over it ({100 * counts.share:.1f} %), {crossing} of them with a crossing"


def _resampled(values: NDArray[np.float64], room: int) -> NDArray[np.float64]:
    edges = np.linspace(0, len(values), room + 1).astype(int)[:-1]
    return np.maximum.reduceat(values, edges)
