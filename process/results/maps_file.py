"""Owns maps.h5: writing the fold's maps with the settings they were made with, and reading them back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py

from acquire.contract.errors import ScanFileError
from process.atomic_write import replacing
from process.crossings.maps import Maps

from .settings import Settings

DATASETS = {
    "min": "minimum",
    "max": "maximum",
    "mask": "mask",
    "crossing": "crossing",
    "sigma": "sigma",
    "quality": "quality",
    "colour": "colour",
}
"""Dataset of maps.h5 -> field of ``Maps``."""


@dataclass(frozen=True)
class MapsSource:
    """Which frames the maps were made of."""

    scan_uid: str
    digest: str
    """Digest over the frames that were folded."""
    folded_through: int
    """Last frame index folded; -1 for none."""


def write_maps(path: Path, maps: Maps, settings: Settings, source: MapsSource) -> None:
    """Write maps.h5 (contiguous, no times stored: equal maps give equal files).

    Raises:
        ResultWriteError: the folder cannot be written to.
    """
    with replacing(path) as temporary, h5py.File(temporary, "w", libver="latest") as file:
        for name, field in DATASETS.items():
            file.create_dataset(name, data=getattr(maps, field), track_times=False)
        file.attrs.update(
            {
                "contrast": settings.contrast,
                "median": settings.median,
                "edge": settings.edge,
                "method": settings.method,
                "folded_through": source.folded_through,
                "source_digest": source.digest,
                "scan_uid": source.scan_uid,
            }
        )


def read_source(path: Path) -> MapsSource:
    """Which frames an existing maps.h5 was made of.

    Raises:
        ScanFileError: not there, or no maps.h5.
    """
    try:
        with h5py.File(path, "r") as file:
            attributes = file.attrs
            return MapsSource(
                scan_uid=str(attributes["scan_uid"]),
                digest=str(attributes["source_digest"]),
                folded_through=int(attributes["folded_through"]),
            )
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise ScanFileError(f"{path} is not a readable maps.h5: {str(error).splitlines()[0][:120]}") from None
