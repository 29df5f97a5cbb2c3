"""Looks at every picture once: is it readable, of what size and type, when was it taken, is it the same as another."""

from __future__ import annotations

import hashlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from acquire.contract.scan_data.checksums import frame_crc32

from .bit_depth import SeenValues
from .candidate import Place
from .names import listed, readable
from .reader import PictureError, decoded, picture_bytes, the_only_page, whole

_DECODERS: Final = 2
_AHEAD: Final = 4
"""Pictures in memory at a time."""
_ROUGH: Final = timedelta(seconds=2)
"""Times that another program than the camera's has written may be off by this: it may have written several at once."""


@dataclass(frozen=True)
class Look:
    """What one picture is."""

    place: Place
    size_bytes: int
    """Of its file."""
    sha256: str
    """Of its file, in hex."""
    shape: tuple[int, ...]
    kind: str
    """uint8 or uint16."""
    crc32: int
    """Of its pixels."""
    taken_at: tuple[datetime, bool] | None
    """As ``Container.taken_at``."""


def look_at(
    places: Sequence[Place], seen: SeenValues, progress: Callable[[int, int], None]
) -> tuple[list[Look], list[tuple[str, str]]]:
    """The looks of readable pictures in order, and (name, reason) of the others; ``seen`` gets the values of all."""
    looks: list[Look] = []
    unreadable: list[tuple[str, str]] = []
    whole_files = _StackFile()
    for done, (place, found) in enumerate(_in_order(places, lambda place: _look(place, whole_files)), 1):
        if isinstance(found, PictureError):
            unreadable.append((place.path.name, found.why))
        else:
            looks.append(found[0])
            seen.add(found[1])
        progress(done, len(places))
    return looks, unreadable


class _StackFile:
    """Size and checksum of a stack, whose pages share them."""

    def __init__(self) -> None:
        self._known: dict[Path, tuple[int, str]] = {}

    def facts(self, path: Path, raw: NDArray[np.uint8], *, stack: bool) -> tuple[int, str]:
        if not stack:
            return len(raw), hashlib.sha256(raw.data).hexdigest()
        if path not in self._known:
            self._known[path] = (len(raw), hashlib.sha256(raw.data).hexdigest())
        return self._known[path]


_Found = tuple[Look, NDArray[Any]] | PictureError


def _look(place: Place, files: _StackFile) -> _Found:
    try:
        raw = picture_bytes(place.path)
        container = None if place.stack else whole(place.path, raw)
        page = place.page if container is None else the_only_page(place.path, container)
        pixels = decoded(place.path, raw, page)
    except PictureError as error:
        return error
    size, sha256 = files.facts(place.path, raw, stack=place.stack)
    taken = None if container is None else container.taken_at()
    return Look(place, size, sha256, pixels.shape, str(pixels.dtype), frame_crc32(pixels), taken), pixels


def _in_order(places: Sequence[Place], look: Callable[[Place], _Found]) -> Iterator[tuple[Place, _Found]]:
    """Looks in order; a few are taken ahead in threads."""
    with ThreadPoolExecutor(_DECODERS, thread_name_prefix="decode") as pool:
        ahead: deque[tuple[Place, Future[_Found]]] = deque()
        for place in places:
            ahead.append((place, pool.submit(look, place)))
            if len(ahead) >= _AHEAD:
                first, future = ahead.popleft()
                yield first, future.result()
        for first, future in ahead:
            yield first, future.result()


def of_other_kind(looks: Sequence[Look]) -> str:
    """Names the pictures of another size or type than most; empty where all are alike."""
    kinds = Counter((look.shape, look.kind) for look in looks)
    if len(kinds) < 2:
        return ""
    (usual, count), *others = kinds.most_common()
    named = [
        f"{listed([_name(look) for look in looks if (look.shape, look.kind) == kind])} {'are' if times > 1 else 'is'} "
        f"{_describe(*kind)}"
        for kind, times in others
    ]
    most = "the other is" if count == 1 else f"the other {count} are"
    return f"{listed(named)}, {most} {_describe(*usual)}: all frames must be alike"


def doubles(looks: Sequence[Look]) -> tuple[dict[int, str], list[str]]:
    """Pictures that are the same as another one, pixel for pixel.

    Returns:
        those in the middle that are not a frame of their own: frame index -> words. Of a run of neighbours the first
        one is (the camera or the copy hung after it); of pictures apart from each other nobody knows which;
        and words for each run of what is seen at an end of the sweep, where nothing need move yet or any more.
    """
    inside: dict[int, str] = {}
    ends: list[str] = []
    for run in _runs(looks):
        words = f"{_name(run[0])} to {_name(run[-1])} are the same picture {len(run)} times"
        if _pixels_of(run[0]) in (_pixels_of(looks[0]), _pixels_of(looks[-1])):
            ends.append(words)
        else:
            inside |= dict.fromkeys((look.place.index for look in run[1:]), words)
    for same in _apart(looks):
        words = f"{listed([_name(look) for look in same])} are the same picture"
        inside |= dict.fromkeys((look.place.index for look in same), words)
    return inside, ends


def _pixels_of(look: Look) -> tuple[object, ...]:
    return look.crc32, look.shape, look.kind


def _runs(looks: Sequence[Look]) -> list[list[Look]]:
    runs = [list(run) for _, run in groupby(looks, key=_pixels_of)]
    return [run for run in runs if len(run) > 1]


def _apart(looks: Sequence[Look]) -> list[list[Look]]:
    """Groups of same pictures, the first of each run, that are no neighbours; those without light are left out.

    A scene without noise looks the same before the light comes and whenever it shines beside all objects.
    """
    by_pixels: dict[tuple[object, ...], list[Look]] = {}
    for pixels, run in groupby(looks, key=_pixels_of):
        by_pixels.setdefault(pixels, []).append(next(run))
    for look in (looks[0], looks[-1]) if looks else ():
        by_pixels.pop(_pixels_of(look), None)
    return [same for same in by_pixels.values() if len(same) > 1]


def times_against(looks: Sequence[Look]) -> str:
    """The first place where a camera's times go back while the numbers go up; empty where they never do."""
    newest: Look | None = None
    for look in looks:
        if look.taken_at is None:
            continue
        when, by_camera = look.taken_at
        if newest is not None and newest.taken_at is not None:
            back = newest.taken_at[0] - when
            if back > (timedelta(0) if by_camera and newest.taken_at[1] else _ROUGH):
                return (
                    f"times and numbers disagree: {_name(look)} was taken at {when}, before {_name(newest)} at "
                    f"{newest.taken_at[0]}"
                )
        if newest is None or newest.taken_at is None or when > newest.taken_at[0]:
            newest = look
    return ""


def _name(look: Look) -> str:
    page = f" page {look.place.page + 1}" if look.place.stack else ""
    return readable(look.place.path.name) + page


def _describe(shape: tuple[int, ...], kind: str) -> str:
    return f"{shape[1]} x {shape[0]} {'colour' if len(shape) == 3 else 'grey'} {kind}"
