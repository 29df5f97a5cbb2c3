"""The colour maps of console, page and figures, which show the same value in the same colour."""

from __future__ import annotations

from functools import cache
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

MapName = Literal["viridis", "cividis", "blue-orange"]

LEVELS: Final = 256
NO_VALUE_RGB: Final = (110, 110, 118)
"""Where there is no value (NaN): a grey that no map contains."""
_ANCHORS: Final[dict[MapName, str]] = {
    "viridis": "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c "
    "1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 fde725",
    "cividis": "00224e 002e6a 1a386f 32436d 434e6c 535a6d 61656f 6f7073 7d7c78 "
    "8c8878 9b9476 aba072 bcae6c cdbb63 dec958 f0d846 fee838",
    "blue-orange": "12468f 2f6fb5 5b97d0 97c1e4 c9deee ecebe6 f6d6ae f2b06a e48732 c25f12 8a3d06",
}
"""Evenly spaced; all three stay apart for the colour-blind, the first two grow lighter all the way."""
QUANTITY_MAP: Final[dict[str, MapName]] = {
    "height": "viridis",
    "crossing": "cividis",
    "sigma": "cividis",
    "deviation": "blue-orange",
    "minimum": "viridis",
    "maximum": "viridis",
}
"""Which quantity is shown in which map; signed ones in the one with a neutral middle."""


@cache
def table(name: MapName) -> NDArray[np.uint8]:
    """The map's colours from the lowest value to the highest, read-only, shape [256, 3] RGB."""
    anchors = np.array([list(bytes.fromhex(code)) for code in _ANCHORS[name].split()], np.float64)
    at = np.linspace(0, len(anchors) - 1, LEVELS)
    channels = [np.interp(at, np.arange(len(anchors)), anchors[:, channel]) for channel in range(3)]
    found = np.rint(np.stack(channels, axis=1)).astype(np.uint8)
    found.flags.writeable = False
    return found


def coloured(values: ArrayLike, low: float, high: float, name: MapName) -> NDArray[np.uint8]:
    """Values [...] as colours [..., 3]: ``low`` and below the first, ``high`` and above the last, NaN a grey."""
    array = np.asarray(values, np.float32)
    span = high - low if high > low else 1.0
    level = np.clip((array - low) * (LEVELS / span), 0, LEVELS - 1)
    known = np.isfinite(array)
    found = table(name)[np.where(known, level, 0).astype(np.uint8)]
    found[~known] = NO_VALUE_RGB
    return found
