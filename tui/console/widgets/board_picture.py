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
    """Marks each corner by a sign."""

    def __init__(self, mode: str = "half") -> None:
        super().__init__(mode, crosshair=False)
        self._corners: Corners = ()

    def mark(self, corners: Corners) -> None:
        """Take the corners; the picture is repainted if they moved."""
        if list(corners) != list(self._corners):
            self._corners = corners
            self.refresh()

    def render_line(self, y: int) -> Strip:
        """A row of the picture with its corners."""
        strip = super().render_line(y)
        if self.picture is None or not self._corners:
            return strip
        (above, left), (height, width) = self.offset_cells, self.size_cells
        places = {
            left + min(width - 1, int(x * width)) for x, share in self._corners if above + int(share * height) == y
        }
        sign = "o" if self.mode == "mono" else "•"
        for place in sorted(places):
            cell = next(iter(strip.crop(place, place + 1)), Segment(" ")).style
            style = _CORNER + Style(bgcolor=cell.bgcolor if cell else None)
            strip = Strip.join([strip.crop(0, place), Strip([Segment(sign, style)], 1), strip.crop(place + 1)])
        return strip
