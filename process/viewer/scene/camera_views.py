"""The cameras of the browsers: the whole object at first, then left alone once a person has moved one."""

from __future__ import annotations

import contextlib
import itertools
import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import viser
from numpy.typing import NDArray

from acquire.contract.process.clocks import Clock, MonotonicClock
from process.viewer.rig_client.tile import BoundingBox

FOV_RAD = math.radians(40)
DIRECTION = np.array([0.35, -0.8, 0.65]) / np.linalg.norm([0.35, -0.8, 0.65])
"""From the object to the eye: from in front, above, a little aside."""
VIEWS: Final[dict[str, tuple[float, float, float]]] = {
    "Top": (0.0, -0.002, 1.0),  # straight down has no up
    "Front": (0.0, -1.0, 0.0),
    "Side": (1.0, 0.0, 0.0),
    "Iso": (0.577, -0.577, 0.577),
}
"""Named directions from the object to the eye."""
MARGIN = 1.12
ASPECT = 1.2
"""Width by height of the picture until the browser has sent its own."""
MIN_DISTANCE_MM = 0.01
GROWTH = 1.15
"""Views follow a growing cloud in steps of this factor."""
ECHO_NS = 1_500_000_000
"""A camera that a browser reports so soon after we set it may be our own setting coming back."""
TOUCHED = 0.01
"""A pose that differs by more than this part of the viewing distance was chosen by a person."""
DEFAULT_BOUNDS = BoundingBox((-6.0, -6.0, 0.0), (6.0, 6.0, 4.0))


@dataclass(frozen=True)
class CameraPose:
    """Eye and target in mm."""

    eye: NDArray[np.float64]
    target: NDArray[np.float64]

    @property
    def distance_mm(self) -> float:
        """From the eye to the target."""
        return float(np.linalg.norm(self.eye - self.target))

    def differs(self, other: CameraPose) -> bool:
        """True if a person moved the camera from the other pose to this one."""
        shift = max(float(np.linalg.norm(self.eye - other.eye)), float(np.linalg.norm(self.target - other.target)))
        return shift > TOUCHED * other.distance_mm


def overview(bounds: BoundingBox, direction: NDArray[np.float64] = DIRECTION, aspect: float = ASPECT) -> CameraPose:
    """The nearest pose along a unit ``direction`` from which all corners of the box are seen."""
    corners = np.array(list(itertools.product(*zip(bounds.low, bounds.high, strict=True)))) - bounds.centre
    right = np.cross(-direction, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, -direction)
    reach = np.maximum(np.abs(corners @ up), np.abs(corners @ right) / aspect)
    distance = float((MARGIN * reach / math.tan(FOV_RAD / 2) + corners @ direction).max())
    return CameraPose(bounds.centre + max(distance, MIN_DISTANCE_MM) * direction, bounds.centre)


def _aspect(client: viser.ClientHandle) -> float:
    """Width by height of a browser's picture, within what makes sense."""
    return min(4.0, max(0.25, float(getattr(client.camera, "aspect", ASPECT))))


@dataclass
class _BrowserCamera:
    set_to: CameraPose
    set_ns: int
    follows: bool = True
    direction: NDArray[np.float64] = field(default_factory=lambda: DIRECTION)


class CameraViews:
    """One camera per browser; follows the growing cloud until its person takes over."""

    def __init__(self, server: viser.ViserServer, clock: Clock | None = None) -> None:
        self._server = server
        self._clock = clock or MonotonicClock()
        self._bounds = DEFAULT_BOUNDS
        self._cameras: dict[int, _BrowserCamera] = {}
        self._set_initial(overview(self._bounds))
        server.on_client_connect(self._joined)
        server.on_client_disconnect(self._left)

    def follow(self, bounds: BoundingBox | None) -> None:
        """Show ``bounds`` to new browsers, and to those whose person has not moved the camera."""
        if bounds is None or not self._outgrown(bounds):
            return
        self._bounds = bounds
        self._set_initial(overview(bounds))
        for client_id, client in self._server.get_clients().items():
            known = self._cameras.get(client_id)
            if known is not None and known.follows:
                self._set(client, known)

    def fit(self, client: viser.ClientHandle, view: str = "") -> None:
        """Show one browser the whole object, from a named direction or the usual one, and let it follow again.

        Raises:
            KeyError: there is no view of that name.
        """
        known = self._cameras.setdefault(client.client_id, _BrowserCamera(overview(self._bounds), 0))
        direction = np.asarray(VIEWS[view] if view else DIRECTION, np.float64)
        known.follows, known.direction = True, direction / np.linalg.norm(direction)
        self._set(client, known)

    def _outgrown(self, bounds: BoundingBox) -> bool:
        old = self._bounds
        moved = float(np.linalg.norm(bounds.centre - old.centre)) > (GROWTH - 1) * old.radius_mm
        return moved or not old.radius_mm / GROWTH < bounds.radius_mm < old.radius_mm * GROWTH

    def _set_initial(self, pose: CameraPose) -> None:
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.fov = pose.eye, pose.target, FOV_RAD
        camera.near, camera.far = pose.distance_mm / 200, pose.distance_mm * 50

    def _set(self, client: viser.ClientHandle, known: _BrowserCamera) -> None:
        pose = overview(self._bounds, known.direction, _aspect(client))
        known.set_to, known.set_ns = pose, self._clock.now_ns()
        with contextlib.suppress(RuntimeError, AssertionError), client.atomic():
            client.camera.near, client.camera.far = pose.distance_mm / 200, pose.distance_mm * 50
            client.camera.position = pose.eye
            client.camera.look_at = pose.target

    async def _joined(self, client: viser.ClientHandle) -> None:
        known = self._cameras[client.client_id] = _BrowserCamera(overview(self._bounds), self._clock.now_ns())
        if _aspect(client) < ASPECT:
            self._set(client, known)  # a narrow window would cut the sides

        @client.camera.on_update
        async def _(camera: viser.CameraHandle) -> None:
            self._moved(client.client_id, CameraPose(np.asarray(camera.position), np.asarray(camera.look_at)))

    async def _left(self, client: viser.ClientHandle) -> None:
        self._cameras.pop(client.client_id, None)

    def _moved(self, client_id: int, pose: CameraPose) -> None:
        known = self._cameras.get(client_id)
        if known is not None and self._clock.now_ns() - known.set_ns > ECHO_NS and pose.differs(known.set_to):
            known.follows = False
