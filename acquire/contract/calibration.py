"""calibration.json: parsed and checked; each refusal names the key (docs/design.md, section 5)."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from .errors import CalibrationError
from .files import read_text, reason
from .plan import SweepPlan

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
MAX_FILE_BYTES = 64 * 1024 * 1024
ROTATION_TOLERANCE = 1e-3
"""Printed calibrations have four digits; their R is orthogonal to about this."""


class CameraModel(msgspec.Struct, frozen=True):
    """Pinhole camera in OpenCV's convention: X_cam = R X_world + T (equation 1), pixel centres at integers, mm."""

    width: Annotated[int, Meta(ge=1, le=16_384)]
    height: Annotated[int, Meta(ge=1, le=16_384)]
    K: Matrix3
    R: Matrix3
    T: Vector3
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1 k2 p1 p2 k3."""
    mirrored: bool = False
    """True: rays leave the pinhole backwards, -v. Left-handed worlds, as the original program's, need it."""


class TranslatingPlane(msgspec.Struct, frozen=True, tag_field="kind", tag="translating"):
    """A light plane that only translates: n . (X - (origin + velocity t)) = 0."""

    parameter: Literal["frame", "position_um"]
    """Unit of t: 1-based frame number, or stage position in um."""
    normal: Vector3
    corner_origin_mm: Vector3
    corner_velocity_mm: Vector3
    """mm per unit of the parameter."""
    edge: Literal["rising", "falling"] = "rising"
    method: str = "linear"
    velocity_direction: Literal["normal", "corner-track", "assumed-axis"] = "normal"
    """What of the velocity is known: its component along the normal only, or the whole vector."""


class PerFramePlanes(msgspec.Struct, frozen=True, tag_field="kind", tag="per-frame"):
    """One plane n . X = d for each frame, interpolated linearly between neighbours, first_frame <= t <= last_frame."""

    parameter: Literal["frame"]
    first_frame: Annotated[int, Meta(ge=-1_000_000, le=1_000_000)]
    planes: Annotated[tuple[tuple[float, float, float, float] | None, ...], Meta(min_length=1, max_length=100_000)]
    """[nx, ny, nz, d] in mm; null for a frame without a plane: there is none up to its neighbours either."""
    edge: Literal["rising", "falling"] = "rising"
    method: str = "linear"

    @property
    def last_frame(self) -> int:
        """The last t (1-based frame number) that has a plane."""
        return self.first_frame + len(self.planes) - 1


class Validity(msgspec.Struct, frozen=True):
    """What the calibration was made for; None where it does not matter."""

    first_steps: int | None = None
    steps_per_frame: int | None = None
    direction: int | None = None
    mode: str | None = None
    zero_id: str | None = None
    created_utc: str | None = None
    days: float | None = None


class Calibration(msgspec.Struct, frozen=True):
    """Camera and light plane. Unknown extra keys are allowed; the scan keeps the text verbatim."""

    format: Literal["sweepscope-calibration"]
    version: Literal[1]
    camera: CameraModel
    light_plane: TranslatingPlane | PerFramePlanes | None = None
    valid_for: Validity | None = None


def load_calibration(path: Path) -> tuple[Calibration, str]:
    """Read and check a calibration; returns it and its text, verbatim.

    Raises:
        CalibrationError: not there, not JSON, a key missing, NaN, a non-rotation R, a zero normal ... by name.
    """
    try:
        text = read_text(path, MAX_FILE_BYTES)
    except FileNotFoundError:
        raise CalibrationError(
            f"the calibration {path} is not there: calibrate, or name another with --calibration"
        ) from None
    except (OSError, ValueError) as error:
        raise CalibrationError(f"cannot read the calibration {path}: {reason(error)}") from None
    return parse_calibration(text, str(path)), text


def parse_calibration(text: str, name: str = "calibration") -> Calibration:
    """The checked calibration in ``text`` (JSON).

    Raises:
        CalibrationError: as :func:`load_calibration`; ``name`` is in the message.
    """
    try:
        fields = json.loads(text, parse_constant=_refuse_constant)
        calibration = msgspec.convert(fields, Calibration, strict=True)
    except (json.JSONDecodeError, RecursionError) as error:
        raise CalibrationError(f"{name} is not valid JSON: {str(error)[:200]}") from None
    except msgspec.ValidationError as error:
        raise CalibrationError(f"{name}: {_explain(str(error))}") from None
    except ValueError as error:
        raise CalibrationError(f"{name}: {error}") from None
    _check_camera(calibration.camera, name)
    _check_plane(calibration.light_plane, name)
    return calibration


def _refuse_constant(constant: str) -> Any:
    raise ValueError(f"it holds {constant}, which is no number; calibrate again")


def _explain(text: str) -> str:
    what, _, where = text.partition(" - at `$.")
    if "missing required field" in what:
        key = what.split("`")[1] if "`" in what else what
        return f"{(where.rstrip('`') + '.') if where else ''}{key} is missing"
    return f"{where.rstrip('`') or 'the file'}: {what}"


def _finite(values: Any, name: str, key: str) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise CalibrationError(f"{name}: {key} holds a value that is not finite; calibrate again")
    return array


def _check_camera(camera: CameraModel, name: str) -> None:
    matrix = _finite(camera.K, name, "camera.K")
    rotation = _finite(camera.R, name, "camera.R")
    _finite(camera.T, name, "camera.T")
    _finite(camera.distortion, name, "camera.distortion")
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and tuple(matrix[2]) == (0, 0, 1) and matrix[1, 0] == 0):
        raise CalibrationError(f"{name}: camera.K is no camera matrix (positive focal lengths, last row 0 0 1)")
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise CalibrationError(f"{name}: camera.R is no rotation (R R^T differs from 1 by {error:.2g})")


def _check_plane(plane: TranslatingPlane | PerFramePlanes | None, name: str) -> None:
    if plane is None:
        return
    if isinstance(plane, PerFramePlanes):
        known = [row for row in plane.planes if row is not None]
        if not known:
            raise CalibrationError(f"{name}: light_plane.planes holds no plane")
        normals = _finite(known, name, "light_plane.planes")[:, :3]
        if (np.linalg.norm(normals, axis=1) < 1e-9).any():
            raise CalibrationError(f"{name}: light_plane.planes holds a plane with a zero normal")
        return
    normal = _finite(plane.normal, name, "light_plane.normal")
    _finite(plane.corner_origin_mm, name, "light_plane.corner_origin_mm")
    velocity = _finite(plane.corner_velocity_mm, name, "light_plane.corner_velocity_mm")
    if np.linalg.norm(normal) < 1e-9:
        raise CalibrationError(f"{name}: light_plane.normal is zero")
    if abs(normal @ velocity) < 1e-12 * np.linalg.norm(normal):
        raise CalibrationError(f"{name}: light_plane.corner_velocity_mm lies in the plane: it would never move")


def check_size(calibration: Calibration, width: int, height: int) -> None:
    """Refuse a calibration of another image size (there is no ``--force`` for this: pixels would mean nothing)."""
    camera = calibration.camera
    if (camera.width, camera.height) != (width, height):
        raise CalibrationError(
            f"the calibration is for {camera.width} x {camera.height} pixels, the scan has {width} x {height}: "
            "calibrate this camera at this size"
        )


def age_days(calibration: Calibration, at_utc: str) -> float | None:
    """Age in days at a time (ISO 8601); None where either is not known. Never negative."""
    made = calibration.valid_for.created_utc if calibration.valid_for else None
    try:
        seconds = (datetime.fromisoformat(at_utc) - datetime.fromisoformat(made or "")).total_seconds()
    except (ValueError, TypeError):
        return None
    return max(seconds / 86_400, 0.0)


def check_validity(calibration: Calibration, plan: SweepPlan | None, zero_id: str = "", at_utc: str = "") -> list[str]:
    """Refuse a plane by frame numbers on another sweep; return warnings for what is only doubtful.

    Args:
        calibration: to be used.
        plan: of the sweep; None for imported folders.
        zero_id: which homing the sweep's positions count from; empty where that is not known.
        at_utc: when the sweep is made (ISO 8601); empty: its age is not judged.

    Raises:
        CalibrationError: ``parameter = "frame"`` and another first position, pitch or direction than ``valid_for``.
    """
    valid, plane = calibration.valid_for, calibration.light_plane
    if valid is None or plane is None or plan is None:
        return []
    pairs = (
        ("first position", valid.first_steps, plan.first_steps),
        ("steps per frame", valid.steps_per_frame, plan.steps_per_frame),
        ("direction", valid.direction, plan.direction),
    )
    different = [f"{what} {wanted} (here {found})" for what, wanted, found in pairs if wanted not in (None, found)]
    if different and plane.parameter == "frame":
        raise CalibrationError(f"the calibration counts frames of a sweep with {', '.join(different)}: use its plan")
    warnings = []
    if valid.zero_id and zero_id and valid.zero_id != zero_id:
        warnings.append(
            "the stage was homed since the calibration: the plane may be shifted, rezero it with calibrate rezero"
        )
    age = age_days(calibration, at_utc)
    if age is not None and valid.days is not None and age > valid.days:
        warnings.append(f"the calibration is {age:.0f} days old and meant for {valid.days:g}: check it")
    return warnings
