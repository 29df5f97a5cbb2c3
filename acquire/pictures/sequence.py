"""Proves that pictures are the frames of one sweep, before anything is written: else they are refused with the place.

One series by its names, numbers in equal steps without gaps and doubles, all readable, of one size and type, and no
camera's times against the numbers. Times of the file system prove nothing: copying changes them. Pictures that are the
same, pixel for pixel, are said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import MAX_SIDE_PX, FrameFormat
from acquire.contract.scan_data.checksums import frame_crc32

from .bit_depth import BitDepth, SeenValues
from .candidate import Asked, Candidate, candidate_in
from .listing import told
from .looks import Look, doubles, look_at, of_other_kind, times_against
from .names import listed, readable
from .reader import decoded, picture_bytes

__all__ = ["Asked", "PictureSequence", "UnprovenError", "prove_sequence"]


class UnprovenError(ScanFileError):
    """Pictures that are not proven to be a sequence: what speaks against it, and the options of ``import``."""

    def __init__(self, place: Path, facts: Iterable[str], options: str) -> None:
        self.fact = f"{readable(place)} is not taken for a sequence: {'; '.join(facts)}"
        super().__init__(f"{self.fact}; nothing was written: {options}")


@dataclass(frozen=True)
class PictureSequence:
    """The frames of one sweep in files."""

    place: Path
    """The folder, or the file of a stack."""
    pattern: str
    """Their names, as a person reads them."""
    numbers: str
    """What the numbers in the names say; empty where they were not asked."""
    frames: tuple[Look | None, ...]
    """By frame index; None: this frame is missing."""
    format: FrameFormat
    depth: BitDepth
    missing: str = ""
    """Which frames are missing and why, in words; empty where none is."""
    notes: tuple[str, ...] = ()

    @property
    def present(self) -> list[Look]:
        """The pictures, in order."""
        return [look for look in self.frames if look is not None]

    def read(self, frame_index: int) -> NDArray[Any]:
        """Pixels of a frame as a scan stores them; IndexError where it is missing.

        Raises:
            PictureError, ScanFileError: the file has changed since it was looked at.
        """
        look = self.frames[frame_index]
        if look is None:
            raise IndexError(f"frame {frame_index} is missing")
        pixels = decoded(look.place.path, picture_bytes(look.place.path), look.place.page)
        if frame_crc32(pixels) != look.crc32:
            raise ScanFileError(f"{readable(look.place.path)} changed while it was read: wait until all are written")
        return self.depth.stored(pixels)


def prove_sequence(
    place: Path, asked: Asked | None = None, progress: Callable[[int, int], None] = lambda _done, _total: None
) -> PictureSequence:
    """The sequence in ``place``, a folder of pictures or a TIFF stack.

    Args:
        place: folder or file.
        asked: what the user wants otherwise.
        progress: called with (pictures looked at, pictures).

    Raises:
        UnprovenError: it is not proven to be one; everything that speaks against it is in the text.
        ScanFileError: no pictures there, or too large ones.
    """
    asked = asked or Asked()
    found = candidate_in(place, asked)
    seen = SeenValues()
    looks, unreadable = look_at(found.places, seen, progress)
    unreadable = [*found.unreadable, *unreadable]
    _refuse_unproven(found, looks, unreadable, asked)
    missing = [*found.gaps, *([told(unreadable)] if unreadable else [])]
    notes = list(found.notes)
    inside, ends = doubles(looks)
    if inside and asked.missing_as_missing:
        looks = [look for look in looks if look.place.index not in inside]
        missing.append(f"{_doubles_words(inside)}: the repeated ones are left out")
    elif inside:
        notes.append(
            f"SUSPICIOUS: {_doubles_words(inside)} (did the camera or the copy hang? --missing-as-missing leaves out "
            "the repeated ones)"
        )
    notes += [f"{words}: did the camera stand still?" for words in ends]
    depth = _depth(looks, seen, asked.bit_depth)
    by_index = {look.place.index: look for look in looks}
    return PictureSequence(
        place,
        found.pattern,
        found.numbers,
        tuple(by_index.get(index) for index in range(found.count)),
        _format(looks[0], depth),
        depth,
        "; ".join(missing),
        tuple(note for note in (*notes, depth.words) if note),
    )


def _refuse_unproven(found: Candidate, looks: list[Look], unreadable: list[tuple[str, str]], asked: Asked) -> None:
    """Raise with all that speaks against a sequence, so that one look at the folder is enough."""
    facts, options = list(found.faults), []
    gaps = list(found.gaps)
    against = "" if asked.as_is else times_against(looks)
    facts += [against] if against else []
    if not asked.missing_as_missing:
        facts += gaps + ([told(unreadable)] if unreadable else [])
        options += ["--missing-as-missing keeps their places empty"] if (gaps or unreadable) and not asked.as_is else []
    if (gaps or against or found.faults) and not asked.as_is and facts:
        options.append("--as-is takes what is there in natural order")
    unlike = of_other_kind(looks)
    facts += [unlike] if unlike else []
    if not looks and not facts:
        facts.append("no picture can be read")
    if facts:
        ways = ", or ".join(options)
        raise UnprovenError(found.place, facts, f"fix it, or {ways}" if ways else "fix it, or take them out")


def _doubles_words(inside: dict[int, str]) -> str:
    return listed(list(dict.fromkeys(inside.values())))


def _depth(looks: list[Look], seen: SeenValues, asked: int | None) -> BitDepth:
    if looks[0].kind == "uint16":
        return seen.depth(asked)
    if asked not in (None, 8):
        raise ScanFileError(f"the pictures have 8 bit, not {asked}: leave --bit-depth out")
    return BitDepth(8)


def _format(look: Look, depth: BitDepth) -> FrameFormat:
    height, width = look.shape[:2]
    if max(height, width) > MAX_SIDE_PX:
        name = readable(look.place.path)
        raise ScanFileError(f"{name} is {width} x {height}: at most {MAX_SIDE_PX} pixels a side are possible")
    return FrameFormat(width, height, depth.bits, "rgb" if len(look.shape) == 3 else "mono")
