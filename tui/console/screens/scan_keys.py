"""The keys of the scan screen, and which of its actions change the rig."""

from __future__ import annotations

from textual.binding import Binding, BindingType

from tui.console.state.jog import FAST_FACTOR

CHANGES = frozenset(
    ("start", "pause", "resume", "preview", "expose", "adjust", "lamp")
    + ("jog", "hold", "home", "zero", "goto", "prescan", "use_proposal")
)

IN_PANES = frozenset(
    {
        *("scan.lamp", "scan.preview", "scan.expose", "scan.exposure", "scan.gain", "scan.black"),
        *("scan.jog_back", "scan.jog_on", "scan.fast_back", "scan.fast_on", "scan.hold_back", "scan.hold_on"),
        *("scan.finer", "scan.coarser", "scan.home", "scan.zero", "scan.goto"),
        *("scan.first", "scan.last", "scan.plan", "scan.mode", "scan.prescan", "scan.use_proposal", "scan.words"),
    }
)
BINDINGS: list[BindingType] = [
    Binding("s", "start", "start", id="scan.start", tooltip="start the sweep (asks for its name)"),
    Binding("p", "pause", "pause", id="scan.pause", tooltip="the stage holds, nothing is lost"),
    Binding("r", "resume", "resume", id="scan.resume", tooltip="go on with a paused sweep"),
    Binding("v", "preview", "preview", id="scan.preview", tooltip="camera pictures without a sweep, on or off"),
    Binding("L", "lamp", "lamp", id="scan.lamp", tooltip="lamp on or off"),
    Binding(
        "x", "expose", "expose", id="scan.expose", tooltip="find the exposure once, with the light over the specimen"
    ),
    Binding("e", "adjust('exposure_ms')", "exposure", id="scan.exposure", tooltip="change the exposure"),
    Binding("g", "adjust('gain')", "gain", id="scan.gain", tooltip="change the gain"),
    Binding("b", "adjust('brightness_percent')", "black", id="scan.black", tooltip="change the black level"),
    Binding("comma,left", "jog(-1)", "jog back", id="scan.jog_back", tooltip="one fine step back"),
    Binding("full_stop,right", "jog(1)", "jog on", id="scan.jog_on", tooltip="one fine step on"),
    Binding(
        "less_than_sign,shift+left",
        f"jog(-{FAST_FACTOR})",
        "fast back",
        id="scan.fast_back",
        tooltip="ten fine steps back",
    ),
    Binding(
        "greater_than_sign,shift+right",
        f"jog({FAST_FACTOR})",
        "fast on",
        id="scan.fast_on",
        tooltip="ten fine steps on",
    ),
    Binding("j", "hold(-1)", "held back", id="scan.hold_back", tooltip="move back while the key is held"),
    Binding("k", "hold(1)", "held on", id="scan.hold_on", tooltip="move on while the key is held"),
    Binding("left_square_bracket", "size(-1)", "finer", id="scan.finer", tooltip="smaller fine step"),
    Binding("right_square_bracket", "size(1)", "coarser", id="scan.coarser", tooltip="larger fine step"),
    Binding("h", "home", "home", id="scan.home", tooltip="find the zero of the stage"),
    Binding("z", "zero", "zero", id="scan.zero", tooltip="make this position the zero"),
    Binding("t", "goto", "go to", id="scan.goto", tooltip="move to a position"),
    Binding("f", "set_first", "first", id="scan.first", tooltip="first position from where the stage is"),
    Binding("l", "set_last", "last", id="scan.last", tooltip="last position from where the stage is"),
    Binding("n", "plan", "plan", id="scan.plan", tooltip="type first, last, steps per frame, settle, mode"),
    Binding("m", "mode", "mode", id="scan.mode", tooltip="stop for each frame, or trigger on the fly"),
    Binding("w", "prescan", "pre-scan", id="scan.prescan", tooltip="a quick look that proposes the bounds"),
    Binding("u", "use_proposal", "take over", id="scan.use_proposal", tooltip="take over what was proposed"),
    Binding("i", "words", "name", id="scan.words", tooltip="name, specimen, operator, notes, tags"),
    Binding("V", "picture", "picture", id="scan.picture", tooltip="half blocks, characters, or no picture"),
]
