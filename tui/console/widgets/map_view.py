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
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from acquire.contract.colormaps import NO_VALUE_RGB, MapName, table
from tui.console.pictures.maps import MapLayer, MapWindow, cell_of_cursor, cells_of, picture_size

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
        self._max_across = 1000
        self.painted = 0
        """How often the picture changed, for tests."""

    @property
    def picture_cells(self) -> tuple[int, int]:
        """Rows (two in a cell, one where plain) and columns of values that have room."""
        size = self.content_size
        across = min(size.width - 1, self._max_across)
        return max(1, (size.height - 2) * (1 if self._plain else 2)), max(1, across)

    def show(self, layer: MapLayer, window: MapWindow, max_across: int) -> None:
        """Take a map and its visible part; at most ``max_across`` cells wide, so that neighbours are equally large."""
        self._layer, self._window, self._max_across = layer, window, max_across
        self._compute()

    def on_resize(self) -> None:
        """Draw for the new size."""
        self._compute()

    def _compute(self) -> None:
        layer, window = self._layer, self._window
        if layer is None or window is None or not self.size:
            return
        down, across = self.picture_cells
        shape = (round(window.height * (0.5 if self._plain else 1.0)) or 1, max(1, round(window.width)))
        rows, columns = picture_size(shape, across, down)
        if not self._plain:
            rows += rows % 2
            rows = min(rows, down)
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
        width = self.size.width
        if self._layer is None or not self._levels.size:
            return Strip.blank(width)
        rows = len(self._levels) if self._plain else (len(self._levels) + 1) // 2
        if y == 0:
            return Strip([Segment(f"{self._layer.kind:<{width}}"[:width], _LABEL)], width)
        if y == rows + 1:
            return self._legend(width)
        if not 1 <= y <= rows:
            return Strip.blank(width)
        segments = self._plain_row(y - 1) if self._plain else self._row(y - 1)
        used = self._levels.shape[1]
        return Strip([*segments, Segment(" " * max(0, width - used))]).crop(0, width)

    def _row(self, row: int) -> list[Segment]:
        assert self._layer is not None
        tops = self._levels[2 * row]
        bottoms = self._levels[2 * row + 1] if 2 * row + 1 < len(self._levels) else tops
        change = np.flatnonzero((np.diff(tops) != 0) | (np.diff(bottoms) != 0)) + 1
        starts = [0, *change.tolist(), len(tops)]
        if row == self._cursor[0]:
            starts = sorted({*starts, self._cursor[1], self._cursor[1] + 1})
        segments = []
        for start, end in zip(starts[:-1], starts[1:], strict=True):
            if (row, start) == self._cursor:
                segments.append(Segment("+", _CURSOR))
                continue
            top, bottom = int(tops[start]), int(bottoms[start])
            if top == bottom == NONE:
                segments.append(Segment("╱" * (end - start), _none_style()))
            else:
                half = "▄" if top == NONE else "▀"
                segments.append(Segment(half * (end - start), _style(self._layer.colours, top, bottom)))
        return segments

    def _plain_row(self, row: int) -> list[Segment]:
        levels = self._levels[row].astype(int)
        signs = ["/" if level == NONE else RAMP[level * len(RAMP) // LEVELS] for level in levels]
        if row == self._cursor[0]:
            signs[self._cursor[1]] = "X"
        return [Segment("".join(signs))]

    def _legend(self, width: int) -> Strip:
        layer = self._layer
        assert layer is not None
        low, high = f"{layer.low:.0f} ", f" {layer.high:.0f} {layer.unit}".rstrip()
        if layer.unit == "":
            low, high = "under ", " over"
        room = min(24, width - len(low) - len(high) - 1)
        if room < 2:
            return Strip([Segment(f"{low}..{high}".ljust(width)[:width], _DIM)], width)
        steps = [round(cell * (LEVELS - 1) / (room - 1)) for cell in range(room)]
        if self._plain:
            bar = [Segment("".join(RAMP[step * len(RAMP) // LEVELS] for step in steps))]
        else:
            bar = [Segment("▀", _style(layer.colours, step, step)) for step in steps]
        used = len(low) + room + len(high)
        tail = Segment(" " * max(0, width - used))
        return Strip([Segment(low, _DIM), *bar, Segment(high, _DIM), tail]).crop(0, width)
