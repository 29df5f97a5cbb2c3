"""Creates scan files: all HDF5 metadata exists and is synced before the first frame, so HDF5 never writes again."""

from __future__ import annotations

import errno
import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final, Literal

import h5py
import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat, Start
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.dataset_names import (
    CHECK_ROLES,
    CREATING_PREFIX,
    FRAME_FIELDS,
    LAYOUT_VERSION,
    MEASURED,
    MEASURED_BYTES,
    PROGRAM_NAME,
    SCALARS,
)
from acquire.contract.scan_data.source_files import Sources, bytes_needed, write_sources
from acquire.contract.states import Outcome

from .disk import disk_error, free_bytes, reserve

Axis = Literal["position_um", "frame_number"]
_UID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
_PAGE_BYTES: Final = 4096
_METADATA_BYTES: Final = 256 * 1024
"""More than HDF5 needs for the groups, headers and attributes of a scan."""


@dataclass(frozen=True)
class ScanRecipe:
    """Everything about a scan that is known before its first frame."""

    scan_uid: str
    format: FrameFormat
    count: int
    """Number of frames, at least 1."""
    plan: SweepPlan | None = None
    """None where frames come from somewhere else: the sweep coordinate is then the 1-based frame number."""
    config_toml: str = ""
    calibration_json: str = ""
    user_json: str = "{}"
    start_time_utc: str = ""
    epoch_utc_ns: int = 0
    """UTC minus CLOCK_MONOTONIC in ns."""
    versions_json: str = "{}"
    um_per_frame: float | None = None
    """Travel from frame to frame where there is no plan; None: not known."""
    sources: Sources | None = None
    """The picture files of an imported scan."""

    @classmethod
    def from_start(cls, start: Start) -> ScanRecipe:
        """The recipe of an announced sweep."""
        return cls(
            scan_uid=start.scan_uid,
            format=start.format,
            count=start.plan.count,
            plan=start.plan,
            config_toml=start.config_toml,
            calibration_json=start.calibration_json,
            user_json=start.user_json,
            start_time_utc=start.start_time_utc,
            epoch_utc_ns=start.epoch_utc_ns,
            versions_json=start.versions_json,
        )

    @property
    def axis(self) -> Axis:
        """The dataset that the default plot uses as its first axis."""
        return "frame_number" if self.plan is None else "position_um"

    @property
    def verbatim(self) -> dict[str, bytes]:
        """The fixed bytes of ``dataset_names.VERBATIM``."""
        plan = b"{}" if self.plan is None else msgspec.json.encode(self.plan)
        return {
            "config": self.config_toml.encode(),
            "calibration": self.calibration_json.encode(),
            "plan": plan,
            "user": self.user_json.encode(),
        }

    @property
    def nbytes(self) -> int:
        """Bytes of the whole file, rounded up."""
        per_frame = self.format.nbytes + sum(np.dtype(kind).itemsize for kind in FRAME_FIELDS.values()) + 8
        fixed = _METADATA_BYTES + 2 * _PAGE_BYTES + sum(map(len, self.verbatim.values()))
        fixed += bytes_needed(self.sources) if self.sources else 0
        return self.count * per_frame + len(CHECK_ROLES) * self.format.nbytes + fixed


def creating_path(folder: Path, scan_uid: str) -> Path:
    """The temporary name of a scan while it is being made.

    Raises:
        ScanFileError: the uid cannot be part of a file name.
    """
    if not _UID.fullmatch(scan_uid):
        raise ScanFileError(f"{scan_uid[:40]!r} is no scan uid: letters, digits, '_', '.' and '-' only")
    return folder / f"{CREATING_PREFIX}{scan_uid}"


def create_file(folder: Path, recipe: ScanRecipe) -> tuple[Path, bool]:
    """Create the whole file under its temporary name in ``folder``, reserve its space, and fsync it.

    Returns:
        its path, and whether the space is reserved (False: the file system cannot).

    Raises:
        DiskFullError: there is not enough space; nothing is left behind.
        DiskError: the disk refused; nothing is left behind.
    """
    path = creating_path(folder, recipe.scan_uid)
    with _nothing_left_behind(path, recipe.nbytes):
        # left by a process that died here; only the holder of the writer's lock gets this far
        path.unlink(missing_ok=True)
        _probe(path, recipe.nbytes)
        with h5py.File(
            path,
            "x",
            locking=False,
            libver=("earliest", "v110"),
            alignment_threshold=1 << 16,
            alignment_interval=_PAGE_BYTES,
        ) as file:
            _write_entry(file, recipe)
        return path, reserve_and_sync(path)


@contextmanager
def _nothing_left_behind(path: Path, needed_bytes: int) -> Iterator[None]:
    try:
        yield
    except BaseException as error:
        with suppress(OSError):
            path.unlink(missing_ok=True)
        if isinstance(error, (OSError, RuntimeError)):
            cause = error if isinstance(error, OSError) else OSError(errno.EIO, str(error).splitlines()[0])
            raise disk_error(cause, path.parent, "create a scan in", needed_bytes) from None
        raise


def _probe(path: Path, size_bytes: int) -> None:
    """Detect a full disk before HDF5 does, which can crash the interpreter when a write fails."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        if not reserve(fd, size_bytes):
            free = free_bytes(path)
            if free is not None and free < size_bytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    finally:
        os.close(fd)
        path.unlink()


def reserve_and_sync(path: Path) -> bool:
    """Reserve the space of the whole file and fsync it; False where the file system cannot reserve.

    Raises:
        OSError: no space, or another failure of the disk.
    """
    fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    try:
        reserved = reserve(fd, os.fstat(fd).st_size)
        os.fsync(fd)
    finally:
        os.close(fd)
    return reserved


def _write_entry(file: h5py.File, recipe: ScanRecipe) -> None:
    _set(file, NX_class="NXroot", default="entry")
    entry = file.create_group("entry")
    _set(entry, NX_class="NXentry", default="data")
    _set(entry, program_name=PROGRAM_NAME, program_version=metadata.version(PROGRAM_NAME))
    _set(entry, scan_uid=recipe.scan_uid, start_time=recipe.start_time_utc, versions=recipe.versions_json)
    entry.attrs["layout_version"] = LAYOUT_VERSION
    for name, kind in SCALARS.items():
        value: Any = Outcome.RUNNING.encode() if name == "outcome" else b"" if kind.startswith("|S") else 0
        entry.create_dataset(name, data=np.array(value, dtype=kind))
    entry.create_dataset(MEASURED, data=np.array(b"", dtype=f"|S{MEASURED_BYTES}"))
    for name, text in recipe.verbatim.items():
        _set(_fixed_bytes(entry, name, text), sha256=hashlib.sha256(text).hexdigest())
    entry.create_dataset("bit_depth", data=np.uint8(recipe.format.bit_depth))
    _fixed_bytes(entry, "pixel_format", recipe.format.pixel_format.encode())
    if recipe.sources is not None:
        write_sources(entry, recipe.sources)
    if recipe.plan is not None:
        _write_checks(entry, recipe)
    _write_data(entry, recipe)


def _write_checks(entry: h5py.Group, recipe: ScanRecipe) -> None:
    checks = entry.create_group("checks")
    _set(checks, NX_class="NXcollection", roles=" ".join(CHECK_ROLES))
    count = len(CHECK_ROLES)
    checks.create_dataset("status", data=np.zeros(count, dtype="|u1"))
    checks.create_dataset("crc32", data=np.zeros(count, dtype="<u4"))
    _pixels(checks, (count, *recipe.format.shape), recipe.format.dtype)


def _write_data(entry: h5py.Group, recipe: ScanRecipe) -> None:
    data = entry.create_group("data")
    rank = 1 + len(recipe.format.shape)
    _set(data, NX_class="NXdata", signal="data")
    data.attrs["axes"] = np.array([recipe.axis] + ["."] * (rank - 1), dtype="S")
    data.attrs[f"{recipe.axis}_indices"] = 0
    for name, values in _first_values(recipe).items():
        data.create_dataset(name, data=values)
    _set(data["position_um"], units="um", long_name="stage position at mid-exposure (um)")
    epoch = np.datetime64(recipe.epoch_utc_ns, "ns")
    _set(data["exposure_start_ns"], units="ns", clock="monotonic", epoch_utc=f"{epoch}Z")
    data["exposure_start_ns"].attrs["epoch_utc_ns"] = np.int64(recipe.epoch_utc_ns)
    pixels = _pixels(data, (recipe.count, *recipe.format.shape), recipe.format.dtype)
    _set(pixels, long_name="intensity (counts)", interpretation="image" if rank == 3 else "rgb-image")


def _first_values(recipe: ScanRecipe) -> dict[str, NDArray[Any]]:
    """Per-frame values before any frame is there: positions as planned, ids unknown, everything else zero."""
    values = {name: np.zeros(recipe.count, dtype=kind) for name, kind in FRAME_FIELDS.items()}
    values["trigger_id"][:] = values["camera_frame_id"][:] = -1
    if recipe.plan is None:
        pitch_um = np.nan if recipe.um_per_frame is None else recipe.um_per_frame
        values["position_um"][:] = np.arange(recipe.count) * pitch_um
        values["position_steps"][:] = -1
        values["frame_number"] = np.arange(1, recipe.count + 1, dtype="<i8")
    else:
        values["position_um"][:] = recipe.plan.positions_um()
        values["position_steps"][:] = recipe.plan.first_steps + np.arange(recipe.count) * recipe.plan.pitch_steps
    return values


def _pixels(group: h5py.Group, shape: tuple[int, ...], kind: str) -> h5py.Dataset:
    """Create a dataset with contiguous layout, early allocation and no fill: its offset is fixed from the start."""
    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_layout(h5py.h5d.CONTIGUOUS)
    creation.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    creation.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    kind_id = h5py.h5t.py_create(np.dtype(kind), logical=True)
    return h5py.Dataset(h5py.h5d.create(group.id, b"data", kind_id, h5py.h5s.create_simple(shape), creation))


def _fixed_bytes(group: h5py.Group, name: str, text: bytes) -> h5py.Dataset:
    return group.create_dataset(name, data=np.array(text, dtype=f"S{max(1, len(text))}"))


def _set(owner: h5py.Group | h5py.Dataset, **texts: str) -> None:
    """Attributes as fixed-length bytes: variable-length text lives in a heap that HDF5 may move."""
    for name, text in texts.items():
        raw = text.encode()
        owner.attrs[name] = np.array(raw, dtype=f"S{max(1, len(raw))}")
