"""The one reader of pictures: the bytes of a file first, then their pixels. Names need not be UTF-8.

OpenCV decodes; given a file's name instead of its bytes it would die of a name that is no UTF-8. What OpenCV passes
over without a word (a JPEG that is cut short, the further pages of a TIFF) is looked for in the bytes before.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError

from .container import Container, look_into
from .names import readable

SUFFIXES: Final = frozenset({".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff"})

_FLAGS: Final = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
_GREY: Final = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
_MAPPED_BYTES: Final = 1 << 26
"""Files from this size on are mapped, not read: a stack may be larger than the memory."""


class PictureError(ScanFileError):
    """A file that is no picture, or none that a scan can hold; ``why`` follows its name in a sentence."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"{readable(path)} {why}")
        self.why = why


def picture_bytes(path: Path) -> NDArray[np.uint8]:
    """The bytes of a file.

    Raises:
        PictureError: it cannot be read.
    """
    try:
        if path.stat().st_size >= _MAPPED_BYTES:
            return np.memmap(path, np.uint8, "r")
        return np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise PictureError(path, f"cannot be read: {error.strerror}") from None


def read_picture(path: Path) -> NDArray[Any]:
    """Pixels of a file with one picture: uint8 or uint16, [h, w] or [h, w, 3] RGB, C-contiguous, not rotated.

    Raises:
        PictureError: it is no picture, damaged, a stack of several, or of another type.
    """
    raw = picture_bytes(path)
    return decoded(path, raw, the_only_page(path, whole(path, raw)))


def read_grey(path: Path) -> NDArray[Any]:
    """A picture as grey levels, uint8 or uint16 [h, w], not rotated.

    Raises:
        PictureError: as ``read_picture``.
    """
    raw = picture_bytes(path)
    return decoded(path, raw, the_only_page(path, whole(path, raw)), grey=True)


def the_only_page(path: Path, container: Container) -> int:
    """The place of the picture in its file.

    Raises:
        PictureError: there are several.
    """
    pages = container.pages
    if len(pages) > 1:
        raise PictureError(path, f"holds several pictures ({len(pages)} pages), not one")
    return pages[0]


def whole(path: Path, raw: NDArray[np.uint8]) -> Container:
    """The container of a picture.

    Raises:
        PictureError: it is damaged.
    """
    found = look_into(raw)
    if found.damage:
        raise PictureError(path, found.damage)
    return found


def decoded(path: Path, raw: NDArray[np.uint8], page: int = 0, *, grey: bool = False) -> NDArray[Any]:
    """Pixels of one page of a file, as ``read_picture`` and ``read_grey``.

    Raises:
        PictureError: it cannot be decoded, or is of another type.
    """
    pixels = _decode(raw, page, _GREY if grey else _FLAGS)
    if pixels is None:
        raise PictureError(path, "is no readable picture (damaged, or another kind of file)")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise PictureError(path, f"holds {pixels.dtype} values: 8 or 16 bits, unsigned, can be used")
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    return np.ascontiguousarray(pixels)


def _decode(raw: NDArray[np.uint8], page: int, flags: int) -> NDArray[Any] | None:
    _silence()
    try:
        if page == 0:
            return cv2.imdecode(raw, flags)
        done, found = cv2.imdecodemulti(raw, flags, range=(page, page + 1))
        return found[0] if done and len(found) == 1 else None
    except cv2.error:
        return None


@functools.cache
def _silence() -> None:
    """OpenCV's own messages about a damaged picture are for its developers; our error says it in one line."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
