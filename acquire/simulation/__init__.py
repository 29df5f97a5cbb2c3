"""Optics and objects of the simulated rig: scenes, pictures, their truth and their exact calibration."""

from .calibration import ideal_calibration
from .render import DEFAULT_CAMERA, CameraDefaults, Renderer
from .scene import Scene, build_scene
from .truth import Truth, truth, write_truth

__all__ = [
    "DEFAULT_CAMERA",
    "CameraDefaults",
    "Renderer",
    "Scene",
    "Truth",
    "build_scene",
    "ideal_calibration",
    "truth",
    "write_truth",
]
