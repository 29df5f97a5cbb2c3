"""cloud.ply: the record of one vertex, and writing and reading files of them.

The writer uses the types that every reader knows (``float``, ``uchar``, ``int``: meshio and Open3D have no ``ushort``).
"""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.files import reason

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
        ("quality", "<i4"),
    ]
)
"""One vertex of cloud.ply; mm, RGB, um, fractional 0-based frame index, quality bits."""

_WRITTEN: Final = {"f4": "float", "u1": "uchar", "i4": "int"}
_READ: Final = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS: Final = {"binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_HEADER_BYTES: Final = 64 * 1024


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
    if isinstance(target, Path):
        with target.open("wb") as file:
            write_ply(file, vertices)
        return
    assert vertices.dtype == VERTEX
    properties = [f"property {_WRITTEN[VERTEX[name].str[1:]]} {name}" for name in VERTEX.names or ()]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *properties, "end_header"]
    target.write("\n".join(header).encode() + b"\n")
    target.write(np.ascontiguousarray(vertices).data)


def read_vertices(path: Path, *, instead: str) -> NDArray[Any]:
    """The vertices of a binary PLY as records, mapped from the file; also of clouds of older versions.

    Args:
        path: the file; vertices are its first element and have no lists.
        instead: for the error text: what the user can do if it cannot be read.

    Raises:
        ScanFileError: not there, or not a readable cloud; one line.
    """
    try:
        with path.open("rb") as file:
            dtype, count = _header(file)
            offset = file.tell()
            if count * dtype.itemsize > path.stat().st_size - offset:
                raise ValueError(f"it was cut short: its header promises {count} points")
            if not count:
                return np.empty(0, dtype)
            return np.asarray(np.memmap(file, dtype, "r", offset, (count,)))
    except (OSError, ValueError) as error:
        raise ScanFileError(f"{path} is not a readable cloud: {reason(error)[:120]}; {instead}") from None


def _header(file: IO[bytes]) -> tuple[np.dtype[Any], int]:
    """Type and number of the vertices; ``file`` stands behind the header then."""
    lines = _header_lines(file)
    order = next((_ORDERS.get(words[1]) for words in lines if words[0] == "format" and len(words) == 3), None)
    if order is None:
        raise ValueError("it is no binary PLY")
    elements = [index for index, words in enumerate(lines) if words[0] == "element"]
    if not elements or lines[elements[0]][1:2] != ["vertex"] or not lines[elements[0]][2:][:1]:
        raise ValueError("its first element are no vertices")
    end = elements[1] if len(elements) > 1 else len(lines)
    fields = [words[1:] for words in lines[elements[0] + 1 : end] if words[0] == "property"]
    if not fields or any(len(field) != 2 or field[0] not in _READ for field in fields):
        raise ValueError("its vertices have properties of an unknown type")
    count = int(lines[elements[0]][2])
    if count < 0:
        raise ValueError(f"it promises {count} points")
    return np.dtype([(name, order + _READ[kind]) for kind, name in fields]), count


def _header_lines(file: IO[bytes]) -> list[list[str]]:
    """The words of each line but comments, from behind ``ply`` up to ``end_header``."""
    if file.readline(_MOST_HEADER_BYTES).strip() != b"ply":
        raise ValueError("it does not begin as a PLY")
    lines: list[list[str]] = []
    while file.tell() < _MOST_HEADER_BYTES and (line := file.readline(_MOST_HEADER_BYTES)):
        words = line.decode("ascii", "replace").split()
        if words == ["end_header"]:
            return lines
        if words and words[0] not in ("comment", "obj_info"):
            lines.append(words)
    raise ValueError("its header does not end")
