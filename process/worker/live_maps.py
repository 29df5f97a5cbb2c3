"""Owns the maps as the results lane shows them: every n-th pixel of minimum, maximum and crossing, about once a second.

They are for people to look at: sampled, never averaged, so that each value is one that a pixel has.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import ResultMaps
from acquire.contract.scan_data.maps_file import read_maps, sample_step
from acquire.contract.units import NS_PER_S
from process.crossings.maps import Maps

from .session import ScanSession

PERIOD_NS = NS_PER_S
MAX_SAMPLES = 200_000
"""1024 x 768 pixels are sampled at every second one: 1.6 MB per message."""

MapsNews = tuple[ResultMaps, bytes]
"""The message and its payload: min <u2, max <u2, crossing <f4, each [h, w] in row-major order."""


def sampled(session: ScanSession, maps: Maps) -> MapsNews:
    """The maps of a fold in mid-sweep."""
    height, width = maps.minimum.shape
    step = sample_step(height, width, MAX_SAMPLES)
    planes = (array[::step, ::step] for array in (maps.minimum, maps.maximum, maps.crossing))
    return _news(session, step, *planes)


def on_disk(session: ScanSession, path: Path) -> MapsNews:
    """The same of a finished maps.h5.

    Raises:
        ScanFileError: it cannot be read.
    """
    found = read_maps(path, ("min", "max", "crossing"), max_samples=MAX_SAMPLES)
    return _news(session, found.step, *found.arrays.values())


def _news(
    session: ScanSession, step: int, minimum: NDArray[Any], maximum: NDArray[Any], crossing: NDArray[Any]
) -> MapsNews:
    message = ResultMaps(
        scan_uid=session.announced.scan_uid,
        version=0,
        folded_through=session.cursor.fold.folded_through,
        shape=list(minimum.shape),
        step=step,
        contrast=float(session.settings.contrast * 2 ** (session.form.bit_depth - 8)),
        bit_depth=session.form.bit_depth,
    )
    parts = (minimum.astype("<u2"), maximum.astype("<u2"), crossing.astype(np.dtype("<f4")))
    return message, b"".join(part.tobytes() for part in parts)
