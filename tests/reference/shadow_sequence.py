"""A drawn room with a floor and a wall, over which the shadow of a stick travels: pictures, camera and planes' file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

LAMP_MM = np.array([330.0, -650.0, 900.0])
WIDTH_DEG = 3.0
"""Width of the stick's shadow, seen from the lamp."""
RECTANGLE_MM = (400.0, 200.0)


@dataclass
class Room:
    """A scene of w x h pixels, frames 1 to n; ``angle`` turns a frame index into where the shadow's front is."""

    size: tuple[int, int] = (256, 192)
    frames: int = 40
    angle: Callable[[int], float] = lambda index: -20.0 + 1.0 * index
    lit: float = 200.0
    dark: float = 90.0
    noise: float = 1.0
    gain: Callable[[int], float] = lambda index: 1.0
    spoil: Callable[[int, np.ndarray], None] = lambda index, picture: None

    @property
    def camera(self) -> dict:
        w, h = self.size
        matrix = [[2.0 * w, 0, w / 2], [0, 2.0 * w, h / 2], [0, 0, 1]]
        eye = np.eye(3).tolist()
        return {"width": w, "height": h, "K": matrix, "distortion": [-0.1, 0, 0, 0, 0], "R": eye, "T": [0, 0, 0]}

    @property
    def surfaces(self) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Origin of the markers, and both directions, of each plane."""
        down = np.array([0.0, 0.8, -0.6])  # along the floor, towards the camera
        up = np.array([0.0, -0.8, -0.6])  # along the wall
        across, edge = np.array([1.0, 0, 0]), np.array([-200.0, 40.0, 1900.0])
        return {"wall": (edge + 30 * up, across, up), "floor": (edge + 30 * down, across, down)}

    def planes(self) -> dict:
        """The planes' file."""
        w, h = self.size
        regions = {"wall": [0.2, 0.8, 0.04, 0.4], "floor": [0.15, 0.85, 0.72, 0.98]}
        found: dict = {"marker_rectangle_mm": list(RECTANGLE_MM)}
        for name, (start, across, along) in self.surfaces.items():
            a, b = RECTANGLE_MM
            corners = np.array([start, start + a * across, start + a * across + b * along, start + b * along])
            pixels = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), *self._lens())[0].reshape(-1, 2)
            x0, x1, y0, y1 = regions[name]
            region = [round(x0 * w), round(x1 * w), round(y0 * h), round(y1 * h)]
            found[name] = {"marker_corners_px": pixels.tolist(), "image_region_px": region}
        return {"reference_planes": found}

    def _lens(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array(self.camera["K"], float), np.array(self.camera["distortion"], float)

    def points(self) -> np.ndarray:
        """[h, w, 3] the nearer of floor and wall that a pixel sees."""
        w, h = self.size
        x, y = np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float))
        flat = cv2.undistortPoints(np.stack([x.ravel(), y.ravel()], 1).reshape(-1, 1, 2), *self._lens()).reshape(-1, 2)
        rays = np.column_stack([flat, np.ones(len(flat))])
        depth = np.full(len(rays), np.inf)
        for start, across, along in self.surfaces.values():
            normal = np.cross(across, along)
            with np.errstate(divide="ignore", invalid="ignore"):
                here = (normal @ start) / (rays @ normal)
            # both planes are seen from inside the corner: the nearer one hides the other
            depth = np.minimum(depth, np.where(here > 0, here, np.inf))
        return (rays * depth[:, None]).reshape(h, w, 3)

    def light_plane(self, index: int, edge: str = "falling") -> np.ndarray:
        """[4] normal and offset of the plane at the shadow's front (falling) or end (rising)."""
        turn = np.radians(self.angle(index) - (WIDTH_DEG if edge == "rising" else 0.0))
        aim = np.array([0.0, 150.0, 1800.0]) - LAMP_MM
        aim /= np.linalg.norm(aim)
        # a hand turns the stick a little, too
        stick = np.array([-0.25 + 0.006 * self.angle(index), 0.9, 0.35])
        side = np.cross(aim, stick)
        side /= np.linalg.norm(side)
        front = np.cos(turn) * aim + np.sin(turn) * side
        normal = np.cross(stick, front)
        normal /= np.linalg.norm(normal)
        return np.array([*normal, normal @ LAMP_MM])

    def pictures(self) -> list[np.ndarray]:
        """uint8 [h, w] of each frame."""
        places, generator = self.points(), np.random.default_rng(3)
        found = []
        for index in range(self.frames):
            ahead = self._beside(places, self.light_plane(index))
            behind = self._beside(places, self.light_plane(index, "rising"))
            share = np.maximum(ahead, 1 - behind)
            level = self.dark + (self.lit - self.dark) * share
            self.spoil(index, level)
            level = level * self.gain(index) + generator.normal(0, self.noise, level.shape)
            found.append(np.clip(np.round(level), 0, 255).astype(np.uint8))
        return found

    @staticmethod
    def _beside(places: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """0 to 1 across the edge, 6 mm wide, 1 on the side that the shadow moves to."""
        gap = places @ plane[:3] - plane[3]
        return 1 / (1 + np.exp(np.clip(gap / 2.0, -40, 40)))

    def write(self, folder: Path) -> Path:
        """frames/, camera.json and planes.json in ``folder``, which is returned."""
        (folder / "frames").mkdir(parents=True)
        for index, picture in enumerate(self.pictures()):
            cv2.imwrite(str(folder / "frames" / f"{index + 1:04}.png"), picture)
        calibration = {"format": "sweepscope-calibration", "version": 1, "camera": self.camera}
        (folder / "camera.json").write_text(json.dumps(calibration))
        (folder / "planes.json").write_text(json.dumps(self.planes()))
        return folder
