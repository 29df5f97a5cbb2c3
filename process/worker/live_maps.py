"""Owns the maps as the results lane shows them: every n-th pixel of minimum, maximum and crossing, about once a second.

They are for people to look at: sampled, never averaged, so that each value is one that a pixel has.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import ResultMaps
from acquire.contract.units import NS_PER_S
from process.crossings.maps import Maps

from .session import ScanSession

PERIOD_NS = NS_PER_S
MAX_SAMPLES = 200_000
"""1024 x 768 pixels are sampled at every second one: 1.6 MB per message."""

MapsNews = tuple[ResultMaps, bytes]
"""The message and its payload: min <u2, max <u2, crossing <f4, each [h, w] in row-major order."""


def sample_step(height: int, width: int) -> int:
    """The least distance of samples with which a picture has at most :data:`MAX_SAMPLES` of them."""
    step = max(1, math.isqrt(height * width // MAX_SAMPLES))
    while -(-height // step) * -(-width // step) > MAX_SAMPLES:
        step += 1
    return step


def sampled(session: ScanSession, maps: Maps) -> MapsNews:
    """The maps of a fold in mid-sweep."""
    step = sample_step(*maps.minimum.shape)
    planes = (array[::step, ::step] for array in (maps.minimum, maps.maximum, maps.crossing))
    return _news(session, step, *planes)


def on_disk(session: ScanSession, path: Path) -> MapsNews:
    """The same of a finished maps.h5.

    Raises:
        ScanFileError: it cannot be read.
    """
    try:
        with h5py.File(path, "r") as file:
            step = sample_step(*file["min"].shape)
            # rows by HDF5, columns here: a selection with two steps is read value by value
            planes = [file[name][::step][:, ::step] for name in ("min", "max", "crossing")]
    except (OSError, KeyError, ValueError, RuntimeError, TypeError) as error:
        raise ScanFileError(f"{path} is not a readable maps.h5: {str(error).splitlines()[0][:120]}") from None
    return _news(session, step, *planes)


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
