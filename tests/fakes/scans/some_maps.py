"""Maps as the results lane brings them, of a round hill that the light has half crossed."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from acquire.contract.messaging.messages import ResultMaps
from tui.console.link.rig_view import MapsView

HEIGHT, WIDTH = 96, 128


def hill(contrast: int = 70) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimum and maximum (uint8), crossing (float32) of 96 x 128 pixels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    far = np.hypot((x - 64) / 46, (y - 48) / 34)
    high = np.clip(210 - 110 * far + 12 * np.sin(x / 3) * np.cos(y / 3), 14, 250).astype(np.uint8)
    low = (high // 10 + 4).astype(np.uint8)
    crossing = (40 + 3.0 * x + 0.4 * y).astype(np.float32)
    crossing[(high - low < contrast) | (x > 104)] = np.nan
    return low, high, crossing


def live_maps(folded_through: int = 409, scan_uid: str = "uid-1") -> MapsView:
    low, high, crossing = hill()
    header = ResultMaps(
        scan_uid=scan_uid, version=1, folded_through=folded_through, shape=[HEIGHT, WIDTH], step=2, contrast=70.0
    )
    return MapsView.of(header, low.astype("<u2").tobytes() + high.astype("<u2").tobytes() + crossing.tobytes())


def write_maps(folder: Path, contrast: int = 70) -> Path:
    low, high, crossing = hill(contrast)
    with h5py.File(folder / "maps.h5", "w") as file:
        file["min"], file["max"], file["crossing"] = low, high, crossing.astype(np.float64)
        file.attrs.update({"contrast": contrast, "median": 5, "folded_through": 526})
    return folder
