"""Which files, or pages of a stack, may be a sequence: by their names alone."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path

from acquire.contract.errors import ScanFileError
from acquire.contract.plan import MAX_FRAMES

from .listing import Listing, list_pictures
from .names import Series, choosing, listed, matching, readable, series_of
from .numbering import Gap, number_of
from .reader import SUFFIXES, picture_bytes, whole

_EMPTY = "is empty"
_SHOWN = 6


@dataclass(frozen=True)
class Asked:
    """What the user asks for with the options of ``import``."""

    pattern: str = ""
    """Shell pattern of the names that are the series; empty: all pictures are."""
    missing_as_missing: bool = False
    """What is missing in the numbers, or cannot be read, becomes a missing frame."""
    as_is: bool = False
    """Take what is there in natural order, unproven."""
    bit_depth: int | None = None
    """Bits of 16-bit pictures; None: by a look at the values."""


@dataclass(frozen=True)
class Place:
    """Where a frame is."""

    index: int
    """Frame index."""
    path: Path
    page: int = 0
    """Of a TIFF stack, counted from 0."""
    stack: bool = False
    """A page of a stack, not a file by itself."""


@dataclass(frozen=True)
class Candidate:
    """Pictures that may be a sequence."""

    place: Path
    pattern: str
    places: tuple[Place, ...]
    count: int
    """Frames, missing ones included."""
    numbers: str = ""
    gaps: tuple[str, ...] = ()
    """What is missing, in words."""
    faults: tuple[str, ...] = ()
    """What the names speak against a sequence, beside gaps."""
    unreadable: list[tuple[str, str]] = field(default_factory=list)
    """(name, reason) of members that are no pictures."""
    notes: tuple[str, ...] = ()


def candidate_in(place: Path, asked: Asked) -> Candidate:
    """The candidate in a folder of pictures or in a TIFF stack.

    Raises:
        ScanFileError: no pictures; several series; a pattern that fits nothing.
    """
    if _is_file(place):
        if place.suffix.lower() not in SUFFIXES:
            raise ScanFileError(
                f"{readable(place)} is neither a folder of pictures nor a TIFF stack: take a video apart into pictures "
                "first, for example with 'ffmpeg -i VIDEO frame_%05d.png'"
            )
        return _stack(place, place)
    listing = _chosen(list_pictures(place), asked)
    if len(listing.names) == 1 and _EMPTY not in listing.odd.values():
        path = listing.paths[0]
        if path.suffix.lower() in (".tif", ".tiff") and len(whole(path, picture_bytes(path)).pages) > 1:
            return _stack(path, place)
    if len(listing.names) + len(listing.odd) > MAX_FRAMES:
        raise ScanFileError(
            f"{readable(place)} holds {len(listing.names) + len(listing.odd)} pictures, more than the {MAX_FRAMES} "
            "that a scan can have"
        )
    return _as_is(listing) if asked.as_is else _series(listing)


def _is_file(place: Path) -> bool:
    try:
        return place.is_file()
    except OSError:  # a name too long, a folder on the way that may not be entered: listing it says so
        return False


def _stack(path: Path, place: Path) -> Candidate:
    pages = whole(path, picture_bytes(path)).pages
    if len(pages) == 1 and path == place:
        raise ScanFileError(f"{readable(path)} holds one picture: give the folder of the frames, or a TIFF stack")
    if len(pages) > MAX_FRAMES:
        raise ScanFileError(f"{readable(path)} holds {len(pages)} pictures, more than the {MAX_FRAMES} of a scan")
    places = tuple(Place(index, path, page, stack=True) for index, page in enumerate(pages))
    return Candidate(place, path.name, places, len(pages), f"pages 1 to {len(pages)} of {readable(path.name)}")


def _chosen(listing: Listing, asked: Asked) -> Listing:
    if not asked.pattern:
        return listing
    names, odd = matching(listing.names, asked.pattern), matching(list(listing.odd), asked.pattern)
    if not names and not odd:
        there = listed([series.words() for series in series_of(listing.names)], _SHOWN)
        raise ScanFileError(
            f"no picture in {readable(listing.folder)} fits --pattern {asked.pattern!r}: there are {there}"
        )
    return Listing(listing.folder, names, {name: listing.odd[name] for name in odd})


def _as_is(listing: Listing) -> Candidate:
    empty = [(name, why) for name, why in listing.odd.items() if why == _EMPTY]
    others = [f"{readable(name)} {why}" for name, why in listing.odd.items() if why != _EMPTY]
    places = tuple(Place(index, path) for index, path in enumerate(listing.paths))
    notes = ["taken as they are, in natural order: nothing proves that none is missing"]
    notes += [f"left out: {listed(others)}"] if others else []
    pattern = listing.names[0] if len(listing.names) == 1 else "*"
    return Candidate(listing.folder, pattern, places, len(places), unreadable=empty, notes=tuple(notes))


def _series(listing: Listing) -> Candidate:
    names = [*listing.names, *(name for name, why in listing.odd.items() if why == _EMPTY)]
    others = [name for name, why in listing.odd.items() if why != _EMPTY]
    kinds = series_of(names or others)
    # what is called like a frame and is none is a frame that cannot be read; anything else is no matter
    members = [name for name in others if names and len(series_of([*names, name])) == 1 == len(kinds)]
    left_out = [f"{readable(name)} {listing.odd[name]}" for name in others if name not in members]
    if len(kinds) > 1:
        raise ScanFileError(_several(listing, kinds, names))
    series = series_of([*names, *members])[0] if names else kinds[0]
    notes = (f"left out: {listed(left_out)}",) if left_out and names else ()
    return _numbered(listing, series, notes)


def _numbered(listing: Listing, series: Series, notes: tuple[str, ...]) -> Candidate:
    faults = [series.contradiction] if series.contradiction else []
    unreadable = [(name, listing.odd[name]) for name in series.names if name in listing.odd]
    if series.members[0].number is None or len(series.members) == 1:
        notes += ("it is a single picture: light that moves needs several",)
        places = tuple(Place(0, listing.folder / name) for name in series.names if name not in listing.odd)
        return Candidate(listing.folder, series.pattern, places, 1, unreadable=unreadable, notes=notes)
    numbering = number_of(series.members)
    places = tuple(
        Place(index, listing.folder / member.name)
        for index, member in zip(numbering.indices, series.members, strict=True)
        if member.name not in listing.odd
    )
    return Candidate(
        listing.folder,
        series.pattern,
        places,
        numbering.count,
        numbering.words(),
        _gap_words(numbering.gaps),
        (*faults, *numbering.faults),
        unreadable,
        notes,
    )


def _gap_words(gaps: tuple[Gap, ...]) -> tuple[str, ...]:
    words = tuple(gap.words() for gap in gaps)
    more = len(words) - _SHOWN
    return (*words[:_SHOWN], f"and {more} more gaps") if more > 0 else words


def _several(listing: Listing, kinds: list[Series], names: list[str]) -> str:
    several = [series for series in kinds if len(series.members) > 1]
    patterns = [found for series in (several or kinds)[:2] if (found := choosing(series, names))]
    shown = " or ".join(shlex.quote(readable(pattern)) for pattern in patterns)
    how = f"choose one with --pattern {shown}".rstrip()
    return (
        f"{readable(listing.folder)} holds {len(kinds)} series, not one: "
        f"{listed([series.words() for series in kinds], _SHOWN)}; nothing was written: {how}, "
        "take the others out, or take all in natural order with --as-is"
    )
