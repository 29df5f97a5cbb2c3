"""The measuring tool: picked points, distances between them, their marks in the scene; the same for all browsers.

Clicks only put rays into a queue; the main loop, which alone changes the cloud, answers them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from process.viewer.rig_client.tile import Tile
from process.viewer.status_html import html_of
from process.viewer.stream.point_nodes import PointNodes

from .picking import Distance, PickedPoint, Profile, Ray, measurements_csv, pick, profile, quality_words
from .widgets import JobQueue, write

MARK_RGB = (255, 92, 168)
MARK_SHARE = 0.01
"""Radius of a mark as a part of the cloud's."""
PROFILE_SHARE = 0.02
"""Width of a section as a part of the cloud's radius."""
MOST = 50
NONE = "none yet"


class MeasurePanel:
    """The widgets, the list and the marks."""

    def __init__(self, server: viser.ViserServer, nodes: PointNodes, wake: Callable[[], None]) -> None:
        self._server = server
        self._nodes = nodes
        self._jobs = JobQueue(wake)
        self._tiles: Mapping[int, Tile] = {}
        self._eye_mm: NDArray[np.float64] | None = None
        self._picked: PickedPoint | None = None
        """The newest point; its numbers are shown."""
        self._first: PickedPoint | None = None
        """The first end of the next distance."""
        self._distances: dict[str, Distance] = {}
        self._made = 0
        self._marks: list[Any] = []
        self.scan = ""
        """What the measured scan is called, for the CSV."""
        gui = server.gui
        self._on = gui.add_checkbox("Pick points", False, hint="A click marks the nearest point; two make a distance")
        self._text = gui.add_html("")
        self._which = gui.add_dropdown("Distance", (NONE,), disabled=True)
        self._actions = gui.add_button_group("", ("Delete", "Delete all", "CSV"))
        self._place = gui.add_folder("Section", visible=False)
        self._plot: viser.GuiUplotHandle | None = None
        self._on.on_update(self._switch)
        self._which.on_update(self._choose)
        self._actions.on_click(self._act)
        self._show_list()

    # ---- from the browsers: the server's loop ----

    async def _switch(self, _event: Any) -> None:
        if self._on.value:
            clicked: Any = self._clicked  # a coroutine keeps the order of clicks; viser's types know only functions
            self._server.scene.on_click()(clicked)
        else:
            self._server.scene.remove_click_callback("all")
        self._jobs.put(self._forget_first)

    async def _clicked(self, event: viser.SceneClickEvent) -> None:
        camera = event.client.camera
        ray = Ray(event.ray_origin, event.ray_direction, float(camera.fov) / max(1, camera.image_height))
        self._jobs.put(lambda: self._pick(ray, event.client))

    async def _act(self, event: Any) -> None:
        if event.target.value == "CSV":
            if event.client is not None:
                client = event.client
                self._jobs.put(lambda: self._send_csv(client))
            return
        self._jobs.put(self._delete_all if event.target.value == "Delete all" else self._delete)

    async def _choose(self, _event: Any) -> None:
        self._jobs.put(self._show_profile)

    # ---- in the main loop ----

    def turn(self, tiles: Mapping[int, Tile], eye_mm: NDArray[np.float64] | None) -> None:
        """Answer clicks on ``tiles``; ``eye_mm`` is where the rig's camera is, None if that is not known."""
        self._tiles, self._eye_mm = tiles, eye_mm
        self._jobs.run()

    def _pick(self, ray: Ray, client: viser.ClientHandle) -> None:
        least_mm = self._nodes.size_mm(self._nodes.fine) / 2
        found = pick(self._tiles.values(), ray, least_mm, self._eye_mm, self._nodes.settings.box)
        if found is None:
            client.add_notification("No data here", "Click on a point of the cloud.", auto_close_seconds=3)
        else:
            self._take(found)

    def forget(self, scan: str) -> None:
        """Another scan is shown: what was measured in the last one has no meaning in it."""
        if scan != self.scan:
            self.scan = scan
            self._delete_all()

    def _take(self, picked: PickedPoint) -> None:
        self._picked = picked
        if self._first is None or len(self._distances) >= MOST:
            self._first = picked
        else:
            self._made += 1
            name = f"D{self._made}"
            self._distances[name] = Distance(self._first, picked)
            self._first = None
            self._offer(name)
        self._draw()
        self._show_profile()

    def _forget_first(self) -> None:
        self._first = None
        self._show_list()
        self._draw()

    def _delete(self) -> None:
        self._distances.pop(str(self._which.value), None)
        self._changed()

    def _delete_all(self) -> None:
        self._distances.clear()
        self._first = self._picked = None
        self._changed()

    def _send_csv(self, client: viser.ClientHandle) -> None:
        text = measurements_csv(self.scan, list(self._distances.items()))
        client.send_file_download("measurements.csv", text.encode(), save_immediately=True)

    def _changed(self) -> None:
        self._offer(next(reversed(self._distances), NONE))
        self._draw()
        self._show_profile()

    def _offer(self, chosen: str) -> None:
        write(self._which, options=tuple(self._distances) or (NONE,), disabled=not self._distances)
        write(self._which, value=chosen)

    def _show_list(self) -> None:
        picked = self._picked
        hint = "Click the second point." if self._first is not None else "Click the first point."
        html = html_of(
            "measurements.html",
            picked=picked,
            quality=quality_words(picked.quality) if picked is not None else "",
            chosen=self._distances.get(str(self._which.value)),
            distances=self._distances,
            hint=hint if self._on.value else "Switch on “Pick points”, then click two points of the cloud.",
        )
        write(self._text, content=html)

    def _draw(self) -> None:
        for mark in self._marks:
            mark.remove()
        self._marks.clear()
        bounds = self._nodes.bounds()
        radius = MARK_SHARE * bounds.radius_mm if bounds is not None else 0.05
        ends = [self._first] if self._first is not None else []
        scene = self._server.scene
        for name, distance in self._distances.items():
            ends += [distance.first, distance.second]
            line = np.array([[distance.first.xyz_mm, distance.second.xyz_mm]], np.float32)
            middle = line[0].mean(axis=0)
            path = f"/measured/{name}"
            self._marks.append(
                scene.add_line_segments(f"{path}/line", line, MARK_RGB, thickness=2.0, thickness_units="screen")
            )
            self._marks.append(scene.add_label(f"{path}/label", f"{name}  {distance.straight}", position=middle))
        for index, end in enumerate(ends):
            self._marks.append(
                scene.add_icosphere(
                    f"/measured/point{index}",
                    radius=radius,
                    color=MARK_RGB,
                    position=end.xyz_mm,
                    cast_shadow=False,
                    receive_shadow=False,
                )
            )

    def _show_profile(self) -> None:
        chosen = self._distances.get(str(self._which.value))
        bounds = self._nodes.bounds()
        found = None
        if chosen is not None and bounds is not None:
            found = profile(self._nodes.tiles.values(), chosen, PROFILE_SHARE * bounds.radius_mm)
        if self._plot is not None:
            self._plot.remove()
            self._plot = None
        write(self._place, visible=found is not None)
        if found is not None:
            write(self._place, label=f"Section {found.width_mm:.2f} mm wide, {found.points:,} points")
            self._plot = self._plotted(found)
        self._show_list()

    def _plotted(self, found: Profile) -> viser.GuiUplotHandle:
        """Made anew each time: one that was made while hidden has no width."""
        with self._place:
            return self._server.gui.add_uplot(
                (found.along_mm, found.mean_mm, found.low_mm, found.high_mm),
                (
                    uplot.Series(label="along"),
                    uplot.Series(label="mean", stroke="#7fd1ff", width=1.5),
                    uplot.Series(label="lowest", stroke="rgba(127,209,255,.35)"),
                    uplot.Series(label="highest", stroke="rgba(127,209,255,.35)"),
                ),
                scales={"x": uplot.Scale(time=False)},
                axes=(_axis("mm"), _axis("mm")),
                height=210,
            )


def _axis(unit: str) -> uplot.Axis:
    return uplot.Axis(label=unit, stroke="#9aa4b2", grid={"stroke": "#2a303b"}, size=36, labelSize=14)
