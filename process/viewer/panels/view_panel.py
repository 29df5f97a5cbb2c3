"""The widgets for how the cloud is shown; all browsers share them, but each has a camera of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import viser

from process.viewer.rig_client.tile import BoundingBox
from process.viewer.scene.camera_views import VIEWS, CameraViews
from process.viewer.status_html import legend_html
from process.viewer.stream.colouring import MODES, QUANTITIES, ColourMode, ValueRange, ViewSettings
from process.viewer.stream.point_nodes import PointNodes

from .widgets import write

LABELS: Final[dict[ColourMode, str]] = {
    "photograph": "Photograph",
    "height": "Height",
    "crossing": "Crossing time",
    "sigma": "Sigma",
    "deviation": "Deviation from a plane",
}
MILLION = 1_000_000
MOST_POINTS = 3 * MILLION
"""More than this is no longer fluid on an ordinary laptop."""
AXES = ("x", "y", "z")
ROOM = 0.05
"""A clipping box starts so much larger than the cloud."""


class ViewPanel:
    """Colours, range, size and number of points, clipping box, views. Callbacks only note; the main loop acts."""

    def __init__(self, server: viser.ViserServer, camera_views: CameraViews, max_points: int) -> None:
        self._camera_views = camera_views
        self._settings = ViewSettings(max_points=max_points)
        self._bounds: BoundingBox | None = None
        gui = server.gui
        self._legend = gui.add_html("")
        self._mode = gui.add_dropdown("Colour", [LABELS[mode] for mode in MODES], hint="What the colours show")
        self._automatic = gui.add_checkbox("Automatic range", True, hint="From the 1 % to the 99 % quantile")
        self._low = gui.add_number("from", 0.0, step=0.001, disabled=True)
        self._high = gui.add_number("to", 1.0, step=0.001, disabled=True)
        self._size = gui.add_slider("Point size", min=0.25, max=4.0, step=0.25, initial_value=1.0)
        most = max(MOST_POINTS, max_points) / MILLION
        self._most = gui.add_number(
            "Points (M)", max_points / MILLION, min=0.05, max=most, step=0.05, hint="Shown at most; the rest is thinned"
        )
        views = gui.add_button_group("View", ("Fit", *VIEWS))
        with gui.add_folder("Clipping box", expand_by_default=False):
            self._clip = gui.add_checkbox("Clip", False, hint="Show only what is inside the box")
            self._sides = [
                gui.add_multi_slider(f"{axis} (mm)", 0.0, 1.0, 0.001, (0.0, 1.0), disabled=True) for axis in AXES
            ]
        views.on_click(self._go_to)
        widgets: tuple[Any, ...] = (self._mode, self._automatic, self._low, self._high, self._size, self._most)
        for widget in (*widgets, *self._sides):
            widget.on_update(self._noting(self._note))
        self._clip.on_update(self._noting(self._note_clip))

    @property
    def settings(self) -> ViewSettings:
        """What people chose; read by the main loop."""
        return self._settings

    def show(self, nodes: PointNodes) -> None:
        """Legend and the ends of the automatic range, as they are now."""
        self._bounds = nodes.bounds()
        write(self._legend, content=legend_html(nodes.legend()))
        if self._automatic.value and nodes.range is not None and self._settings.mode != "photograph":
            self._fill(nodes.range)

    def _fill(self, within: ValueRange) -> None:
        for widget, value in ((self._low, within.low), (self._high, within.high)):
            write(widget, value=round(value, QUANTITIES[self._settings.mode].decimals))

    def _noting(self, note: Callable[[], None]) -> Callable[[Any], Any]:
        async def updated(_event: Any) -> None:
            note()

        return updated

    def _note(self) -> None:
        mode = next(mode for mode in MODES if LABELS[mode] == self._mode.value)
        if mode != self._settings.mode:
            write(self._automatic, value=True)  # the range of one quantity means nothing for another
        automatic = bool(self._automatic.value) or mode == "photograph"
        for widget in (self._low, self._high):
            write(widget, disabled=automatic)
        self._settings = replace(
            self._settings,
            mode=mode,
            low=None if automatic else float(self._low.value),
            high=None if automatic else float(self._high.value),
            size_factor=float(self._size.value),
            max_points=max(1000, round(float(self._most.value) * MILLION)),
            box=self._box(),
        )

    def _note_clip(self) -> None:
        """A box starts around the whole cloud, and stays where it is while the cloud grows."""
        on, bounds = bool(self._clip.value), self._bounds
        for axis, side in enumerate(self._sides):
            if on and bounds is not None:
                margin = ROOM * bounds.radius_mm
                low, high = round(bounds.low[axis] - margin, 3), round(bounds.high[axis] + margin, 3)
                write(side, min=low, max=high, value=(low, high))
            write(side, disabled=not on)
        self._note()

    def _box(self) -> BoundingBox | None:
        if not self._clip.value or self._bounds is None:
            return None
        ends = [side.value for side in self._sides]
        low, high = ([float(end[which]) for end in ends] for which in (0, 1))
        return BoundingBox((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    async def _go_to(self, event: Any) -> None:
        if event.client is not None:
            self._camera_views.fit(event.client, "" if event.target.value == "Fit" else str(event.target.value))
