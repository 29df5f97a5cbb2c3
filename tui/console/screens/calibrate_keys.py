"""The keys of the calibrate screen."""

from __future__ import annotations

from textual.binding import Binding, BindingType

BINDINGS: list[BindingType] = [
    Binding("p", "preview", "preview", id="calibrate.preview", tooltip="camera pictures on or off"),
    Binding("L", "lamp", "lamp", id="calibrate.lamp", tooltip="lamp on or off"),
    Binding("t", "goto", "go to", id="calibrate.goto", tooltip="where the light shall stand"),
    Binding("b", "board", "board", id="calibrate.board", tooltip="squares, their size, kind"),
    Binding("c", "capture", "capture", id="calibrate.capture", tooltip="keep this view in full size"),
    Binding("u", "undo", "drop last", id="calibrate.undo", tooltip="put the last view aside"),
    Binding("g", "fit", "calibrate", id="calibrate.fit", tooltip="calibrate with what was collected"),
    Binding("m", "step", "next step", id="calibrate.step", tooltip="camera, light plane"),
    Binding("w", "sweep", "sweep", id="calibrate.sweep", tooltip="sweep over the board as it lies now"),
    Binding(
        "e",
        "expose",
        "expose",
        id="calibrate.expose",
        tooltip="search the exposure; for a sweep, light over the board",
    ),
    Binding("enter", "use", "use or not", id="calibrate.use", tooltip="whether a sweep counts"),
    Binding("v", "verdict", "result", id="calibrate.verdict", tooltip="the last result, or the guidance"),
    Binding("n", "anew", "begin anew", id="calibrate.anew", tooltip="an empty session; this one stays"),
    Binding("x", "cancel", "cancel", id="calibrate.cancel", tooltip="end the calibration that runs"),
    Binding("P", "pose", "next pose", id="calibrate.pose", tooltip="simulated rig: the board in another pose"),
    Binding("O", "object", "take board off", id="calibrate.object", tooltip="simulated rig: the specimen back"),
    Binding("up", "move(-1)", "previous", show=False),
    Binding("down", "move(1)", "next", show=False),
]
