"""Owns the original program's files: projector.txt and calibration.txt, converted to our convention.

Its R, T go from camera to world (u = T, v = R K^-1 p'), ours from world to camera. Its world is left-handed: the stage
lies behind its pinhole, which our ``mirrored`` says, so that points come out the same. Its distortion is k1 k2 p1 p2.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError

F8 = NDArray[np.float64]
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
CALIBRATION_COUNTS = (9, 4, 9, 3)
LENGTHS_MM = {"hs": 3.81, "f": 50.0, "xb": 102.32}
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
    """The camera's place in the world, mm."""
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
        CalibrationError: not there, a block with too few numbers, or a rotation that is none; by name.
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
        CalibrationError: not there, or lines that are missing; by name.
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
        CalibrationError: impossible geometry (hp / d > 1; the original inverts it in silence), with the numbers.
    """
    first, last, nine, centre, six = _on_stage(original, np.vstack([clicks.first, clicks.last, clicks.pattern]))
    velocity = (last - first) / max(clicks.last_frame - 1, 1)
    normal = pattern_normal(nine, centre, six)
    if normal @ velocity < 0:
        normal = -normal
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


def pattern_normal(p1: F8, corner: F8, p2: F8) -> F8:
    """Normal of the leading light plane from the three corners of the quarter circle on z = 0 (equations 5 to 10).

    Args:
        p1: end of the other straight edge (9 o'clock), [3] mm.
        corner: the corner c, [3] mm.
        p2: end of the leading edge (6 o'clock), [3] mm.

    Raises:
        CalibrationError: a projected edge shorter than the optics allow.
    """
    hs, focal, xb = LENGTHS_MM["hs"], LENGTHS_MM["f"], LENGTHS_MM["xb"]
    hp, alpha = hs * focal / xb, np.arctan(hs / focal)
    lengths = [float(np.linalg.norm(end - corner)) for end in (p1, p2)]
    for name, length in zip(("9 o'clock", "6 o'clock"), lengths, strict=True):
        if hp * np.cos(alpha) / length > 1:
            raise CalibrationError(
                f"impossible geometry: the edge to {name} is {length:.4f} mm long, and hp is {hp:.4f} mm "
                f"(hp / d = {hp / length:.3f} > 1): wrong clicks, scale, or slide"
            )
    e1, e2 = (p1 - corner) / lengths[0], (p2 - corner) / lengths[1]
    e3 = np.cross(e1, e2)
    theta2, theta1 = (np.arccos(hp * np.cos(alpha) / length) - alpha for length in lengths)
    v1 = np.cos(theta2) * e1 + np.sin(theta2) * e3
    v2 = np.cos(theta1) * e2 + np.sin(theta1) * e3
    axis = np.cross(v1, v2)
    towards = focal * hp / hs * axis / np.linalg.norm(axis)
    normal = np.cross(towards, p2 - corner)
    return np.asarray(normal / np.linalg.norm(normal), dtype=np.float64)


def _on_stage(original: OriginalCalibration, pixels: F8) -> F8:
    """Points [n, 3] of the original's own rays on z = 0 (its convention: u = T, v = R K^-1 p')."""
    directions = np.linalg.solve(original.matrix, np.column_stack([pixels, np.ones(len(pixels))]).T).T
    directions = directions @ original.rotation.T
    distance = -original.translation[2] / directions[:, 2]
    return np.asarray(original.translation + distance[:, None] * directions, dtype=np.float64)


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise CalibrationError(f"{path} is over {MAX_FILE_BYTES} bytes: it is no file of the original program")
        return path.read_text(encoding="latin-1")
    except OSError as error:
        raise CalibrationError(f"cannot read {path}: {error.strerror}") from None


def _blocks(text: str) -> list[F8]:
    """Runs of numbers between lines of words; numbers within a label (such as its unit) do not count."""
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
