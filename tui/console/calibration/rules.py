"""Which actions of the calibrate screen are possible in which situation, and why not; pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

LEAST_VIEWS = 3
CAMERA_GOAL = "Show the board flat and tilted to all sides, in all corners. Limit: 0.3 px."
PLANE_GOAL = "Sweep over the board flat, then tilted both ways: at least two poses. Limit: 1 um between them."
Pose = dict[str, Any]
"""Arguments of the command ``specimen``."""
POSES: tuple[Pose, ...] = tuple(
    {"tilt_x_deg": tilt_x, "tilt_y_deg": tilt_y, "moved_um": [x, y, 0.0]}
    for tilt_x, tilt_y, x, y in (
        (0.0, 0.0, 0.0, 0.0), (0.0, -14.0, 1100.0, 700.0), (0.0, 14.0, -1100.0, -700.0), (14.0, 0.0, -1100.0, 700.0),
        (-14.0, 0.0, 1100.0, -700.0), (10.0, 10.0, 0.0, 0.0), (-10.0, -10.0, 600.0, 0.0), (12.0, -9.0, -600.0, 0.0),
    )
)  # fmt: skip
"""Poses of the simulated board that cover the field and all tilts; the first is flat."""
PLANE_POSES: tuple[Pose, ...] = tuple(
    {"tilt_x_deg": tilt_x, "tilt_y_deg": 0.0, "moved_um": [0.0, 0.0, 0.0]} for tilt_x in (0.0, 12.0, -12.0)
)
"""Poses for sweeps: in the middle of the light, and tilted across its direction, so that all are equally bright."""


@dataclass(frozen=True)
class CalibrationSituation:
    """Everything that decides."""

    plane_step: bool
    """The second step, the light plane; else the camera."""
    sweep_runs: bool
    simulated: bool
    views: int
    """Captured so far."""
    sweeps: int
    """Calibration sweeps of the folder."""
    used: int
    """Those that are used."""
    has_camera: bool
    has_result: bool
    """This step has a result."""
    working: bool
    """A calibration is running."""


_Rule = tuple[frozenset[str], Callable[[CalibrationSituation], bool], str]
_RULES: tuple[_Rule, ...] = (
    (
        frozenset({"capture", "sweep", "pose", "object", "preview", "expose", "lamp", "goto"}),
        lambda s: s.sweep_runs,
        "a sweep is running",
    ),
    (frozenset({"pose", "object"}), lambda s: not s.simulated, "only on the simulated rig: place the board by hand"),
    (frozenset({"capture", "undo"}), lambda s: s.plane_step, "views belong to the first step: m goes there"),
    (frozenset({"sweep", "use"}), lambda s: not s.plane_step, "sweeps belong to the second step: m goes there"),
    (frozenset({"undo"}), lambda s: not s.views, "there is no view"),
    (frozenset({"use"}), lambda s: not s.sweeps, "there is no sweep"),
    (frozenset({"cancel"}), lambda s: not s.working, "nothing is running"),
    (frozenset({"result"}), lambda s: not s.has_result, "this step has no result yet"),
    (frozenset({"fit", "anew"}), lambda s: s.working, "a calibration is running: x cancels"),
    (
        frozenset({"fit"}),
        lambda s: not s.plane_step and s.views < LEAST_VIEWS,
        "at least three views are needed, eight are better",
    ),
    (frozenset({"fit"}), lambda s: s.plane_step and not s.has_camera, "calibrate the camera first: m goes there"),
    (frozenset({"fit"}), lambda s: s.plane_step and not s.used, "there is no sweep to use"),
)


def why_not(action: str, situation: CalibrationSituation) -> str:
    """Why ``action`` cannot be done now; empty if it can."""
    return next((words for actions, hinders, words in _RULES if action in actions and hinders(situation)), "")


def camera_hint(*, lamp_on: bool, views: int) -> str:
    """How the first view becomes a good one."""
    if not lamp_on:
        return "The lamp is off: L switches it on."
    return "" if views else "Views need even light: t moves the projector's edge off the board."


def plane_hint(used: int) -> str:
    """How the next sweep becomes a good one; ``used`` sweeps are used so far."""
    count = f"{used} sweep{'' if used == 1 else 's'} used."
    return f"{count} A tilt changes the brightness: e, then w, for each pose."
