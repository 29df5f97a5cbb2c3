"""Boards as a pinhole camera with distortion sees them, and sweeps of a plane of light over them: drawn, not rendered.

Quick, exact, and free to be wrong in ways that the simulated rig is not: bent surfaces, mirrored boards, a gamma.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from acquire.contract.calibration import CameraModel
from acquire.contract.messaging.messages import FrameFormat, Image
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.states import Outcome
from acquire.writer.create_file import ScanRecipe
from acquire.writer.scan_file import _create_in
from process.calibration.board.detection import Board

DARK, LIGHT = 0.06, 0.82
"""Albedo of black and white."""
FINE = 2
_AT = np.linspace(-6, 6, 2401)
_NORMAL_CDF = np.array([0.5 * math.erfc(-x * math.sqrt(0.5)) for x in _AT])


@dataclass(frozen=True)
class Pinhole:
    """A camera near its board, so that small pictures tell poses well."""

    size: tuple[int, int] = (320, 240)
    focal: tuple[float, float] = (950.0, 948.0)
    centre: tuple[float, float] = (166.0, 114.0)
    k1: float = -0.1
    distance_mm: float = 20.0

    @property
    def matrix(self) -> np.ndarray:
        return np.array([[self.focal[0], 0, self.centre[0]], [0, self.focal[1], self.centre[1]], [0, 0, 1.0]])

    @property
    def distortion(self) -> np.ndarray:
        return np.array([self.k1, 0.0, 0.0, 0.0, 0.0])

    def model(self) -> CameraModel:
        """Looking down on z = 0; the axis meets it at the world's origin."""
        return CameraModel(
            width=self.size[0],
            height=self.size[1],
            K=tuple(map(tuple, self.matrix)),
            R=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
            T=(0.0, 0.0, self.distance_mm),
            distortion=tuple(self.distortion),
        )

    @lru_cache(maxsize=4)  # noqa: B019 - a handful of cameras
    def rays(self, fine: int = 1) -> np.ndarray:
        """[fine h, fine w, 3] in camera coordinates, z = 1."""
        width, height = self.size
        x, y = np.meshgrid((np.arange(width * fine) + 0.5) / fine - 0.5, (np.arange(height * fine) + 0.5) / fine - 0.5)
        places = np.stack([x.ravel(), y.ravel()], axis=1).reshape(-1, 1, 2)
        flat = cv2.undistortPoints(places, self.matrix, self.distortion).reshape(height * fine, width * fine, 2)
        return np.concatenate([flat, np.ones_like(flat[..., :1])], axis=2)


PINHOLE = Pinhole()
Height = Callable[[np.ndarray], np.ndarray]
"""mm above the board's plane, of board coordinates [.., 2]."""


def bulge(bend_mm: float) -> Height:
    """A parabola: so much higher in the middle than a millimetre from it."""
    return lambda at: bend_mm * (1 - (at**2).sum(axis=-1))


def caps(spheres: list[tuple[float, float, float]], above_mm: float) -> Height:
    """Spheres (x, y, radius) whose tops are ``above_mm`` over the plane; the plane elsewhere."""

    def height(at: np.ndarray) -> np.ndarray:
        found = np.zeros(at.shape[:-1])
        for x, y, radius in spheres:
            inside = np.maximum(radius**2 - (at[..., 0] - x) ** 2 - (at[..., 1] - y) ** 2, 0)
            found = np.maximum(found, np.sqrt(inside) - radius + above_mm)
        return found

    return height


def turned(tilt_x_deg: float, tilt_y_deg: float, yaw_deg: float = 3.0) -> np.ndarray:
    """Rotation from the board to the camera of a board that lies before it, tilted."""
    return cv2.Rodrigues(np.radians([tilt_x_deg, tilt_y_deg, yaw_deg]))[0] @ np.diag([1.0, -1.0, -1.0])


def where(
    rotation: np.ndarray, shift: np.ndarray, camera: Pinhole = PINHOLE, fine: int = 1, height: Height | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Board coordinates [.., 2] and camera coordinates [.., 3] of what each pixel sees; ``height`` of the surface."""
    directions = camera.rays(fine)
    normal = rotation[:, 2]
    seen = directions * (normal @ shift / (directions @ normal))[..., None]
    for _ in range(12 if height else 0):
        lift = height(((seen - shift) @ rotation)[..., :2])
        seen = directions * ((normal @ shift + lift) / (directions @ normal))[..., None]
    return ((seen - shift) @ rotation)[..., :2], seen


def chessboard(board: Board) -> Callable[[np.ndarray], np.ndarray]:
    """Albedo of board coordinates."""

    def albedo(at: np.ndarray) -> np.ndarray:
        cells = np.floor(at / board.pitch_mm + np.array([board.columns / 2, board.rows / 2]))
        inside = ((cells >= 0) & (cells < [board.columns, board.rows])).all(axis=-1)
        return np.where(inside & (cells.sum(axis=-1) % 2 == 0), DARK, LIGHT)

    return albedo


def dots(board: Board) -> Callable[[np.ndarray], np.ndarray]:
    """Black dots of half the pitch on white."""

    def albedo(at: np.ndarray) -> np.ndarray:
        cells = at / board.pitch_mm + (np.array([board.columns, board.rows]) - 1) / 2
        nearest = np.clip(np.rint(cells), 0, [board.columns - 1, board.rows - 1])
        return np.where(np.linalg.norm(cells - nearest, axis=-1) < 0.27, DARK, LIGHT)

    return albedo


def charuco(
    board: Board, dictionary: int = cv2.aruco.DICT_4X4_1000, *, legacy: bool = False, marker_share: float = 0.75
) -> Callable[[np.ndarray], np.ndarray]:
    """OpenCV's ChArUco board, its y axis up."""
    markers = cv2.aruco.getPredefinedDictionary(dictionary)
    pattern = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.pitch_mm, marker_share * board.pitch_mm, markers
    )
    pattern.setLegacyPattern(legacy)
    per_square = 64
    drawn = pattern.generateImage((board.columns * per_square, board.rows * per_square), marginSize=0)

    def albedo(at: np.ndarray) -> np.ndarray:
        cells = at * [1, -1] / board.pitch_mm + np.array([board.columns / 2, board.rows / 2])
        inside = ((cells >= 0) & (cells < [board.columns, board.rows])).all(axis=-1)
        index = np.clip((cells * per_square).astype(int), 0, [drawn.shape[1] - 1, drawn.shape[0] - 1])
        return np.where(inside & (drawn[index[..., 1], index[..., 0]] < 128), DARK, LIGHT)

    return albedo


def photograph(
    albedo: Callable[[np.ndarray], np.ndarray],
    rotation: np.ndarray,
    shift: np.ndarray,
    *,
    camera: Pinhole = PINHOLE,
    blur_px: float = 0.9,
    noise: float = 1.5,
    uneven: tuple[float, float] = (0.6, 1.1),
    seed: int = 1,
) -> np.ndarray:
    """The board by room light: drawn fine, made coarse, blurred, unevenly lit from left to right, noisy; 8 bit."""
    soft = _soft(albedo(where(rotation, shift, camera, FINE)[0]), camera, blur_px)
    lit = 220 * soft * np.linspace(*uneven, camera.size[0])
    return np.clip(lit + np.random.default_rng(seed).normal(0, noise, lit.shape), 0, 255).round().astype(np.uint8)


def _soft(fine: np.ndarray, camera: Pinhole, blur_px: float) -> np.ndarray:
    coarse = cv2.resize(fine, camera.size, interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(coarse, (0, 0), blur_px) if blur_px else coarse


@dataclass(frozen=True)
class Light:
    """A plane of light t = a . X + b in world coordinates, t the 0-based frame index, and how it looks."""

    a: tuple[float, float, float] = (10.0, 0.0, 16.0)
    b: float = 45.0
    width_frames: float = 2.0
    room: float = 0.35
    leak: float = 0.0
    """Share of the lamp that reaches everything at all times."""
    lamp: float = 200.0
    """Counts of 8 bit on white."""


def sweep(
    folder: Path,
    albedo: Callable[[np.ndarray], np.ndarray],
    rotation: np.ndarray,
    shift: np.ndarray,
    *,
    light: Light = Light(),  # noqa: B008 - frozen
    camera: Pinhole = PINHOLE,
    frames: int = 90,
    height: Height | None = None,
    noise: float = 1.0,
    gamma: float = 1.0,
    seed: int = 1,
) -> Path:
    """A sealed scan of a sweep over a board; positions in um are 10 x the frame index."""
    model = camera.model()
    seen = where(rotation, shift, camera, 1, height)[1]
    world = (seen - np.array(model.T)) @ np.array(model.R)
    crossing = world @ np.array(light.a) + light.b
    soft = _soft(albedo(where(rotation, shift, camera, FINE, height)[0]), camera, 0.9)
    plan = SweepPlan(first_steps=0, last_steps=10 * (frames - 1), steps_per_frame=10, um_per_microstep=1.0)
    form = FrameFormat(*camera.size, 8, "mono")
    recipe = ScanRecipe("b" * 32, form, frames, plan=plan, start_time_utc="2026-01-01T00:00:00Z")
    generator = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    with closing(_create_in(folder.absolute(), recipe)) as scan:
        for index in range(frames):
            share = light.room + light.leak + np.interp((index - crossing) / light.width_frames, _AT, _NORMAL_CDF)
            counts = 255 * np.clip(light.lamp * soft * share / 255, 0, None) ** gamma
            pixels = np.clip(counts + generator.normal(0, noise, counts.shape), 0, 255).round().astype(np.uint8)
            scan.write_frame(_header(form, index, pixels), pixels)
        scan.seal(Outcome.COMPLETE, "")
    return folder


def _header(form: FrameFormat, index: int, pixels: np.ndarray) -> Image:
    return Image(
        frame_index=index,
        position_steps=10 * index,
        position_um=10.0 * index,
        shape=list(form.shape),
        dtype=form.dtype,
        bit_depth=8,
        pixel_format="mono",
        crc32=frame_crc32(pixels),
    )
