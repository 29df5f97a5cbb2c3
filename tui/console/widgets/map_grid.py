"""The four maps in one row or in a square, whichever shows them larger, or one map alone."""

from __future__ import annotations

from collections.abc import Sequence

from textual.containers import Grid
from textual.geometry import Size

from tui.console.pictures.maps import MapKind, MapLayer, MapWindow
from tui.console.widgets.map_view import MapView


class MapGrid(Grid):
    """All maps show the same window."""

    DEFAULT_CSS = """
    MapGrid { grid-size: 4; grid-gutter: 0 1; height: 1fr; padding: 0 1; }
    MapGrid.square { grid-size: 2; }
    MapGrid.alone { grid-size: 1; }
    """

    def __init__(self, *, plain: bool) -> None:
        """``plain``: in characters instead of colours."""
        views = {kind: MapView(id=kind.name.lower(), plain=plain) for kind in MapKind}
        super().__init__(*views.values(), id="maps")
        self._views = views
        self._alone: MapKind | None = None

    def show_next(self) -> None:
        """One map alone, the next, all four again."""
        order: list[MapKind | None] = [None, *MapKind]
        self._alone = order[(order.index(self._alone) + 1) % len(order)]

    def show(self, layers: Sequence[MapLayer], window: MapWindow, room: Size) -> None:
        """Take the maps; ``room`` is what the grid may fill, in cells."""
        width, height = max(8, room.width), max(4, room.height)
        rows, columns = window.rows, window.columns
        row = min(width / 4 / columns, 2 * (height - 2) / rows)
        square = min(width / 2 / columns, 2 * (height / 2 - 2) / rows)
        across = 1 if self._alone is not None else 2 if square > row else 4
        most = Size((width - across + 1) // across - 1, (height // 2 if across == 2 else height) - 2)
        self.set_class(across == 1, "alone")
        self.set_class(across == 2, "square")
        for layer in layers:
            view = self._views[layer.kind]
            view.display = self._alone in (None, layer.kind)
            view.show(layer, window, most)

    @property
    def cells_across(self) -> int:
        """How many cells wide a map is drawn."""
        return self._views[self._alone or MapKind.MINIMUM].cells_across
