"""The contrast threshold as a slider over the histogram of contrasts, what it leaves, and the values at the cursor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from tui.console.pictures.maps import ThresholdCounts
from tui.console.widgets.lines import Pane
from tui.text.sparkline import BARS
from tui.text.width import shorten


@dataclass(frozen=True)
class ContrastView:
    """Everything that the pane shows."""

    source: str = ""
    """Which maps these are."""
    contrast: int = 70
    """Counts of 8 bit."""
    counts: ThresholdCounts | None = None
    histogram: tuple[int, ...] = ()
    """Samples by contrast, over 0..255."""
    values: str = ""
    """The values at the cursor."""
    settings: str = ""
    warning: str = ""


class ContrastPane(Pane[ContrastView]):
    """Six lines."""

    DEFAULT_CSS = "ContrastPane { height: 7; }"

    def show(self, value: ContrastView) -> None:
        """Take the newest values."""
        self.border_title = shorten(value.source, max(10, self.size.width - 8)) or "no maps"
        super().show(value)

    def text_for(self, width: int) -> Text:
        """Histogram, slider, counts, values, settings."""
        view = self.shown
        room = max(10, width - 17)
        text = Text(no_wrap=True)
        text.append("             ").append_text(self._histogram(room)).append("\n")
        text.append(f"contrast {view.contrast:>3} ", style="bold").append_text(self._slider(room)).append("\n")
        text.append(shorten(_count_words(view.counts), width) + "\n", style="bold")
        text.append(shorten(view.values, width) + "\n")
        style = "yellow" if view.warning else "dim"
        return text.append(shorten(view.warning or view.settings, width), style=style)

    def _histogram(self, room: int) -> Text:
        if not self.shown.histogram:
            return Text(" " * room)
        heights = _resampled(np.sqrt(np.array(self.shown.histogram, np.float64)), room)
        steps = np.ceil(len(BARS) * heights / max(1.0, float(heights.max()))).astype(int)
        signs = "".join((" " + BARS)[step] for step in steps)
        split = self._knob(room)
        return Text(signs[:split], style="dim").append(signs[split:], style="#4aa3ff")

    def _slider(self, room: int) -> Text:
        knob = self._knob(room)
        text = Text("─" * knob, style="dim")
        text.append("█", style="bold #f0b429").append("─" * max(0, room - knob - 1), style="#4aa3ff")
        return text.append(" 255", style="dim")

    def _knob(self, room: int) -> int:
        """Cell of the threshold in a scale of ``room`` cells."""
        return min(room - 1, self.shown.contrast * room // 256)


def _count_words(counts: ThresholdCounts | None) -> str:
    if counts is None:
        return "no maps yet"
    about = "" if counts.exact else "about "
    over, crossing = (f"{count:,}".replace(",", " ") for count in (counts.over_contrast, counts.with_crossing))
    return f"{about}{over} pixels over it ({100 * counts.share:.1f} %), {crossing} of them with a crossing"


def _resampled(values: NDArray[np.float64], room: int) -> NDArray[np.float64]:
    """The largest value in each of ``room`` cells."""
    edges = np.linspace(0, len(values), room + 1).astype(int)[:-1]
    return np.maximum.reduceat(values, edges)
