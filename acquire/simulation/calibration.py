"""The exact calibration of the simulated rig, as the content of calibration.json."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from .scene import SimulatedScene


def ideal_calibration(
    scene: SimulatedScene,
    *,
    first_steps: int,
    steps_per_frame: int,
    count: int,
    parameter: Literal["position_um", "frame"] = "position_um",
) -> dict[str, Any]:
    """The content of calibration.json (docs/design.md, section 5) without any error, for JSON.

    Args:
        scene: the scene, of which only camera and projector matter. A rehoming error is not in the calibration.
        first_steps: position of frame 0 in microsteps.
        steps_per_frame: signed microsteps from one frame to the next.
        count: frames of the sweep.
        parameter: unit of t in corner(t) = origin + velocity t; ``frame`` is 1-based (t = frame_index + 1).
    """
    camera, projector = scene.camera, scene.projector
    # corner(t) of equation 15: at stage position 0 it is corner_mm, and it moves step_mm per microstep
    step, corner = np.array(projector.step_mm), np.array(projector.corner_mm)
    if parameter == "frame":
        velocity = step * steps_per_frame
        origin = corner + step * (first_steps - steps_per_frame)
    else:
        velocity, origin = step / scene.um_per_microstep, corner
    return {
        "format": "sweepscope-calibration",
        "version": 1,
        "camera": {
            "width": camera.width,
            "height": camera.height,
            "K": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            "R": camera.rotation.tolist(),
            "T": camera.translation.tolist(),
        },
        "light_plane": {
            "kind": "translating",
            "parameter": parameter,
            "edge": "rising" if steps_per_frame > 0 else "falling",
            "method": "auto",
            "normal": list(projector.normal),
            "corner_origin_mm": origin.tolist(),
            "corner_velocity_mm": velocity.tolist(),
            "velocity_direction": "corner-track",
        },
        "valid_for": {
            "first_steps": first_steps,
            "steps_per_frame": abs(steps_per_frame),
            "direction": 1 if steps_per_frame > 0 else -1,
            "frames": count,
        },
    }
