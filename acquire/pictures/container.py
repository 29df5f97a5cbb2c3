"""Looks into the bytes of a picture file, without decoding it: is it whole, how many pictures, when were they taken."""

from __future__ import annotations

import re
import struct
import threading
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from PIL import Image

Buffer = Any
"""bytes, or an array of them that may be mapped from a file."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_MARKER: Final = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
"""In the coded pixels of a JPEG: a marker, not a stuffed byte and not a restart."""
_END, _EXIF = 0xD9, 0xE1
_TIFF: Final = {b"II*\0": "<", b"MM\0*": ">", b"II+\0": "<", b"MM\0+": ">"}
_SUBFILE, _DESCRIPTION = 254, 270
_IMAGES_CHANNELS: Final = (
    re.compile(r"^images=(\d{1,9})\s*$", re.MULTILINE),
    re.compile(r"(?:^channels=|\bSizeC=\")(\d{1,9})", re.MULTILINE),
)
"""As ImageJ and OME write them into the description of a TIFF."""
_MOST_PAGES: Final = 200_000
_TAKEN, _TAKEN_FRACTION, _CHANGED, _EXIF_IFD = 36867, 37521, 306, 0x8769
_WARNINGS: Final = threading.Lock()
_CUT_SHORT: Final = "is no readable picture (cut short)"


@dataclass(frozen=True)
class Container:
    """A picture file, seen from outside."""

    damage: str = ""
    """Why it cannot be used, after the file's name: ``is empty``; empty where it can."""
    pages: tuple[int, ...] = (0,)
    """Places of its full-size pictures in the file: several in a TIFF stack. Thumbnails are left out."""
    exif: bytes = b""

    def taken_at(self) -> tuple[datetime, bool] | None:
        """When it was taken, and whether the camera says so (else: the last change by any program); None: no word."""
        return _time_of(self.exif) if self.exif else None


def look_into(raw: Buffer) -> Container:
    """The container of a picture; of other formats than PNG, JPEG and TIFF nothing is known."""
    head = bytes(raw[:8])
    if len(raw) == 0:
        return Container(damage="is empty")
    if head == _PNG:
        return _png(raw)
    if head.startswith(_JPEG):
        return _jpeg(bytes(raw))
    if head[:4] in _TIFF:
        return _tiff(raw, _TIFF[head[:4]], big=b"+" in head[:4])
    return Container()


def _png(raw: Buffer) -> Container:
    place, exif = len(_PNG), b""
    while place + 12 <= len(raw):
        size, kind = struct.unpack(">I4s", bytes(raw[place : place + 8]))
        end = place + 12 + size
        if end > len(raw):
            break
        if zlib.crc32(raw[place + 4 : end - 4]) != int.from_bytes(bytes(raw[end - 4 : end]), "big"):
            return Container(damage="is no readable picture (damaged: a checksum in it does not fit)")
        if kind == b"eXIf":
            exif = bytes(raw[place + 8 : end - 4])
        if kind == b"IEND":
            return Container(exif=exif)
        place = end
    return Container(damage=_CUT_SHORT)


def _jpeg(raw: bytes) -> Container:
    place, exif = 2, b""
    # a decoder makes up what is missing, without a word: only the end marker tells
    while found := _MARKER.search(raw, place):
        kind, place = raw[found.end() - 1], found.end()
        if kind == _END:
            return Container(exif=exif)
        size = int.from_bytes(raw[place : place + 2], "big")
        if kind == _EXIF and raw[place + 2 : place + 8] == b"Exif\0\0":
            exif = exif or raw[place + 2 : place + size]
        place += max(size, 2)
    return Container(damage=_CUT_SHORT)


def _tiff(raw: Buffer, order: str, *, big: bool) -> Container:
    pages, description = [], ""
    for number, tags in enumerate(_directories(raw, order, big=big)):
        if number == 0:
            description = _text(raw, order, tags.get(_DESCRIPTION), big=big)
        if not _small_value(order, tags.get(_SUBFILE)) & 1:  # bit 0: a reduced copy of another page
            pages.append(number)
    exif = bytes(raw) if len(pages) <= 1 else b""
    damage = _mixed(description, len(pages)) if pages else _CUT_SHORT
    return Container(damage, tuple(pages) or (0,), exif)


def _mixed(description: str, pages: int) -> str:
    """What forbids to take the pages of a TIFF, one by one, for pictures of one kind; empty where nothing does."""
    images, channels = (_greatest(pattern, description) for pattern in _IMAGES_CHANNELS)
    if channels > 1:
        return f"holds {channels} channels in turn: save one of them by itself"
    if images > pages:
        return f"holds {images} pictures of which {pages} can be found: save them as one file for each"
    return ""


def _greatest(pattern: re.Pattern[str], text: str) -> int:
    return max((int(number) for number in pattern.findall(text)), default=0)


_Tag = tuple[int, bytes]
"""Number of values, and the value or its offset."""


def _directories(raw: Buffer, order: str, *, big: bool) -> Iterator[dict[int, _Tag]]:
    """The tags of each page; ends where the file does."""
    number, entry, offset_kind = ("Q", 20, "Q") if big else ("H", 12, "I")
    width = struct.calcsize(offset_kind)
    place, seen = (8 if big else 4), set[int]()
    while True:
        where = _number(raw, order, offset_kind, place)
        if not where or where in seen or len(seen) >= _MOST_PAGES:
            return
        seen.add(where)
        count = _number(raw, order, number, where)
        begin = where + struct.calcsize(number)
        table = bytes(raw[begin : begin + entry * count]) if count <= 65_535 else b""
        if not count or len(table) < entry * count:
            return
        parts = (table[k : k + entry] for k in range(0, len(table), entry))
        yield {
            int.from_bytes(part[:2], _order_name(order)): (
                int.from_bytes(part[4 : 4 + width], _order_name(order)),
                part[4 + width :],
            )
            for part in parts
        }
        place = begin + entry * count


def _order_name(order: str) -> Any:
    return "little" if order == "<" else "big"


def _number(raw: Buffer, order: str, kind: str, place: int) -> int:
    size = struct.calcsize(kind)
    found = bytes(raw[place : place + size])
    return int(struct.unpack(order + kind, found)[0]) if len(found) == size else 0


def _small_value(order: str, tag: _Tag | None) -> int:
    return 0 if tag is None else int.from_bytes(tag[1][:4], _order_name(order))


def _text(raw: Buffer, order: str, tag: _Tag | None, *, big: bool) -> str:
    if tag is None:
        return ""
    count, value = min(tag[0], 100_000), tag[1]
    if tag[0] > len(value):
        place = _number(value, order, "Q" if big else "I", 0)
        value = bytes(raw[place : place + count])
    return value[:count].rstrip(b"\0").decode("utf-8", "replace")


def _tags(exif: bytes) -> dict[int, Any]:
    found = Image.Exif()
    # Pillow warns of remarks that are cut short; filters of warnings are of the process, not of a thread
    with _WARNINGS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found.load(exif)
            return {**dict(found), **dict(found.get_ifd(_EXIF_IFD))}
        except Exception:  # noqa: BLE001 - a damaged remark in a picture is no reason to refuse it
            return {}


def _time_of(exif: bytes) -> tuple[datetime, bool] | None:
    tags = _tags(exif)
    for tag, by_camera in ((_TAKEN, True), (_CHANGED, False)):
        try:
            when = datetime.strptime(str(tags.get(tag, "")).strip("\0 ")[:19], "%Y:%m:%d %H:%M:%S")
        except ValueError:
            continue
        digits = re.match(r"\d*", str(tags.get(_TAKEN_FRACTION, "")))
        fraction = float(f"0.{digits.group()}") if by_camera and digits and digits.group() else 0.0
        return when.replace(microsecond=min(int(fraction * 1e6), 999_999)), by_camera
    return None
