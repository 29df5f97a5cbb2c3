"""cloud.ply: the record of one vertex, and writing and reading files of them."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from plyfile import PlyData, PlyElement, PlyParseError

from acquire.contract.errors import ScanFileError

VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("sigma_um", "<f4"),
        ("crossing", "<f4"),
        ("quality", "<u2"),
    ]
)
"""One vertex of cloud.ply; mm, RGB, um, fractional 0-based frame index, quality bits."""

_RAISED_BY_A_DAMAGED_FILE = (
    OSError, PlyParseError, KeyError, ValueError, OverflowError, MemoryError, TypeError, IndexError,
)  # fmt: skip


def point_records(
    dtype: np.dtype[Any], points_mm: NDArray[Any], rgb: NDArray[np.uint8], **columns: ArrayLike
) -> NDArray[Any]:
    """Records [n] of ``dtype``, which has x, y, z, red, green, blue and a field for each of ``columns``."""
    records = np.empty(len(points_mm), dtype)
    for axis, name in enumerate("xyz"):
        records[name] = points_mm[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        records[name] = rgb[:, channel]
    for name, values in columns.items():
        records[name] = values
    return records


def write_ply(target: Path | IO[bytes], vertices: NDArray[Any]) -> None:
    """Write records of :data:`VERTEX` as binary little-endian PLY; the same vertices give the same bytes.

    Raises:
        OSError: the file cannot be written.
    """
    element = PlyElement.describe(vertices, "vertex")
    PlyData([element], byte_order="<").write(str(target) if isinstance(target, Path) else target)


def read_vertices(path: Path, *, instead: str) -> NDArray[Any]:
    """The vertices of a PLY as records, mapped from the file where it is binary.

    Args:
        path: the file.
        instead: for the error text: what the user can do if it cannot be read.

    Raises:
        ScanFileError: not there, or not a readable cloud; one line.
    """
    try:
        return np.asarray(PlyData.read(str(path))["vertex"].data)
    except _RAISED_BY_A_DAMAGED_FILE as error:
        why = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise ScanFileError(f"{path} is not a readable cloud: {why}; {instead}") from None
