"""Pose of a plane in one view: the two poses that the picture allows, and whether they can be told apart.

A plane seen from far away looks nearly the same tilted to one side and to the other; only perspective distinguishes the
two poses. Equation 1 with OpenCV's distortion, mm and px.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
SAME_POSE_DEG = 0.05
"""Two refined poses within this angle are one."""
TELL_APART = 25.0
"""Least chi squared between both poses for the better one to be accepted."""
NOISE_FLOOR_PX = 0.02
"""Corners are not more accurate than this, however well they fit."""
_REFINE = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)


@dataclass(frozen=True)
class PlanePose:
    """X_cam = R X_board + T."""

    rotation_vector: F8
    """[3], Rodrigues."""
    translation: F8
    """[3] mm."""
    rms_px: float
    """Root mean square of the distance between seen and predicted corners."""
    ambiguous: bool
    """True if the mirrored pose explains the view nearly as well."""
    mirrored_rms_px: float
    """The same for the mirrored pose; infinite where there is none."""
    other: PlanePose | None = None
    """The mirrored pose."""

    @property
    def rotation(self) -> F8:
        """Rotation matrix [3, 3]."""
        return np.asarray(cv2.Rodrigues(self.rotation_vector)[0], dtype=np.float64)

    @property
    def normal(self) -> F8:
        """The plane's normal in camera coordinates, [3]."""
        return self.rotation[:, 2]


def project(object_mm: F8, rotation_vector: F8, translation: F8, matrix: F8, distortion: F8) -> F8:
    """Pixels [n, 2] of board points [n, 3] (equation 1 and OpenCV's distortion)."""
    pixels = cv2.projectPoints(object_mm, rotation_vector, translation, matrix, distortion)[0]
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


def find_pose(object_mm: F8, pixels: F8, matrix: F8, distortion: F8) -> PlanePose:
    """The better of the two poses of a plane, refined, and whether the other one can be excluded.

    Args:
        object_mm: [n, 3] with z = 0.
        pixels: [n, 2].
        matrix: K, [3, 3].
        distortion: k1 k2 p1 p2 k3.
    """
    flat = cv2.undistortPoints(np.ascontiguousarray(pixels).reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2)
    _, turns, shifts, _ = cv2.solvePnPGeneric(object_mm, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    found = []
    for first_turn, first_shift in zip(turns, shifts, strict=True):
        refined = cv2.solvePnPRefineLM(
            object_mm, pixels, matrix, distortion, first_turn.copy(), first_shift.copy(), _REFINE
        )
        turn = np.asarray(cv2.Rodrigues(cv2.Rodrigues(refined[0])[0])[0], dtype=np.float64).ravel()  # at most pi long
        shift = np.asarray(refined[1], dtype=np.float64).ravel()
        error = project(object_mm, turn, shift, matrix, distortion) - pixels
        found.append((float(np.sqrt((error**2).sum(axis=1).mean())), turn, shift))
    found.sort(key=lambda entry: entry[0])
    best = found[0]
    others = [other for other in found[1:] if _angle_deg(best[1], other[1]) > SAME_POSE_DEG]
    other_rms = others[0][0] if others else float("inf")
    noise = max(best[0], NOISE_FLOOR_PX) ** 2 / 2
    ambiguous = bool(len(pixels) * (other_rms**2 - best[0] ** 2) / noise < TELL_APART)
    mirrored = PlanePose(others[0][1], others[0][2], other_rms, ambiguous, best[0]) if others else None
    return PlanePose(best[1], best[2], best[0], ambiguous, other_rms, mirrored)


def _angle_deg(first: F8, second: F8) -> float:
    between = cv2.Rodrigues(first)[0].T @ cv2.Rodrigues(second)[0]
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(between)[0])))
