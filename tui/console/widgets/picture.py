"""The live picture in half blocks or characters: prepared styles, one repaint per changed row, none if still."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rich.color import Color
from rich.segment import Segment
from rich.style import Style
from textual.events import Resize
from textual.geometry import Region
from textual.strip import Strip
from textual.widget import Widget

from tui.console.link.rig_view import PictureView
from tui.console.pictures.raster import FULL, Detail, Raster, fit

if TYPE_CHECKING:
    from collections.abc import Iterator

RAMP = " .:-=+*%#@"
CLIP_SIGN = "X"
WHOLE_SHARE = 0.6
"""From this share of changed rows on the whole picture is repainted at once."""
CLIP_COLOUR = Color.from_rgb(255, 60, 60)
CLIP_CODE = 255
CROSS_COLOUR = Color.from_rgb(240, 180, 41)
MODES = ("half", "mono", "off")


def grey(level: int, count: int) -> Color:
    """One of the 24 greys that every terminal of 256 colours has."""
    if level == CLIP_CODE:
        return CLIP_COLOUR
    value = 8 + 10 * round(level * 23 / (count - 1))
    return Color.from_rgb(value, value, value)


@cache
def half_style(top: int, bottom: int, count: int) -> Style:
    """Foreground for the upper half of a cell, background for the lower."""
    return Style(color=grey(top, count), bgcolor=grey(bottom, count))


class LivePicture(Widget):
    """Shows the newest picture that it is given, or words where there is none."""

    DEFAULT_CSS = "LivePicture { height: 1fr; width: 1fr; }"
    ALLOW_SELECT = False

    def __init__(self, mode: str = "half") -> None:
        super().__init__(id="live")
        self.mode = mode
        self.words = ""
        self.crosshair = True
        self._picture: PictureView | None = None
        self._raster = Raster()
        self._detail = FULL
        self.painted_rows = 0
        """Rows that were repainted since the start, for measuring."""

    def show(self, picture: PictureView | None, words: str, detail: Detail = FULL) -> None:
        """Take a picture, or ``words`` in its place; repaints what looks different."""
        if picture is None or self.mode == "off":
            if self._picture is not None or words != self.words:
                self._picture, self.words = None, words
                self.refresh()
            return
        fresh = self._picture is None
        self._picture, self._detail, self.words = picture, detail, words
        rows = self._take()
        self.painted_rows += len(rows)
        if fresh or len(rows) > WHOLE_SHARE * self.size.height:
            self.refresh()
        elif len(rows):
            offset = self._offset()[0]
            self.refresh(*(Region(0, offset + int(row), self.size.width, 1) for row in rows))

    def set_mode(self, mode: str) -> None:
        """Half blocks, characters, or no picture."""
        self.mode = mode
        self.refresh()

    def on_resize(self, event: Resize) -> None:
        """Draw the same picture in the new size."""
        if self._picture is not None:
            self._take()

    def _take(self) -> NDArray[np.intp]:
        assert self._picture is not None
        height, width = fit(
            self._picture.pixels.shape[0], self._picture.pixels.shape[1], self.size.height, self.size.width
        )
        if not height:
            return np.zeros(0, np.intp)
        header = self._picture.header
        return self._raster.update(self._picture.pixels, height, width, self._detail, header.position_steps)

    def _offset(self) -> tuple[int, int]:
        height, width = self._raster.levels.shape
        return (self.size.height - height // 2) // 2, (self.size.width - width) // 2

    @property
    def cells_wide(self) -> int:
        """Cells that the picture is wide now."""
        return self._raster.levels.shape[1] if self._picture is not None else 0

    def render_line(self, y: int) -> Strip:
        """One row of cells."""
        background = self.visual_style.rich_style
        if self._picture is None:
            return self._words_line(y, background)
        above, left = self._offset()
        row = y - above
        if not 0 <= row < self._raster.levels.shape[0] // 2:
            return Strip.blank(self.size.width, background)
        cells = list(self._half_row(row) if self.mode == "half" else self._mono_row(row, background))
        right = self.size.width - left - self._raster.levels.shape[1]
        margin = [Segment(" " * left, background)], [Segment(" " * right, background)]
        return Strip([*margin[0], *cells, *margin[1]], self.size.width)

    def _words_line(self, y: int, style: Style) -> Strip:
        lines = self.words.split("\n")
        index = y - (self.size.height - len(lines)) // 2
        text = lines[index][: self.size.width] if 0 <= index < len(lines) else ""
        return Strip([Segment(text.center(self.size.width), style + Style(dim=True))], self.size.width)

    def _half_row(self, row: int) -> Iterator[Segment]:
        raster = self._raster
        pair = np.where(raster.clipped, np.uint8(CLIP_CODE), raster.levels)[2 * row : 2 * row + 2]
        top, bottom = pair[0].tolist(), pair[1].tolist()
        centre = self._centre(row)
        for begin, end in _runs(pair[0].astype(np.int32) * 256 + pair[1], centre):
            style = half_style(top[begin], bottom[begin], raster.count)
            if begin == centre:
                yield Segment("┼", Style(color=CROSS_COLOUR, bgcolor=style.bgcolor))
            else:
                yield Segment("▀" * (end - begin), style)

    def _mono_row(self, row: int, style: Style) -> Iterator[Segment]:
        raster = self._raster
        mean = raster.levels[2 * row : 2 * row + 2].mean(axis=0)
        marks = np.any(raster.clipped[2 * row : 2 * row + 2], axis=0)
        signs = np.rint(mean * (len(RAMP) - 1) / (raster.count - 1)).astype(int)
        text = "".join(CLIP_SIGN if marks[x] else RAMP[sign] for x, sign in enumerate(signs.tolist()))
        centre = self._centre(row)
        if centre >= 0:
            text = text[:centre] + "+" + text[centre + 1 :]
        yield Segment(text, style)

    def _centre(self, row: int) -> int:
        height, width = self._raster.levels.shape
        return width // 2 if self.crosshair and row == height // 4 else -1


def _runs(codes: NDArray[np.int32], apart: int) -> list[tuple[int, int]]:
    """Begin and end of the runs of equal values; the cell ``apart`` (-1: none) is a run of its own."""
    breaks = np.flatnonzero(np.diff(codes)) + 1
    if apart >= 0:
        breaks = np.union1d(breaks, [index for index in (apart, apart + 1) if 0 < index < len(codes)])
    edges = [0, *breaks.tolist(), len(codes)]
    return list(zip(edges[:-1], edges[1:], strict=True))
