"""Maps for people to look at: those of a scan's maps.h5, bounded in memory, or those of the sweep so far."""

from __future__ import annotations

import math
from pathlib import Path

import h5py
import numpy as np

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import ResultProgress
from acquire.contract.scan_data.dataset_names import MAPS_NAME
from acquire.contract.scan_data.file_layout import read_layout
from tui.console.link.rig_view import MapsView
from tui.console.pictures.maps import MEDIAN_PX, MapSet

MAX_SAMPLES = 1_000_000
"""Larger maps are sampled, so that a new threshold shows within a blink; 1024 x 768 are whole."""


def read_maps(folder: Path) -> MapSet:
    """The maps beside a scan.

    Args:
        folder: the scan's folder, or another one with maps.h5.

    Raises:
        ScanFileError: there are none, or they cannot be read.
    """
    path = folder / MAPS_NAME
    if not path.is_file():
        raise ScanFileError(f"{folder.name} has no {MAPS_NAME} yet: reconstruct it first")
    bit_depth, frames = _of_scan(folder)
    try:
        with h5py.File(path, "r") as file:
            height, width = file["min"].shape
            step = max(1, math.ceil(math.sqrt(height * width / MAX_SAMPLES)))
            low, high, crossing = (file[name][::step][:, ::step] for name in ("min", "max", "crossing"))
            if not low.shape == high.shape == crossing.shape or low.dtype.kind != "u" or crossing.dtype.kind != "f":
                raise ScanFileError(f"{path} holds maps of different shapes or types: reconstruct the scan again")
            return MapSet(
                minimum=low.astype(np.uint16),
                maximum=high.astype(np.uint16),
                crossing=crossing.astype(np.float32),
                step=step,
                contrast=int(file.attrs["contrast"]),
                bit_depth=bit_depth or (8 if low.dtype == np.uint8 else 16),
                folded_through=int(file.attrs["folded_through"]),
                frames=frames,
                median_px=int(file.attrs.get("median", MEDIAN_PX)),
            )
    except (OSError, KeyError, ValueError, RuntimeError, TypeError, AttributeError) as error:
        detail = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise ScanFileError(f"{path} is not a readable maps.h5: {detail}; reconstruct the scan again") from None


def _of_scan(folder: Path) -> tuple[int, int]:
    """Bit depth and number of frames of the scan beside the maps; 0, 0 where there is none."""
    try:
        layout = read_layout(folder)
    except ScanFileError:
        return 0, 0
    return layout.format.bit_depth, layout.count


def maps_of_sweep(found: MapsView, progress: ResultProgress | None) -> MapSet:
    """The sampled maps of the results lane; the worker's progress tells how many frames there will be."""
    header = found.header
    return MapSet(
        minimum=found.minimum,
        maximum=found.maximum,
        crossing=found.crossing,
        step=header.step,
        contrast=round(header.contrast / 2 ** (header.bit_depth - 8)),
        bit_depth=header.bit_depth,
        folded_through=header.folded_through,
        frames=progress.expected if progress is not None and progress.scan_uid == header.scan_uid else 0,
    )
