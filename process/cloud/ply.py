"""Owns reading a cloud.ply that somebody hands in: its vertices, or one line that says why not; never a crash."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyParseError

from acquire.contract.errors import ScanFileError

_WHATEVER_A_BENT_FILE_RAISES = (
    OSError,
    PlyParseError,
    KeyError,
    ValueError,
    OverflowError,
    MemoryError,
    TypeError,
    IndexError,
)


def read_vertices(path: Path, *, instead: str) -> NDArray[Any]:
    """The vertices of a PLY as records, mapped from the file where it is binary.

    Args:
        path: the file.
        instead: what to do when it cannot be read, in words.

    Raises:
        ScanFileError: not there, or not a readable cloud; one line.
    """
    try:
        return np.asarray(PlyData.read(str(path))["vertex"].data)
    except _WHATEVER_A_BENT_FILE_RAISES as error:
        why = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise ScanFileError(f"{path} is not a readable cloud: {why}; {instead}") from None
