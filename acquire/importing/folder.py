"""Imports a folder of pictures as a sealed scan; refuses a folder that is not one series, naming the first odd file."""

from __future__ import annotations

import json
import uuid
from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.cameras.image_files import format_of, list_pictures, read_picture
from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat, Image, Purpose
from acquire.contract.process.clocks import utc_now_iso
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.states import Outcome
from acquire.writer.create_file import ScanRecipe, create_file
from acquire.writer.scan_file import ScanExistsError, ScanFile

from .original_program import look_for_original

_DECODERS: Final = 2
_AHEAD: Final = 4
"""Frames in memory at a time."""


class ImportSummary(msgspec.Struct, frozen=True):
    """What was imported."""

    path: str
    """The scan file."""
    frames: int
    format: FrameFormat
    first_frame: str
    """Name of the picture that became frame 0."""
    last_frame: str
    digest: str
    """sha256 over the checksums of all frames."""
    um_per_frame: float | None = None
    """Travel from one frame to the next; None: positions are not known."""
    note: str = ""
    """What a person should know; empty where there is nothing."""

    def words(self) -> str:
        """Summary in one line."""
        shape = f"{self.format.width} x {self.format.height} {self.format.pixel_format}, {self.format.bit_depth} bit"
        line = f"{self.path}: {self.frames} frames of {shape}, from {self.first_frame} to {self.last_frame}"
        return f"{line}; {self.note}" if self.note else line


def import_folder(
    frames_dir: Path,
    target: Path,
    *,
    force: bool = False,
    purpose: Purpose = "raw",
    name: str = "",
    um_per_frame: float | None = None,
) -> ImportSummary:
    """Write the pictures of ``frames_dir``, in natural order of their names, as the sealed scan ``target``.

    Depth and channels are kept; colour is stored as RGB. One frame is written at a time, so memory is bounded.

    Args:
        frames_dir: a folder with png, bmp, jpg or tif.
        target: the .h5 to make; it appears when it is whole.
        force: replace a target that is there.
        purpose: ``object`` and ``calibration`` scans need what ``raw`` ones do not.
        name: of the scan; the folder's by default.
        um_per_frame: travel of the stage from one frame to the next in um; None: as a projector.txt of the original
            program beside the pictures tells, else not known.

    Raises:
        ScanFileError: no pictures, one that cannot be read or differs from the first (named), or a target in the way.
        DiskError: the disk refused.
    """
    pictures = list_pictures(frames_dir)
    _check_target(target, force=force)
    first = read_picture(pictures[0])
    original = look_for_original(frames_dir) if um_per_frame is None else None
    if original is not None:
        um_per_frame = original.um_per_frame(len(pictures))
    note = original.note(len(pictures)) if original is not None else ""
    recipe = ScanRecipe(
        scan_uid=uuid.uuid4().hex,
        format=format_of(first, pictures[0]),
        count=len(pictures),
        user_json=json.dumps(
            {
                "name": name or frames_dir.resolve().name,
                "notes": f"imported from {frames_dir.resolve()}" + (f"; {note}" if note else ""),
                "purpose": purpose,
            }
        ),
        start_time_utc=utc_now_iso(),
    )
    with _new_scan(target, recipe, force=force) as scan, closing(_decoded(pictures)) as frames:
        for frame_index, pixels in enumerate(frames):
            header = _header(frame_index, pixels, recipe.format, pictures[frame_index], pictures[0])
            if um_per_frame is not None:
                header = msgspec.structs.replace(header, position_um=frame_index * um_per_frame)
            scan.write_frame(header, pixels)
        seal = scan.seal(Outcome.COMPLETE, "imported")
    return ImportSummary(
        path=str(seal.path),
        frames=seal.committed,
        format=recipe.format,
        first_frame=pictures[0].name,
        last_frame=pictures[-1].name,
        digest=seal.digest,
        um_per_frame=um_per_frame,
        note=note,
    )


def _check_target(target: Path, *, force: bool) -> None:
    if target.is_dir() or target.suffix.lower() not in (".h5", ".hdf5", ".nxs"):
        raise ScanFileError(f"{target} is no name for a scan file: give the .h5 to make, such as {target.name}.h5")
    if target.exists() and not force:
        raise ScanExistsError(f"{target} exists already: --force replaces it")
    if not target.parent.is_dir():
        raise ScanFileError(f"the folder {target.parent} does not exist: make it first")


@contextmanager
def _new_scan(target: Path, recipe: ScanRecipe, *, force: bool) -> Iterator[ScanFile]:
    """A scan under a temporary name beside ``target``; it is removed unless it was sealed."""
    creating, reserved = create_file(target.parent, recipe)
    scan = ScanFile(creating, sealed_path=target, reserved=reserved, replace=force)
    try:
        yield scan
    finally:
        scan.close()
        if not scan.sealed:
            creating.unlink(missing_ok=True)


def _decoded(pictures: list[Path]) -> Generator[NDArray[Any], None, None]:
    """Decoded pictures in order; a few are decoded ahead in threads."""
    with ThreadPoolExecutor(_DECODERS, thread_name_prefix="decode") as pool:
        ahead: deque[Future[NDArray[Any]]] = deque()
        try:
            for path in pictures:
                ahead.append(pool.submit(read_picture, path))
                if len(ahead) >= _AHEAD:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()


def _header(frame_index: int, pixels: NDArray[Any], wanted: FrameFormat, path: Path, first: Path) -> Image:
    """Header of an imported frame, of which only the pixels are known."""
    if pixels.shape != wanted.shape or pixels.dtype != np.dtype(wanted.dtype):
        raise ScanFileError(
            f"{path} is {_describe(pixels.shape, str(pixels.dtype))}, "
            f"but {first.name} is {_describe(wanted.shape, str(np.dtype(wanted.dtype)))}: all frames must be alike"
        )
    return Image(
        frame_index=frame_index,
        position_steps=-1,
        position_um=float("nan"),
        shape=list(wanted.shape),
        dtype="|u1" if wanted.bit_depth == 8 else "<u2",
        bit_depth=wanted.bit_depth,
        pixel_format=wanted.pixel_format,
        crc32=frame_crc32(pixels),
    )


def _describe(shape: tuple[int, ...], kind: str) -> str:
    return f"{shape[1]} x {shape[0]} {'colour' if len(shape) == 3 else 'grey'} {kind}"
