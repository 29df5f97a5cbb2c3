"""Maps to be shown: from a scan's maps.h5, bounded in memory, or from the results lane while the sweep runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import ResultProgress
from acquire.contract.scan_data import maps_file
from acquire.contract.scan_data.dataset_names import MAPS_NAME
from acquire.contract.scan_data.file_layout import read_layout
from tui.console.link.rig_view import MapsView
from tui.console.pictures.maps import MapSet

MAX_SAMPLES = 1_000_000
"""Larger maps are sampled, so that a new threshold shows at once; 1024 x 768 are read whole."""


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
    found = maps_file.read_maps(path, ("min", "max", "crossing"), max_samples=MAX_SAMPLES)
    low = found.arrays["min"]
    return MapSet(
        minimum=low.astype(np.uint16),
        maximum=found.arrays["max"].astype(np.uint16),
        crossing=found.arrays["crossing"].astype(np.float32),
        step=found.step,
        contrast=found.header.contrast,
        bit_depth=bit_depth or (8 if low.dtype == np.uint8 else 16),
        folded_through=found.header.folded_through,
        frames=frames,
        median_px=found.header.median,
    )


def _of_scan(folder: Path) -> tuple[int, int]:
    """Bit depth and number of frames of the scan beside the maps; 0, 0 where there is none."""
    try:
        layout = read_layout(folder)
    except ScanFileError:
        return 0, 0
    return layout.format.bit_depth, layout.count


def maps_of_sweep(found: MapsView, progress: ResultProgress | None) -> MapSet:
    """The sampled maps of the results lane; the number of frames is in the worker's progress."""
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
