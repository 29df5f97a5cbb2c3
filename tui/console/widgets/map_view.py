"""One map in half blocks, two values in a cell: prepared styles, nothing painted twice, NaN as a pattern."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from rich.color import Color
from rich.segment import Segment
from rich.style import Style
from textual.events import Click
from textual.geometry import Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from acquire.contract.colormaps import NO_VALUE_RGB, MapName, table
from tui.console.pictures.maps import MapLayer, MapWindow, cell_of_cursor, cells_of
from tui.console.pictures.raster import half_cells_for, runs

LEVELS = 32
"""Number of colours."""
NONE = -1
RAMP = " .:-=+*#%@"
_LABEL = Style(bold=True)
_DIM = Style(dim=True)
_CURSOR = Style(bold=True, color="#ffffff", bgcolor="#c02020")


@lru_cache(maxsize=8)
def _palette(colours: MapName | None) -> tuple[Color, ...]:
    if colours is None:
        rgb = np.repeat(np.linspace(0, 255, LEVELS).round().astype(int)[:, None], 3, axis=1)
    else:
        rgb = table(colours)[np.linspace(0, 255, LEVELS).round().astype(int)].astype(int)
    return tuple(Color.from_rgb(*(int(channel) for channel in row)) for row in rgb)


@lru_cache(maxsize=16_384)
def _style(colours: MapName | None, top: int, bottom: int) -> Style:
    palette = _palette(colours)
    if NONE in (top, bottom):  # the half without a value keeps the screen's background
        return Style(color=palette[max(top, bottom)])
    return Style(color=palette[top], bgcolor=palette[bottom])


@lru_cache(maxsize=1)
def _none_style() -> Style:
    return Style(color=Color.from_rgb(*NO_VALUE_RGB), dim=True)


def levels_of(values: NDArray[np.float32], low: float, high: float) -> NDArray[np.int8]:
    """Values as 0..LEVELS-1, :data:`NONE` for NaN."""
    span = high - low if high > low else 1.0
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, low) - low) / span, 0.0, 1.0)
    return np.where(known, np.rint(share * (LEVELS - 1)), NONE).astype(np.int8)


class MapView(Widget):
    """One map with its name above and its range below."""

    ALLOW_SELECT = False
    DEFAULT_CSS = "MapView { width: 1fr; height: 1fr; }"

    @dataclass
    class Pointed(Message):
        """A cell of the picture was clicked; ``rows`` x ``columns`` is the picture's size."""

        row: int
        column: int
        rows: int
        columns: int

    def __init__(self, *, id: str, plain: bool = False) -> None:  # noqa: A002 - Textual's name
        """``plain``: characters of a grey ramp instead of colours."""
        super().__init__(id=id)
        self._plain = plain
        self._layer: MapLayer | None = None
        self._levels = np.zeros((0, 0), np.int8)
        self._window: MapWindow | None = None
        self._cursor = (-1, -1)
        self._high = 0.0
        self._most = Size(1, 1)
        self.painted = 0
        """How often the picture changed, for tests."""

    @property
    def cells_across(self) -> int:
        """Cells that the picture may be wide."""
        return max(1, min(self.content_size.width - 1, self._most.width))

    def show(self, layer: MapLayer, window: MapWindow, most: Size) -> None:
        """Take a map and its visible part; at most ``most`` cells large, so that neighbours are equally large."""
        self._layer, self._window, self._most = layer, window, most
        self._compute()

    def on_resize(self) -> None:
        """Draw for the new size."""
        self._compute()

    def _compute(self) -> None:
        layer, window = self._layer, self._window
        if layer is None or window is None or not self.size:
            return
        room = max(1, min(self.content_size.height - 2, self._most.height))  # name and range take two lines
        rows, columns = half_cells_for(window.height, window.width, room, self.cells_across)
        if self._plain:
            rows //= 2
        levels = levels_of(cells_of(layer.values, window, rows, columns), layer.low, layer.high)
        row, column = cell_of_cursor(window, rows, columns)
        cursor = (row if self._plain else row // 2, column)
        if (cursor, layer.high) == (self._cursor, self._high) and np.array_equal(levels, self._levels):
            return
        self._levels, self._cursor, self._high = levels, cursor, layer.high
        self.painted += 1
        self.refresh()

    def on_click(self, event: Click) -> None:
        """Report the clicked cell."""
        place = event.get_content_offset(self)
        if self._layer is None or place is None or not self._levels.size:
            return
        rows, columns = self._levels.shape
        row = (place.y - 1) * (1 if self._plain else 2)
        if 0 <= row < rows and 0 <= place.x < columns:
            self.post_message(self.Pointed(row, place.x, rows, columns))

    def render_line(self, y: int) -> Strip:
        """The name, the picture, the range."""
        return self._line(y).apply_style(self.rich_style)

    def _line(self, y: int) -> Strip:
        layer, width = self._layer, self.size.width
        if layer is None or not self._levels.size:
            return Strip.blank(width)
        rows = len(self._levels) if self._plain else len(self._levels) // 2
        if y == 0:
            segments = [Segment(layer.kind, _LABEL)]
        elif y == rows + 1:
            segments = self._legend(layer, width)
        elif 1 <= y <= rows:
            segments = self._plain_row(y - 1) if self._plain else self._row(layer, y - 1)
        else:
            segments = []
        return Strip(segments).adjust_cell_length(width)

    def _row(self, layer: MapLayer, row: int) -> list[Segment]:
        tops, bottoms = self._levels[2 * row].tolist(), self._levels[2 * row + 1].tolist()
        codes = self._levels[2 * row].astype(np.int32) * 256 + self._levels[2 * row + 1]
        segments = []
        for begin, end in runs(codes, self._cursor[1] if row == self._cursor[0] else -1):
            top, bottom = tops[begin], bottoms[begin]
            if (row, begin) == self._cursor:
                segments.append(Segment("+", _CURSOR))
            elif top == bottom == NONE:
                segments.append(Segment("╱" * (end - begin), _none_style()))
            else:
                half = "▄" if top == NONE else "▀"
                segments.append(Segment(half * (end - begin), _style(layer.colours, top, bottom)))
        return segments

    def _plain_row(self, row: int) -> list[Segment]:
        signs = ["/" if level == NONE else _ramp_sign(level) for level in self._levels[row].tolist()]
        if row == self._cursor[0]:
            signs[self._cursor[1]] = "X"
        return [Segment("".join(signs))]

    def _legend(self, layer: MapLayer, width: int) -> list[Segment]:
        low, high = f"{layer.low:.0f} ", f" {layer.high:.0f} {layer.unit}"
        if layer.unit == "":
            low, high = "under ", " over"
        room = min(24, width - len(low) - len(high) - 1)
        if room < 2:
            return [Segment(f"{low}..{high}", _DIM)]
        steps = [round(cell * (LEVELS - 1) / (room - 1)) for cell in range(room)]
        if self._plain:
            bar = [Segment("".join(map(_ramp_sign, steps)))]
        else:
            bar = [Segment("▀", _style(layer.colours, step, step)) for step in steps]
        return [Segment(low, _DIM), *bar, Segment(high, _DIM)]


def _ramp_sign(level: int) -> str:
    return RAMP[level * len(RAMP) // LEVELS]
