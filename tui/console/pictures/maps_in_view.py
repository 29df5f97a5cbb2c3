"""The maps that are shown, with their threshold and its mask, the window and its cursor; pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tui.console.pictures.maps import (
    MapLayer,
    MapSet,
    MapWindow,
    ThresholdCounts,
    counts_of,
    histogram,
    layers_of,
    mask_of,
    pixel_words,
    sample_at,
    window_on,
)

BINS = 128
MAX_CONTRAST = 255
"""ThresholdCounts of 8 bit."""


class MapsInView:
    """One set of maps at a time; newer ones keep the threshold and the window."""

    def __init__(self) -> None:
        self.maps: MapSet | None = None
        self.contrast: int | None = None
        """The threshold; None until the first maps, which bring theirs."""
        self.window: MapWindow | None = None
        self.histogram: tuple[int, ...] = ()
        self._mask: NDArray[np.bool_] = np.zeros((0, 0), np.bool_)

    def take(self, maps: MapSet) -> None:
        """Show these maps."""
        self.maps = maps
        if self.contrast is None:
            self.contrast = maps.contrast
        self.window = window_on(maps, self.window)
        self.histogram = tuple(int(count) for count in histogram(maps, BINS))
        self._make_mask()

    def forget(self, *, threshold: bool = False) -> None:
        """Show no maps; with ``threshold`` the next ones bring their own threshold."""
        self.maps = None
        if threshold:
            self.contrast = None

    def set_contrast(self, contrast: int) -> None:
        """Another threshold, in counts of 8 bit."""
        self.contrast = max(0, min(MAX_CONTRAST, contrast))
        self._make_mask()

    def _make_mask(self) -> None:
        if self.maps is not None and self.contrast is not None:
            self._mask = mask_of(self.maps, self.contrast)

    # ---- the window; nothing happens without maps ----

    def zoom(self, steps: int) -> None:
        """In (1) or out (-1)."""
        if self.window is not None:
            self.window = self.window.zoomed(steps)

    def move(self, down: int, right: int, cells: int) -> None:
        """Move the cursor by about one cell of a map that is drawn ``cells`` wide."""
        if self.window is not None:
            stride = self.window.stride(cells)
            self.window = self.window.moved(down * stride, right * stride)

    def point(self, row: int, column: int, rows: int, columns: int) -> None:
        """Move the cursor to a cell of ``rows`` x ``columns``."""
        if self.window is not None:
            self.window = sample_at(self.window, row, column, rows, columns)

    # ---- what is shown; there must be maps ----

    def layers(self) -> tuple[MapLayer, ...]:
        """The four maps, ready to be drawn."""
        assert self.maps is not None
        return layers_of(self.maps, self._mask)

    def counts(self) -> ThresholdCounts:
        """What the threshold leaves."""
        assert self.maps is not None and self.contrast is not None
        return counts_of(self.maps, self._mask, self.contrast)

    def words(self) -> str:
        """The values under the cursor."""
        assert self.maps is not None and self.window is not None
        zoom = f"   zoom {self.window.zoom}" if self.window.zoom > 1 else ""
        return pixel_words(self.maps, self._mask, self.window) + zoom
