"""The maps as the results lane shows them: every n-th pixel of minimum, maximum and crossing.

They are sampled, never averaged, so that each value is one that a pixel has.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from acquire.contract.scan_data.maps_file import read_maps, sample_step
from process.crossings.maps import Maps

MAX_SAMPLES = 200_000
"""1024 x 768 pixels are sampled at every second one: 1.6 MB per message."""


class MapSamples(NamedTuple):
    """Every ``step``-th pixel of the maps in both directions, from pixel 0 on, [h, w]."""

    step: int
    minimum: NDArray[Any]
    maximum: NDArray[Any]
    crossing: NDArray[Any]

    @property
    def payload(self) -> bytes:
        """min <u2, max <u2, crossing <f4, each [h, w] in row-major order."""
        return b"".join(
            plane.astype(dtype).tobytes()
            for plane, dtype in ((self.minimum, "<u2"), (self.maximum, "<u2"), (self.crossing, "<f4"))
        )


def samples_of(maps: Maps) -> MapSamples:
    """Samples of a fold in mid-sweep."""
    height, width = maps.minimum.shape
    step = sample_step(height, width, MAX_SAMPLES)
    return MapSamples(step, *(plane[::step, ::step] for plane in (maps.minimum, maps.maximum, maps.crossing)))


def samples_on_disk(path: Path) -> MapSamples:
    """Samples of a finished maps.h5.

    Raises:
        ScanFileError: it cannot be read.
    """
    found = read_maps(path, ("min", "max", "crossing"), max_samples=MAX_SAMPLES)
    return MapSamples(found.step, *found.arrays.values())
