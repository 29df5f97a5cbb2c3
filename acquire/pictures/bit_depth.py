"""How many bits of 16-bit pictures are used, and which: by a look at the values, with a sentence that says why.

Cameras of 10, 12 or 14 bit store their values in files of 16 bit: right-aligned (they end far below full scale),
left-aligned (multiples of 16), or stretched to full scale (multiplied by 257, or by 65535 / 4095 and rounded).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError

FULL: Final = 65_535
USUAL_BITS: Final = (8, 10, 12, 14, 16)
_FEW_LEVELS: Final = 64
"""Fewer levels than this are no scale of a camera: a mask, for example."""


@dataclass(frozen=True)
class BitDepth:
    """What the values of some pictures are taken for."""

    bits: int
    """8 to 16; from 9 on the stored values are right-aligned in 16 bit."""
    table: NDArray[Any] | None = None
    """[65536] stored value by the file's value, uint8 or uint16; None: stored as they are."""
    words: str = ""
    """What was taken and why; empty where there was no question."""

    def stored(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """Pixels as the scan stores them."""
        return pixels if self.table is None else self.table[pixels]


class SeenValues:
    """Which values occur in some pictures."""

    def __init__(self) -> None:
        self._seen: NDArray[np.bool_] = np.zeros(FULL + 1, np.bool_)

    def add(self, pixels: NDArray[Any]) -> None:
        """Take the values of a picture; those of 8 bit ask no question."""
        if pixels.dtype == np.uint16:
            self._seen[pixels.ravel()] = True

    def depth(self, asked: int | None = None) -> BitDepth:
        """The depth of 16-bit pictures; ``asked`` is that of --bit-depth.

        Raises:
            ScanFileError: the values do not fit the depth that was asked for.
        """
        values = np.flatnonzero(self._seen)
        return depth_of(values if len(values) else np.zeros(1, np.int64), asked)


def depth_of(values: NDArray[np.int64], asked: int | None = None) -> BitDepth:
    """The depth of pictures whose different values are ``values``, ascending; as ``SeenValues.depth``."""
    top, step = int(values[-1]), int(np.gcd.reduce(values))
    reach = f"the 16-bit values reach {top} in steps of {step}" if top else "all 16-bit values are 0"
    if asked is not None:
        return _asked(values, asked, reach)
    divisor, how = _divisor(values)
    bits = next(bits for bits in USUAL_BITS if top // divisor < 1 << bits)
    if divisor == 1 and (bits == 16 or not top):
        stretched = _stretched(values)
        if stretched is None:
            return BitDepth(16)
        return BitDepth(stretched[0], stretched[1], _sentence(reach, stretched[0], "stretched to 16 bit"))
    return BitDepth(bits, _table(divisor, bits), _sentence(reach, bits, how))


def _sentence(reach: str, bits: int, how: str) -> str:
    return f"{reach}: taken for {bits} bit, {how} (--bit-depth if that is wrong)"


def _divisor(values: NDArray[np.int64]) -> tuple[int, str]:
    """The common divisor of the values, if it is that of a scale, and how such values lie in 16 bit."""
    step, top = int(np.gcd.reduce(values)), int(values[-1])
    if step <= 1 or top // step < _FEW_LEVELS:
        return 1, "right-aligned"
    if step == 257:
        return step, "stretched to 16 bit"
    return step, "left-aligned" if step & (step - 1) == 0 else f"multiplied by {step}"


def _table(divisor: int, bits: int) -> NDArray[Any] | None:
    if divisor == 1 and bits > 8:
        return None
    return (np.arange(FULL + 1) // divisor).astype(np.uint8 if bits == 8 else np.uint16)


def _stretched(values: NDArray[np.int64]) -> tuple[int, NDArray[Any]] | None:
    """(bits, table) if the values are those of a smaller scale, stretched to full scale in a usual way."""
    for bits in USUAL_BITS[:-1]:
        if len(values) < _FEW_LEVELS or len(values) > 1 << bits:
            continue
        for scale in _stretchings(bits):
            if np.isin(values, scale).all():
                table = np.searchsorted(scale, np.arange(FULL + 1))
                return bits, table.astype(np.uint8 if bits == 8 else np.uint16)
    return None


def _stretchings(bits: int) -> Iterator[NDArray[np.int64]]:
    """What the levels of a scale become: rounded to nearest, rounded down, their bits repeated."""
    levels, most = np.arange(1 << bits), (1 << bits) - 1
    yield (2 * levels * FULL + most) // (2 * most)
    yield levels * FULL // most
    yield (levels << (16 - bits)) | (levels >> (2 * bits - 16))


def _asked(values: NDArray[np.int64], bits: int, reach: str) -> BitDepth:
    top, unit = int(values[-1]), 1 << (16 - bits)
    said = f"{reach}: taken for {bits} bit as asked"
    if top < 1 << bits:
        return BitDepth(bits, _table(1, bits), f"{said}, right-aligned")
    if not (values % unit).any():
        return BitDepth(bits, _table(unit, bits), f"{said}, left-aligned")
    if bits == 8 and not (values % 257).any():
        return BitDepth(bits, _table(257, bits), f"{said}, stretched to 16 bit")
    if (bits in USUAL_BITS) and any(np.isin(values, scale).all() for scale in _stretchings(bits)):
        scale = next(scale for scale in _stretchings(bits) if np.isin(values, scale).all())
        return BitDepth(bits, np.searchsorted(scale, np.arange(FULL + 1)).astype(np.uint16), f"{said}, stretched")
    raise ScanFileError(
        f"{reach}, more than {bits} bit have ({(1 << bits) - 1}), and they are not left-aligned: "
        "leave --bit-depth out, or give a greater one"
    )
