"""Imports a folder of pictures, or a TIFF stack, as a sealed scan, once it is proven to be one sequence."""

from __future__ import annotations

import json
import os
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

import msgspec
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat, Image, Purpose
from acquire.contract.process.clocks import utc_now_iso
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.scan_data.dataset_names import REASON_BYTES
from acquire.contract.scan_data.source_files import SourceFile, Sources
from acquire.contract.states import Outcome
from acquire.pictures.names import readable
from acquire.pictures.sequence import Asked, PictureSequence, prove_sequence
from acquire.writer.create_file import ScanRecipe, create_file
from acquire.writer.scan_file import ScanExistsError, ScanFile

from .original_program import OriginalFolder, look_for_original

Progress = Callable[[int, int], None]
"""Called with (pictures done, pictures): each is looked at, then written."""

_DECODERS: Final = 2
_AHEAD: Final = 4
"""Frames in memory at a time."""


class ImportSummary(msgspec.Struct, frozen=True):
    """What was imported."""

    path: str
    """The scan file."""
    frames: int
    """Pictures in it."""
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
    expected: int = 0
    """Frames of the scan, missing ones included."""
    numbers: str = ""
    """What the numbers in the names say; empty where they were not asked."""
    missing: str = ""
    """Which frames are missing, in words."""

    @property
    def complete(self) -> bool:
        """No frame is missing."""
        return self.frames == self.expected

    def words(self) -> str:
        """Summary in one line."""
        shape = f"{self.format.width} x {self.format.height} {self.format.pixel_format}, {self.format.bit_depth} bit"
        count = f"{self.frames}" if self.complete else f"NOT COMPLETE, {self.frames} of {self.expected}"
        line = f"{readable(self.path)}: {count} frames of {shape}, from {self.first_frame} to {self.last_frame}"
        return "; ".join(part for part in (line, self.numbers, self.missing, self.note) if part)


def import_folder(
    frames_dir: Path,
    target: Path,
    *,
    force: bool = False,
    purpose: Purpose = "raw",
    name: str = "",
    um_per_frame: float | None = None,
    asked: Asked | None = None,
    progress: Progress = lambda _done, _total: None,
) -> ImportSummary:
    """Write the pictures of ``frames_dir`` as the sealed scan ``target``.

    Channels are kept; colour is stored as RGB. 16-bit values are stored with the depth that they have. A few frames are
    in memory at a time.

    Args:
        frames_dir: a folder with png, bmp, jpg or tif, or a TIFF stack.
        target: the .h5 to make; it appears when it is whole.
        force: replace a target that is there.
        purpose: ``object`` and ``calibration`` scans need what ``raw`` ones do not.
        name: of the scan; the folder's by default.
        um_per_frame: travel of the stage from one frame to the next in um; None: as a projector.txt of the original
            program beside the pictures tells, else not known.
        asked: how the sequence is chosen and proven, where not by default.
        progress: see ``Progress``.

    Raises:
        UnprovenError: the pictures are not proven to be a sequence; everything against it is in the text.
        ScanFileError: no pictures, or a target in the way.
        DiskError: the disk refused.
    """
    _check_target(target, force=force)
    sequence = prove_sequence(frames_dir, asked, lambda done, total: progress(done, 2 * total))
    present = [index for index, look in enumerate(sequence.frames) if look is not None]
    original = look_for_original(frames_dir) if um_per_frame is None else None
    if original is not None:
        um_per_frame = original.um_per_frame(len(sequence.frames))
    note = _note(sequence, original)
    recipe = ScanRecipe(
        scan_uid=uuid.uuid4().hex,
        format=sequence.format,
        count=len(sequence.frames),
        user_json=json.dumps(
            {
                "name": name or readable(frames_dir.resolve().name),
                "notes": "; ".join(part for part in (_origin(frames_dir), sequence.missing, note) if part),
                "purpose": purpose,
            }
        ),
        start_time_utc=utc_now_iso(),
        um_per_frame=um_per_frame,
        sources=_sources(sequence),
    )
    with _new_scan(target, recipe, force=force) as scan, closing(_read(sequence, present)) as frames:
        for done, (frame_index, pixels) in enumerate(zip(present, frames, strict=True), 1):
            scan.write_frame(_header(frame_index, pixels, sequence.format, um_per_frame), pixels)
            progress(len(present) + done, 2 * len(present))
        seal = scan.seal(*_outcome(sequence))
    return ImportSummary(
        path=str(seal.path),
        frames=seal.committed,
        format=recipe.format,
        first_frame=readable(sequence.present[0].place.path.name),
        last_frame=readable(sequence.present[-1].place.path.name),
        digest=seal.digest,
        um_per_frame=um_per_frame,
        note=note,
        expected=recipe.count,
        numbers=sequence.numbers,
        missing=sequence.missing,
    )


def _origin(frames_dir: Path) -> str:
    return f"imported from {readable(frames_dir.resolve())}"


def _note(sequence: PictureSequence, original: OriginalFolder | None) -> str:
    notes = [*sequence.notes, *([original.note(len(sequence.frames))] if original is not None else [])]
    return "; ".join(notes)


def _outcome(sequence: PictureSequence) -> tuple[Outcome, str]:
    """COMPLETE only where no frame is missing; the reason is cut to what the file has room for."""
    if not sequence.missing:
        return Outcome.COMPLETE, "imported"
    reason = f"imported, frames are missing: {sequence.missing}".encode()[:REASON_BYTES]
    return Outcome.STOPPED, reason.decode("utf-8", "ignore")


def _sources(sequence: PictureSequence) -> Sources:
    files = tuple(
        SourceFile()
        if look is None
        else SourceFile(os.fsencode(look.place.path.name), look.size_bytes, look.sha256, look.place.page)
        for look in sequence.frames
    )
    folder = readable(sequence.place.resolve())
    return Sources(folder, readable(sequence.pattern), sequence.numbers, sequence.depth.words, files)


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


def _read(sequence: PictureSequence, present: list[int]) -> Generator[NDArray[Any], None, None]:
    """Frames in order; a few are read ahead in threads."""
    with ThreadPoolExecutor(_DECODERS, thread_name_prefix="decode") as pool:
        ahead: deque[Future[NDArray[Any]]] = deque()
        try:
            for frame_index in present:
                ahead.append(pool.submit(sequence.read, frame_index))
                if len(ahead) >= _AHEAD:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()


def _header(frame_index: int, pixels: NDArray[Any], form: FrameFormat, um_per_frame: float | None) -> Image:
    """Header of an imported frame, of which only the pixels are known."""
    return Image(
        frame_index=frame_index,
        position_steps=-1,
        position_um=float("nan") if um_per_frame is None else frame_index * um_per_frame,
        shape=list(form.shape),
        dtype=form.dtype,
        bit_depth=form.bit_depth,
        pixel_format=form.pixel_format,
        crc32=frame_crc32(pixels),
    )
