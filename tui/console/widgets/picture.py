"""The live picture in half blocks or characters: prepared styles, one repaint per changed row, none if still."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

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
from tui.console.pictures.raster import FULL, PictureDetail, Raster, half_cells_for, runs

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

    def __init__(self, mode: str = "half", *, crosshair: bool = True) -> None:
        super().__init__()
        self.mode = mode
        self.words = ""
        self.picture: PictureView | None = None
        self._crosshair = crosshair
        self._raster = Raster()
        self._detail = FULL

    def show(self, picture: PictureView | None, words: str, detail: PictureDetail = FULL) -> None:
        """Take a picture, or ``words`` in its place; repaints the rows that look different."""
        if picture is None or self.mode == "off":
            if self.picture is not None or words != self.words:
                self.picture, self.words = None, words
                self.refresh()
            return
        fresh = self.picture is None
        self.picture, self._detail, self.words = picture, detail, words
        rows = self._take(picture)
        if fresh or len(rows) > WHOLE_SHARE * self.size.height:
            self.refresh()
        elif len(rows):
            above = self.offset_cells[0]
            self.refresh(*(Region(0, above + int(row), self.size.width, 1) for row in rows))

    def set_mode(self, mode: str) -> None:
        """Half blocks, characters, or no picture."""
        self.mode = mode
        self.refresh()

    def on_resize(self, event: Resize) -> None:
        """Draw the same picture in the new size."""
        if self.picture is not None:
            self._take(self.picture)

    def _take(self, picture: PictureView) -> NDArray[np.intp]:
        rows, columns = picture.pixels.shape[:2]
        height, width = half_cells_for(rows, columns, self.size.height, self.size.width)
        if not height:
            return np.zeros(0, np.intp)
        return self._raster.update(picture.pixels, height, width, self._detail, picture.header.position_steps)

    @property
    def size_cells(self) -> tuple[int, int]:
        """Height and width of the picture in cells; 0, 0 without one."""
        height, width = self._raster.levels.shape
        return (height // 2, width) if self.picture is not None else (0, 0)

    @property
    def offset_cells(self) -> tuple[int, int]:
        """Cells above and left of the picture."""
        height, width = self.size_cells
        return (self.size.height - height) // 2, (self.size.width - width) // 2

    def render_line(self, y: int) -> Strip:
        """One row of cells."""
        background = self.visual_style.rich_style
        if self.picture is None:
            return self._words_line(y, background)
        above, left = self.offset_cells
        row = y - above
        if not 0 <= row < self.size_cells[0]:
            return Strip.blank(self.size.width, background)
        cells = self._half_row(row) if self.mode == "half" else self._mono_row(row, background)
        margin = Segment(" " * left, background)
        return Strip([margin, *cells]).adjust_cell_length(self.size.width, background)

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
        for begin, end in runs(pair[0].astype(np.int32) * 256 + pair[1], centre):
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
        text = [CLIP_SIGN if marks[x] else RAMP[sign] for x, sign in enumerate(signs.tolist())]
        centre = self._centre(row)
        if centre >= 0:
            text[centre] = "+"
        yield Segment("".join(text), style)

    def _centre(self, row: int) -> int:
        """Column of the crosshair; -1 where it is not in this row."""
        height, width = self.size_cells
        return width // 2 if self._crosshair and row == height // 2 else -1
