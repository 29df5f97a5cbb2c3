"""The 3D scene: the cloud, the floor with its millimetres, the sheet of light, the rig, and the browsers' cameras."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import viser
from numpy.typing import NDArray

from acquire.contract.calibration import Calibration, load_calibration, parse_calibration
from acquire.contract.config.load import home_resolved
from acquire.contract.errors import SweepscopeError
from acquire.contract.messaging.messages import Status
from acquire.contract.process.clocks import Clock
from acquire.contract.scan_data.file_layout import read_layout
from acquire.contract.states import RUNNING_STATES
from acquire.contract.units import NS_PER_S, nice_length
from process.viewer.rig_client.feed import Snapshot, TileChanges
from process.viewer.rig_client.tile import BoundingBox
from process.viewer.server.guarded_server import GuardedServer
from process.viewer.status_html import SceneFacts
from process.viewer.stream.browser_stream import BrowserStreams
from process.viewer.stream.colouring import ViewSettings
from process.viewer.stream.point_nodes import PointNodes

from .camera_views import DEFAULT_BOUNDS, CameraViews
from .geometry import box_edges, camera_eye, field_of_view, light_at, sheet
from .rig_marks import RigMarks, travel_of

LIGHT_RGB = (255, 205, 80)
LIGHT_OPACITY = 0.15
CLIP_RGB = (120, 200, 255)
LOOK_AGAIN_NS = 2 * NS_PER_S
"""A scan file may not be there yet when its path is announced."""
LOOKS = 5


@dataclass(frozen=True)
class RigShown:
    """Which parts of the rig people want to see."""

    light: bool = True
    camera: bool = True
    stage: bool = True


class ViewerScene:
    """Brings changes into the scene, in turns that a browser can keep up with."""

    def __init__(self, server: GuardedServer, settings: ViewSettings, clock: Clock, calibration: str = "") -> None:
        """``calibration``: path of the rig's own, drawn before the first scan; may be empty."""
        self._server = server
        self._clock = clock
        self.nodes = PointNodes(settings)
        self.streams = BrowserStreams(server, self.nodes)
        self.camera_views = CameraViews(server, clock)
        self._marks = RigMarks(server)
        self._calibrations = CalibrationLookup(clock, calibration)
        self._field: BoundingBox | None = None
        self._light: tuple[viser.MeshHandle, viser.LineSegmentsHandle] | None = None
        self._light_at: tuple[object, ...] = ()
        self._floor_of: tuple[float, float, float, float] | None = None
        self.eye_mm: NDArray[np.float64] | None = None
        """Where the rig's camera is, shape [3] in mm; None without a calibration."""
        self._box: BoundingBox | None = None
        self._frame: viser.LineSegmentsHandle | None = None

    def show(
        self,
        snapshot: Snapshot,
        changes: TileChanges,
        image: NDArray[np.uint8] | None,
        shown: RigShown,
        opened: Path | None = None,
    ) -> None:
        """Take what changed, and move light, floor, camera and stage along; the streams bring the points.

        Args:
            snapshot: the state of the rig.
            changes: tiles that changed.
            image: the camera's newest picture; None if there is no new one.
            shown: which parts of the rig are drawn.
            opened: folder of an older scan that is shown instead of the rig's.
        """
        self.nodes.take(changes)
        calibration = self._calibrations.of(str(opened) if opened is not None else _path(snapshot))
        if opened is not None:
            snapshot = replace(snapshot, status=None)  # the rig is not where it was for that scan
        self.eye_mm = camera_eye(calibration.camera) if calibration is not None else None
        self._field = field_of_view(calibration.camera) if calibration is not None else None
        bounds = self._stage_set(snapshot.status)
        self.camera_views.follow(bounds)
        self._show_floor(bounds or DEFAULT_BOUNDS)
        self._show_light(snapshot, calibration if shown.light else None, bounds or DEFAULT_BOUNDS)
        self._show_rig(snapshot, calibration, image, shown)

    def _show_rig(
        self, snapshot: Snapshot, calibration: Calibration | None, image: NDArray[np.uint8] | None, shown: RigShown
    ) -> None:
        """The rig stands about the camera's field, which does not change while the cloud grows."""
        around, status = self._field or DEFAULT_BOUNDS, snapshot.status
        camera = calibration.camera if calibration is not None and shown.camera else None
        self._marks.show_camera(camera, around, image)
        travel = None
        if calibration is not None and status is not None and shown.stage:
            travel = travel_of(calibration, status, around)
        old = "" if snapshot.daemon.connected else " (old)"
        label = f"stage {status.position_um:,.1f} µm{old}" if status is not None else ""
        self._marks.show_travel(travel, around, label)

    def _stage_set(self, status: Status | None) -> BoundingBox | None:
        """What to look at: the camera's whole field while the cloud grows in it, afterwards the cloud."""
        cloud = self.nodes.bounds()
        if cloud is None or self._field is None or status is None or status.state not in RUNNING_STATES:
            return cloud or self._field
        return cloud.joined(self._field)

    def _show_floor(self, bounds: BoundingBox) -> None:
        cell_mm = nice_length(bounds.radius_mm / 8, above=True)
        section_mm = cell_mm * 5
        span_mm = section_mm * 2 * math.ceil(1.4 * bounds.radius_mm / section_mm)
        centre = np.round(bounds.centre / section_mm) * section_mm
        wanted = (cell_mm, span_mm, float(centre[0]), float(centre[1]))
        if wanted == self._floor_of:
            return
        self._floor_of = wanted
        self._server.scene.add_grid(
            "/floor",
            width=span_mm,
            height=span_mm,
            cell_size=cell_mm,
            section_size=section_mm,
            cell_color=(38, 45, 56),
            section_color=(62, 74, 92),
            position=(wanted[2], wanted[3], 0.0),
            fade_distance=span_mm * 4,
        )

    def apply(self, settings: ViewSettings, now_ns: int) -> None:
        """Colours, range, clipping as people want them now."""
        self.nodes.show(settings)
        self.nodes.settle(now_ns)
        if settings.box == self._box:
            return
        self._box = settings.box
        if self._frame is not None:
            self._frame.remove()
            self._frame = None
        if settings.box is not None:
            self._frame = self._server.scene.add_line_segments(
                "/clip", box_edges(settings.box), CLIP_RGB, thickness=1.2, thickness_units="screen"
            )

    @property
    def facts(self) -> SceneFacts:
        """What the page says about the drawing."""
        return SceneFacts(
            keep_one_of=self.nodes.fine,
            floor_cell_mm=self._floor_of[0] if self._floor_of is not None else 0.0,
            streams=tuple(self.streams.stats()),
        )

    def _show_light(self, snapshot: Snapshot, calibration: Calibration | None, bounds: BoundingBox) -> None:
        status = snapshot.status
        at = (status.position_um, id(calibration), bounds, snapshot.daemon.connected) if status is not None else ()
        if at == self._light_at:
            return
        self._light_at = at
        plane = None
        if status is not None and calibration is not None and snapshot.daemon.connected:
            plane = light_at(calibration, status.plan, status.position_steps, status.position_um)
        corners = sheet(*plane, bounds) if plane is not None else None
        if corners is None:
            for node in self._light or ():
                node.remove()
            self._light = None
            return
        vertices = corners.astype(np.float32)
        rim = np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)
        if self._light is None:
            self._light = self._make_light(vertices, rim)
        self._light[0].vertices, self._light[1].points = vertices, rim

    def _make_light(
        self, vertices: NDArray[np.float32], rim: NDArray[np.float32]
    ) -> tuple[viser.MeshHandle, viser.LineSegmentsHandle]:
        pane = self._server.scene.add_mesh_simple(
            "/light/pane",
            vertices=vertices,
            faces=np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
            color=LIGHT_RGB,
            opacity=LIGHT_OPACITY,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        return pane, self._server.scene.add_line_segments(
            "/light/rim", rim, LIGHT_RGB, thickness=1.5, thickness_units="screen"
        )


class CalibrationLookup:
    """The calibration that the shown scan keeps in its file; looked up once per scan, a few times if not yet there."""

    def __init__(self, clock: Clock, before: str = "") -> None:
        """``before``: path of the calibration that holds before any scan; may be empty."""
        self._clock = clock
        self._path = ""
        self._found: Calibration | None = None
        if before:
            with contextlib.suppress(SweepscopeError):  # the services that need it report what is wrong with it
                self._found, _ = load_calibration(home_resolved(before, "reconstruct.calibration"))
        self._looks_left = 0
        self._next_ns = 0

    def of(self, scan_path: str) -> Calibration | None:
        """The calibration of a scan; None where there is none or it cannot be read. An empty path: the last one."""
        if not scan_path:
            return self._found
        now_ns = self._clock.now_ns()
        if scan_path != self._path:
            self._path, self._found, self._looks_left, self._next_ns = scan_path, None, LOOKS, now_ns
        if self._found is None and self._looks_left and now_ns >= self._next_ns:
            self._looks_left -= 1
            self._next_ns = now_ns + LOOK_AGAIN_NS
            self._found = _read_calibration(Path(self._path))
        return self._found


def _path(snapshot: Snapshot) -> str:
    return snapshot.status.scan_path if snapshot.status is not None else ""


def _read_calibration(scan: Path) -> Calibration | None:
    try:
        text = read_layout(scan).verbatim["calibration"]
        return parse_calibration(text.decode()) if text.strip() else None
    except (SweepscopeError, OSError, UnicodeDecodeError):
        return None  # only the drawing of the light needs it; the worker is the one who refuses
