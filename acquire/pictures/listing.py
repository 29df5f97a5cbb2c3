"""What a folder of pictures holds: its pictures in natural order, and what is called a picture and is none."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from natsort import natsorted

from acquire.contract.errors import ScanFileError

from .names import listed, readable
from .reader import SUFFIXES

_MOST: Final = 1_000_000
"""Entries of a folder beyond which it is no folder of pictures."""
_SUBFOLDERS: Final = 50
OTHER_SUFFIXES: Final = frozenset(
    {".pgm", ".ppm", ".pnm", ".gif", ".webp", ".jp2", ".heic", ".avif", ".exr", ".hdr", ".fits", ".fit", ".raw", ".dng"}
    | {".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".czi", ".lif", ".nd2", ".avi", ".mp4", ".mov", ".mkv"}
)
"""Of pictures and videos that must be converted before."""


@dataclass(frozen=True)
class Listing:
    """The pictures of a folder."""

    folder: Path
    names: list[str]
    """Of its pictures, in natural order (2 before 10)."""
    odd: dict[str, str] = field(default_factory=dict)
    """Names of what looks like a picture and is none, with the reason: a folder, a link to nothing, an empty file."""

    @property
    def paths(self) -> list[Path]:
        """Of its pictures."""
        return [self.folder / name for name in self.names]


def list_pictures(folder: Path) -> Listing:
    """The pictures in ``folder``; hidden files, such as the ``._`` ones of a Mac, are left out.

    Raises:
        ScanFileError: there is no such folder, or nothing in it looks like a picture.
    """
    names, odd = [], {}
    try:
        with os.scandir(folder) as entries:
            for count, entry in enumerate(entries):
                if count >= _MOST:
                    raise ScanFileError(
                        f"{readable(folder)} holds more than {_MOST} files: give the folder of the frames"
                    )
                if entry.name.startswith(".") or Path(entry.name).suffix.lower() not in SUFFIXES:
                    continue
                why = _what_else(entry)
                if why:
                    odd[entry.name] = why
                else:
                    names.append(entry.name)
    except OSError as error:
        raise ScanFileError(
            f"{readable(folder)} cannot be read: {error.strerror}; give the folder of the frames"
        ) from None
    if not names and not odd:
        raise ScanFileError(
            f"{readable(folder)} holds no pictures (png, bmp, jpg or tif): give the folder of the frames"
            + _where_they_are(folder)
            + _what_else_there_is(folder)
        )
    return Listing(folder, natsorted(names), {name: odd[name] for name in sorted(odd)})


def _what_else(entry: os.DirEntry[str]) -> str:
    """Why an entry is no picture; empty where it may be one."""
    try:
        if entry.is_file():
            return "" if entry.stat().st_size else "is empty"
        if entry.is_dir():
            return "is a folder"
    except OSError as error:  # a circle of links, for example
        return f"cannot be read ({error.strerror})"
    return "is a link to nothing" if entry.is_symlink() else "is no file"


def _where_they_are(folder: Path) -> str:
    """Names the folders inside that hold pictures, if this one does not."""
    try:
        inside = natsorted(p.name for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))[:_SUBFOLDERS]
    except OSError:
        return ""
    found = [readable(name) for name in inside if _has_pictures(folder / name)]
    return f"; there are some in {listed(found)}" if found else ""


def _what_else_there_is(folder: Path) -> str:
    """Names the most frequent kind of picture that cannot be read."""
    suffixes = Counter(found for path in folder.iterdir() if (found := path.suffix.lower()) in OTHER_SUFFIXES)
    if not suffixes:
        return ""
    suffix, count = suffixes.most_common(1)[0]
    return f"; it holds {count} {suffix} files: convert them to png or tif first"


def _has_pictures(folder: Path) -> bool:
    try:
        with os.scandir(folder) as entries:
            return any(Path(entry.name).suffix.lower() in SUFFIXES for entry in entries)
    except OSError:
        return False


def told(problems: Iterable[tuple[str, str]]) -> str:
    """Files with what is wrong with them, by reason in one line: ``a.png and b.png are empty``; many are cut short."""
    by_reason: dict[str, list[str]] = {}
    for name, why in problems:
        by_reason.setdefault(why, []).append(readable(name))
    return "; ".join(f"{listed(names)} {_plural(why) if len(names) > 1 else why}" for why, names in by_reason.items())


def _plural(why: str) -> str:
    verb, _, rest = why.partition(" ")
    return (
        {"is": "are", "has": "have", "holds": "hold"}.get(verb, verb)
        + " "
        + rest.replace("no readable picture", "no readable pictures")
    )
