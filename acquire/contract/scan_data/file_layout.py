"""What a scan's file holds and where in the file it lies: read once through HDF5, which is closed again at once."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import msgspec
import numpy as np

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan

from .dataset_names import (
    CHECKS_CRC32,
    CHECKS_DATA,
    CHECKS_STATUS,
    DATA,
    FRAME_FIELDS,
    LAYOUT_VERSION,
    MEASURED,
    SCALARS,
    SEALED_NAME,
    VERBATIM,
    find_scan_file,
)


@dataclass(frozen=True)
class Region:
    """A contiguous dataset: where it lies in the file and what it holds."""

    offset: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    @property
    def nbytes(self) -> int:
        """Bytes of the whole region."""
        return math.prod(self.shape) * self.dtype.itemsize


@dataclass(frozen=True)
class ScanLayout:
    """Everything about a scan file that never changes once it exists."""

    path: Path
    scan_uid: str
    start_time: str
    program_version: str
    format: FrameFormat
    count: int
    axis: str
    regions: dict[str, Region]
    """By dataset name: ``data``, the per-frame fields, the scalars, ``checks/...`` where present."""
    verbatim: dict[str, bytes]
    epoch_utc_ns: int
    zero_id: str = ""
    """Identifies the homing that its positions count from; empty if not known."""

    @property
    def frame_nbytes(self) -> int:
        """Bytes of one stored frame."""
        return self.format.nbytes

    def frame_offset(self, frame_index: int) -> int:
        """File offset of a frame's pixels."""
        return self.regions["data"].offset + frame_index * self.frame_nbytes

    @property
    def plan(self) -> SweepPlan | None:
        """The plan of the sweep, None for imported folders."""
        text = self.verbatim["plan"]
        return msgspec.json.decode(text, type=SweepPlan) if text.strip() not in (b"", b"{}") else None

    @property
    def user(self) -> dict[str, Any]:
        """name, specimen, operator, notes, tags, purpose."""
        found = json.loads(self.verbatim["user"] or b"{}")
        return found if isinstance(found, dict) else {}

    @property
    def purpose(self) -> str:
        """``object``, ``calibration`` or ``raw``."""
        return str(self.user.get("purpose", "object"))


def read_layout(scan: Path) -> ScanLayout:
    """Open SCAN once through HDF5, take its layout and offsets, close it again.

    Raises:
        ScanFileError: not a scan, damaged, of another layout version, or shorter than its layout says.
    """
    path = find_scan_file(scan)
    try:
        with _open(path) as file:
            layout = _layout_of(path, file)
    except FileNotFoundError:
        # it was sealed, and so renamed, at this very moment
        sealed = path.with_name(SEALED_NAME)
        if path.name == SEALED_NAME or not sealed.is_file():
            raise ScanFileError(f"{path} is gone") from None
        return read_layout(sealed)
    except (
        OSError,
        KeyError,
        ValueError,
        RuntimeError,
        TypeError,
        AttributeError,
        msgspec.MsgspecError,
    ) as error:
        raise ScanFileError(f"{path} is not a readable scan file: {_first_line(error)}") from None
    end = max(region.offset + region.nbytes for region in layout.regions.values())
    if path.stat().st_size < end:
        raise ScanFileError(f"{path} is truncated: {path.stat().st_size} of {end} bytes; restore it from a copy")
    return layout


def _open(path: Path) -> h5py.File:
    """Open for reading without a lock; with HDF5's own locking where this process holds the file open with it."""
    try:
        return h5py.File(path, "r", locking=False)
    except OSError as error:
        if not path.exists():
            raise FileNotFoundError(path) from error
        if "locking" not in str(error):
            raise
        return h5py.File(path, "r")


def _first_line(error: Exception) -> str:
    line = (str(error).splitlines() or [type(error).__name__])[0][:200]
    return f"{line}; restore it from a copy" if "truncated" in line or "signature" in line else line


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _layout_of(path: Path, file: h5py.File) -> ScanLayout:
    entry = file["entry"]
    version = int(entry.attrs["layout_version"])
    if version != LAYOUT_VERSION:
        raise ScanFileError(f"{path} has layout version {version}, this program reads {LAYOUT_VERSION}")
    data = file[DATA]
    regions = {"data": _region(data)}
    regions |= {name: _region(entry[f"data/{name}"]) for name in FRAME_FIELDS}
    regions |= {name: _region(entry[name]) for name in SCALARS}
    if MEASURED in entry:
        regions[MEASURED] = _region(entry[MEASURED])
    if "checks" in entry:
        regions |= {
            name.removeprefix("/entry/"): _region(file[name]) for name in (CHECKS_DATA, CHECKS_STATUS, CHECKS_CRC32)
        }
    _check_fields(regions)
    pixel_format = _text(entry["pixel_format"][()])
    frame_format = msgspec.convert(
        {
            "height": data.shape[1],
            "width": data.shape[2],
            "bit_depth": int(entry["bit_depth"][()]),
            "pixel_format": pixel_format,
        },
        FrameFormat,
    )
    if frame_format.shape != data.shape[1:] or np.dtype(frame_format.dtype) != data.dtype:
        raise ScanFileError(
            f"{path}: {data.dtype} {data.shape} does not fit {pixel_format} of {frame_format.bit_depth} bit"
        )
    axes = entry["data"].attrs["axes"]
    clock = entry["data/exposure_start_ns"].attrs
    return ScanLayout(
        path=path,
        scan_uid=_text(entry.attrs["scan_uid"]),
        start_time=_text(entry.attrs["start_time"]),
        program_version=_text(entry.attrs["program_version"]),
        format=frame_format,
        count=int(data.shape[0]),
        axis=_text(axes[0]),
        regions=regions,
        verbatim={name: bytes(entry[name][()]).rstrip(b"\0") for name in VERBATIM},
        epoch_utc_ns=int(clock.get("epoch_utc_ns", 0)),
        zero_id=zero_id_in(_text(entry.attrs.get("versions", "{}"))),
    )


def zero_id_in(versions_json: str) -> str:
    """The zero that a scan's ``versions`` (JSON) names beside the programs; empty where it names none."""
    try:
        found = json.loads(versions_json)
    except ValueError:
        return ""
    return str(found.get("zero_id", ""))[:100] if isinstance(found, dict) else ""


def _region(dataset: h5py.Dataset) -> Region:
    offset = dataset.id.get_offset()
    if offset is None:
        raise ScanFileError(f"{dataset.name} is not stored contiguously")
    return Region(int(offset), dataset.dtype, tuple(dataset.shape))


def _check_fields(regions: dict[str, Region]) -> None:
    count = regions["data"].shape[0]
    for name, dtype in FRAME_FIELDS.items():
        region = regions[name]
        if region.shape != (count,) or region.dtype != np.dtype(dtype):
            raise ScanFileError(f"/entry/data/{name} is {region.dtype} {region.shape}, not {dtype} [{count}]")
