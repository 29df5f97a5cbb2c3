"""Import of the original program's files, projector.txt and calibration.txt, into our conventions.

The paper's equations 1 and 2 have R, T from world to camera, as OpenCV and we do; its listings, and the printed K, R, T
and corner(t) (equations 11 to 15), have them from camera to world: u = T, v = R K^-1 p'. The camera is converted so
that points come out the same. The original's world is left-handed, with the stage behind the pinhole: ``mirrored``. Its
distortion is k1 k2 p1 p2; t is the 1-based frame number; lengths in mm.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from acquire.contract.files import read_bytes
from process.calibration.quarter_circle.optics import Slide, plane_normal

F8 = NDArray[np.float64]
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
CALIBRATION_COUNTS = (9, 4, 9, 3)
MAX_FILE_BYTES = 1_000_000
ROTATION_TOLERANCE = 2e-3


@dataclass(frozen=True)
class OriginalCalibration:
    """calibration.txt, as it stands."""

    matrix: F8
    distortion: F8
    """k1 k2 p1 p2."""
    rotation: F8
    """Camera to world."""
    translation: F8
    """Position of the camera in the world, mm."""
    corner: F8 | None
    """The projector's corner translation, mm; None where it is not in the file."""
    focus: F8 | None
    """The focal point's translation from the corner, mm."""

    def camera(self, width: int, height: int) -> dict[str, Any]:
        """The ``camera`` object of calibration.json: world to camera."""
        rotation = self.rotation.T
        behind = bool(self.translation[2] * self.rotation[2, 2] > 0)
        return {
            "width": width,
            "height": height,
            "K": self.matrix.tolist(),
            "distortion": [*self.distortion.tolist(), 0.0],
            "R": rotation.tolist(),
            # printed with four digits R is not quite orthogonal: this T puts the pinhole where the original has it
            "T": (-np.linalg.solve(rotation.T, self.translation)).tolist(),
            "mirrored": behind,
        }


@dataclass(frozen=True)
class ProjectorClicks:
    """projector.txt: what was clicked, in pixels."""

    first: F8
    """[2] corner in the first frame."""
    last: F8
    """[2] corner in the last frame."""
    last_frame: int
    """Its 1-based number."""
    pattern: F8
    """[3, 2]: 9 o'clock, centre, 6 o'clock."""


def read_calibration_txt(path: Path) -> OriginalCalibration:
    """The labelled blocks of calibration.txt, in their order.

    Raises:
        CalibrationError: the file is missing, a block has too few numbers, or the rotation is none.
    """
    blocks = _blocks(_text(path))
    names = ("K", "distortion", "rotation", "translation")
    if len(blocks) < len(names):
        missing = names[len(blocks)]
        raise CalibrationError(f"{path} ends before its {missing}: it is no calibration of the original program")
    for name, wanted, block in zip(names, CALIBRATION_COUNTS, blocks, strict=False):
        if len(block) != wanted:
            raise CalibrationError(f"{path}: {name} has {len(block)} numbers, it takes {wanted}")
    for name, block in zip(("corner", "focal point"), blocks[4:6], strict=False):
        if len(block) != 3:
            raise CalibrationError(f"{path}: the {name} translation has {len(block)} numbers, it takes 3")
    rotation = blocks[2].reshape(3, 3)
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > ROTATION_TOLERANCE:
        raise CalibrationError(f"{path}: the rotation is none (R R^T differs from 1 by {error:.2g})")
    optional = [*blocks[4:6], None, None]
    return OriginalCalibration(blocks[0].reshape(3, 3), blocks[1], rotation, blocks[3], optional[0], optional[1])


def read_projector_txt(path: Path) -> ProjectorClicks:
    """The clicked corners of projector.txt.

    Raises:
        CalibrationError: the file or a line is missing.
    """
    text = _text(path)
    frames = re.findall(r"Frame\s+(\d+)\s*:?\s+(\S+)\s+(\S+)", text)
    pattern = re.search(r"Calibration\s+Corners\s*:?(.*)", text, re.DOTALL)
    numbers = _NUMBER.findall(pattern.group(1)) if pattern else []
    if len(frames) < 2 or len(numbers) < 6:
        raise CalibrationError(f"{path} lacks {'the frames' if len(frames) < 2 else 'the calibration corners'}")
    try:
        places = [(int(number), float(x), float(y)) for number, x, y in frames]
        corners = np.array([float(value) for value in numbers[:6]]).reshape(3, 2)
    except ValueError:
        raise CalibrationError(f"{path} holds something that is no number") from None
    return ProjectorClicks(np.array(places[0][1:]), np.array(places[-1][1:]), places[-1][0], corners)


def light_plane(original: OriginalCalibration, clicks: ProjectorClicks) -> dict[str, Any]:
    """The ``light_plane`` object: normal by equations 5 to 10, corner(t) through the two clicked corners.

    Raises:
        CalibrationError: impossible geometry (hp / d > 1, which the original inverts silently), with the numbers.
    """
    first, last, nine, centre, six = _on_stage(original, np.vstack([clicks.first, clicks.last, clicks.pattern]))
    velocity = (last - first) / max(clicks.last_frame - 1, 1)
    normal = pattern_normal(nine, centre, six, velocity)
    return {
        "kind": "translating",
        "parameter": "frame",
        "edge": "rising",
        "method": "linear",
        "normal": normal.tolist(),
        "corner_origin_mm": (first - velocity).tolist(),
        "corner_velocity_mm": velocity.tolist(),
        "velocity_direction": "corner-track",
        "quality": {"source": "original program: two clicked corners and three of the pattern"},
    }


def pattern_normal(p1: F8, corner: F8, p2: F8, velocity: F8) -> F8:
    """Normal of the leading light plane from the three corners of the quarter circle on z = 0 (equations 5 to 10).

    As the original computes it: both edges lead away from the projector (equation 6), and e3 = e1 x e2 (equation 7c).

    Args:
        p1: end of the other straight edge (9 o'clock), [3] mm.
        corner: the corner c, [3] mm.
        p2: end of the leading edge (6 o'clock), [3] mm.
        velocity: of the corner, [3]; the normal points along it.

    Raises:
        CalibrationError: a projected edge shorter than the optics allow.
    """
    slide, side, lead = Slide(), p1 - corner, p2 - corner
    lengths = [float(np.linalg.norm(edge)) for edge in (lead, side)]
    turns = (slide.turns(lengths[0], "edge to 6 o'clock")[0], slide.turns(lengths[1], "edge to 9 o'clock")[0])
    return plane_normal(lead, side, turns, velocity, up=np.cross(side / lengths[1], lead / lengths[0]))


def _on_stage(original: OriginalCalibration, pixels: F8) -> F8:
    """Points [n, 3] of the original's own rays on z = 0 (its convention: u = T, v = R K^-1 p')."""
    directions = np.linalg.solve(original.matrix, np.column_stack([pixels, np.ones(len(pixels))]).T).T
    directions = directions @ original.rotation.T
    distance = -original.translation[2] / directions[:, 2]
    return np.asarray(original.translation + distance[:, None] * directions, dtype=np.float64)


def _text(path: Path) -> str:
    try:
        return read_bytes(path, MAX_FILE_BYTES).decode("latin-1")
    except ValueError as error:
        raise CalibrationError(f"{path} is no file of the original program: {error}") from None
    except OSError as error:
        raise CalibrationError(f"cannot read {path}: {error.strerror}") from None


def _blocks(text: str) -> list[F8]:
    """Runs of numbers between labels; numbers within a label (such as its unit) do not count."""
    blocks: list[list[float]] = []
    fresh = True
    for line in text.splitlines():
        label, colon, rest = line.rpartition(":")
        words = rest if colon else line
        if colon or re.search(r"[A-Za-df-z]", line):
            fresh = True
            if not colon:
                continue
        numbers = [float(value) for value in _NUMBER.findall(words)]
        if not numbers:
            continue
        if fresh:
            blocks.append([])
            fresh = False
        blocks[-1] += numbers
    return [np.array(block) for block in blocks]
