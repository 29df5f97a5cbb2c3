"""maps.h5 beside a scan: minimum, maximum, mask, crossing, sigma, quality and colour of every pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError

from .default_plot import add_default_plot

MAPS = ("min", "max", "mask", "crossing", "sigma", "quality", "colour")
"""Datasets: [h, w] in the frames' type, the same, u1, f8 (0-based frame index), f4 (frames), u2; u1 [h, w, 3] RGB."""
_LONG_NAMES = {
    "crossing": "crossing (frames)",
    "sigma": "standard deviation of the crossing (frames)",
    "min": "least brightness (counts)",
    "max": "greatest brightness (counts)",
    "mask": "enough contrast (0 or 1)",
    "quality": "quality bits",
    "colour": "colour",
}
_KINDS = {"min": "u", "max": "u", "mask": "u", "crossing": "f", "sigma": "f", "quality": "u", "colour": "u"}


@dataclass(frozen=True)
class MapsHeader:
    """Attributes of maps.h5: which frames the maps were made of, and how."""

    contrast: int
    """Least brightness range in counts of 8 bit."""
    median: int = 5
    """Side of the mask's median filter in pixels; 0 for none."""
    edge: str = ""
    method: str = ""
    folded_through: int = -1
    """Last frame index folded; -1 for none."""
    source_digest: str = ""
    """Digest over the frames that were folded."""
    scan_uid: str = ""


@dataclass(frozen=True)
class MapsFile:
    """What was read of a maps.h5."""

    header: MapsHeader
    arrays: dict[str, NDArray[Any]]
    """By dataset name."""
    step: int = 1
    """Distance of the samples in pixels."""


def sample_step(height: int, width: int, max_samples: int) -> int:
    """The least distance of samples in pixels with which an image has at most ``max_samples`` of them."""
    step = max(1, math.isqrt(height * width // max_samples))
    while -(-height // step) * -(-width // step) > max_samples:
        step += 1
    return step


def write_maps(path: Path, arrays: Mapping[str, NDArray[Any]], header: MapsHeader) -> None:
    """Write all of :data:`MAPS` (contiguous, no times stored: equal maps give equal files) and their default plot.

    Raises:
        OSError: the folder cannot be written to.
    """
    with h5py.File(path, "w", libver="latest") as file:
        for name in MAPS:
            file.create_dataset(name, data=arrays[name], track_times=False)
        add_default_plot(file, "crossing", _LONG_NAMES)
        file.attrs.update(asdict(header))


def read_maps(path: Path, names: Sequence[str] = MAPS, *, max_samples: int | None = None) -> MapsFile:
    """Read ``names`` of a maps.h5, every n-th pixel where there are more than ``max_samples``.

    Raises:
        ScanFileError: it is missing, damaged, or its maps do not have one shape and their types.
    """
    try:
        with h5py.File(path, "r") as file:
            height, width = file["min"].shape
            step = 1 if max_samples is None else sample_step(height, width, max_samples)
            # rows by HDF5, columns here: a selection with two steps is read value by value
            arrays = {name: file[name][::step][:, ::step] for name in names}
            odd = [name for name, array in arrays.items() if array.dtype.kind != _KINDS[name]]
            if odd or len({array.shape[:2] for array in arrays.values()}) > 1:
                raise ScanFileError(f"{path} holds maps of different shapes or types: reconstruct the scan again")
            return MapsFile(_header(file.attrs), arrays, step)
    except (OSError, KeyError, ValueError, RuntimeError, TypeError, AttributeError) as error:
        detail = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise ScanFileError(f"{path} is not a readable maps.h5: {detail}; reconstruct the scan again") from None


def _header(attributes: Mapping[str, Any]) -> MapsHeader:
    defaults = asdict(MapsHeader(contrast=0))
    given = {name: type(default)(attributes[name]) for name, default in defaults.items() if name in attributes}
    return MapsHeader(**given)  # a file without a contrast raises TypeError: it is no maps.h5
