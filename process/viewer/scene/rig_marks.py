"""The rig in the scene: the camera with its newest picture, the travel of the stage, and where it is now."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
import viser.transforms as tf
from numpy.typing import NDArray

from acquire.contract.calibration import Calibration, CameraModel, TranslatingPlane
from acquire.contract.messaging.messages import Status
from process.viewer.rig_client.tile import BoundingBox

from .geometry import camera_eye, sweep_coordinate

CAMERA_RGB = (150, 165, 185)
RAIL_RGB = (120, 132, 150)
SWEEP_RGB = (255, 205, 80)
STAGE_RGB = (88, 183, 255)
HANGS = 3.0
"""The picture hangs so many radii over the object, between it and the camera."""
ASIDE = 0.35
"""The travel is drawn so many radii beside the field."""
STAGE_SHARE = 0.05
"""Side of the stage's mark as a part of the radius."""
STANDING_MM = 1e-9


@dataclass(frozen=True)
class Travel:
    """Where the light's corner goes, moved beside the field: points in mm, shape [3] each."""

    limits: NDArray[np.float64]
    """Shape [2, 3], at the soft limits."""
    sweep: NDArray[np.float64] | None
    """Shape [2, 3], from the first frame to the last; None without a plan."""
    now: NDArray[np.float64]
    """Shape [3]."""


def travel_of(calibration: Calibration, status: Status, bounds: BoundingBox) -> Travel | None:
    """The travel of the stage in the scene; None where the calibration does not tell its direction."""
    light, plan = calibration.light_plane, status.plan
    if not isinstance(light, TranslatingPlane):
        return None
    velocity = np.asarray(light.corner_velocity_mm)
    per_step = _units_per_step(light, status)
    if per_step is None or float(np.linalg.norm(velocity[:2])) < STANDING_MM:
        return None
    step_mm, now_steps = velocity * per_step, status.position_steps
    corner = _corner(light, status)
    now_mm = (corner + _beside(corner, velocity, bounds)) * (1.0, 1.0, 0.0)

    def at(*steps: float) -> NDArray[np.float64]:
        return np.array([now_mm + step_mm * (one - now_steps) * (1.0, 1.0, 0.0) for one in steps])

    sweep = at(plan.first_steps, plan.last_steps) if plan is not None else None
    return Travel(at(*status.travel_steps), sweep, now_mm)


def _units_per_step(light: TranslatingPlane, status: Status) -> float | None:
    """Units of the plane's parameter for one microstep."""
    if light.parameter == "frame":
        return 1.0 / status.plan.pitch_steps if status.plan is not None else None
    if status.position_steps:
        return status.position_um / status.position_steps
    return status.plan.um_per_microstep if status.plan is not None else None


def _corner(light: TranslatingPlane, status: Status) -> NDArray[np.float64]:
    """The corner of the pattern now, mm; a plane by frame needs the plan."""
    t = sweep_coordinate(light.parameter, status.plan, status.position_steps, status.position_um)
    assert t is not None
    place: NDArray[np.float64] = np.asarray(light.corner_origin_mm) + np.asarray(light.corner_velocity_mm) * t
    return place


def _beside(corner: NDArray[np.float64], velocity: NDArray[np.float64], bounds: BoundingBox) -> NDArray[np.float64]:
    """Shift, shape [3], that brings the corner's line beside the box, toward the viewer."""
    along = velocity[:2] / np.linalg.norm(velocity[:2])
    across = np.array([along[1], -along[0]])
    if across[1] > 0:
        across = -across
    half = np.abs(across) @ (np.asarray(bounds.high[:2]) - np.asarray(bounds.low[:2])) / 2
    shift = bounds.centre[:2] @ across + half + ASIDE * bounds.radius_mm - corner[:2] @ across
    return np.array([*(across * shift), 0.0])


class RigMarks:
    """Draws camera and travel; touches only what changed."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._scene = server.scene
        self._camera: viser.CameraFrustumHandle | None = None
        self._camera_of: tuple[object, ...] = ()
        self._rails: list[viser.LineSegmentsHandle] = []
        self._rails_of: tuple[object, ...] = ()
        self._stage: Any = None
        self._stage_of: tuple[object, ...] = ()

    def show_camera(self, camera: CameraModel | None, bounds: BoundingBox, image: NDArray[np.uint8] | None) -> None:
        """The frustum from the pinhole to the picture that hangs over the object; a new ``image`` replaces the old."""
        wanted = (camera, bounds) if camera is not None else ()
        if wanted != self._camera_of:
            self._camera_of = wanted
            if self._camera is not None:
                self._camera.remove()
            self._camera = self._make_camera(camera, bounds) if camera is not None else None
        if image is not None and self._camera is not None:
            self._camera.image = image if image.ndim == 3 else np.repeat(image[:, :, None], 3, axis=2)

    def _make_camera(self, camera: CameraModel, bounds: BoundingBox) -> viser.CameraFrustumHandle:
        eye, rotation = camera_eye(camera), np.asarray(camera.R)
        focal = camera.K[1][1]
        handle = self._scene.add_camera_frustum(
            "/rig/camera",
            fov=2 * math.atan(camera.height / (2 * focal)),
            aspect=camera.width / camera.height * focal / camera.K[0][0],
            color=CAMERA_RGB,
            thickness=1.2,
            thickness_units="screen",
            format="jpeg",
            jpeg_quality=70,
            wxyz=tf.SO3.from_matrix(rotation.T).wxyz,
            position=eye,
            cast_shadow=False,
            receive_shadow=False,
        )
        far = float(np.linalg.norm(bounds.centre - eye))
        depth = max(0.2 * far, far - HANGS * bounds.radius_mm)
        handle.scale = depth / handle.compute_canonical_frustum_size()[2]
        return handle

    def show_travel(self, travel: Travel | None, bounds: BoundingBox, label: str) -> None:
        """The line between the limits, the part that is swept, and the stage on it."""
        rails = (travel.limits.tobytes(), travel.sweep.tobytes() if travel.sweep is not None else b"") if travel else ()
        if rails != self._rails_of:
            self._rails_of = rails
            for rail in self._rails:
                rail.remove()
            self._rails = self._make_rails(travel) if travel is not None else []
        stage = (travel.now.tobytes(), bounds, label) if travel is not None else ()
        if stage != self._stage_of:
            self._stage_of = stage
            self._move_stage(travel, bounds, label)

    def _make_rails(self, travel: Travel) -> list[viser.LineSegmentsHandle]:
        lines = [("limits", travel.limits, RAIL_RGB, 1.5)]
        if travel.sweep is not None:
            lines.append(("sweep", travel.sweep, SWEEP_RGB, 3.0))
        return [
            self._scene.add_line_segments(
                f"/rig/{name}", ends[None].astype(np.float32), colour, thickness=width, thickness_units="screen"
            )
            for name, ends, colour, width in lines
        ]

    def _move_stage(self, travel: Travel | None, bounds: BoundingBox, label: str) -> None:
        if self._stage is not None and travel is None:
            for node in self._stage:
                node.remove()
            self._stage = None
        if travel is None:
            return
        side = STAGE_SHARE * bounds.radius_mm
        if self._stage is None:
            box = self._scene.add_box(
                "/rig/stage", color=STAGE_RGB, dimensions=(side, side, side), cast_shadow=False, receive_shadow=False
            )
            self._stage = (box, self._scene.add_label("/rig/stage_label", label, anchor="top-center"))
        box, text = self._stage
        box.dimensions = (side, side, side)
        box.position = travel.now
        text.position = travel.now
        if text.text != label:
            text.text = label
