"""Simulated rig: scenes of objects under a swept plane of light, their pictures, truth and exact calibration."""

from .calibration import ideal_calibration
from .render import DEFAULT_CAMERA, CameraDefaults, Renderer
from .scene import SimulatedScene, build_scene
from .truth import Truth, truth, write_truth

__all__ = [
    "DEFAULT_CAMERA",
    "CameraDefaults",
    "Renderer",
    "SimulatedScene",
    "Truth",
    "build_scene",
    "ideal_calibration",
    "truth",
    "write_truth",
]
