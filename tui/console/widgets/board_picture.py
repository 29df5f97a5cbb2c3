"""The live picture with the corners of the board that were found in it."""

from __future__ import annotations

from collections.abc import Sequence

from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from tui.console.widgets.picture import LivePicture

Corners = Sequence[Sequence[float]]
"""x and y of each corner as shares of the picture's width and height."""
_CORNER = Style(color="#00ff9c", bold=True)


class BoardPicture(LivePicture):
    """Marks each found corner by a sign."""

    def __init__(self, mode: str = "half", *, ascii_only: bool = False) -> None:
        super().__init__(mode)
        self.crosshair = False
        self._sign = "o" if ascii_only else "•"
        self._corners: Corners = ()

    def mark(self, corners: Corners) -> None:
        """Take the corners; the picture is repainted if they moved."""
        if list(corners) != list(self._corners):
            self._corners = corners
            self.refresh()

    def render_line(self, y: int) -> Strip:
        """A row of the picture with its corners."""
        strip = super().render_line(y)
        if self._picture is None or not self._corners:
            return strip
        height, width = self._raster.levels.shape
        above, left = self._offset()
        places = {
            left + min(width - 1, int(x * width)) for x, share in self._corners if above + int(share * height / 2) == y
        }
        for place in sorted(places):
            cell = strip.crop(place, place + 1)
            ground = next(iter(cell), Segment(" ")).style
            style = _CORNER + Style(bgcolor=ground.bgcolor if ground else None)
            strip = Strip.join([strip.crop(0, place), Strip([Segment(self._sign, style)], 1), strip.crop(place + 1)])
        return strip
