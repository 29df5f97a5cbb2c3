"""Calibration sweeps: crossing and sigma of each clean pixel, and a picture without a light edge."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.file_layout import ScanLayout
from acquire.contract.scan_data.maps_file import read_maps
from process.crossings.quality import Quality
from process.results.reconstruct import NEARLY_ALL, reconstruct
from process.results.scan_frames import ScanFrames
from process.results.settings import Edge, ReconstructOptions

F8 = NDArray[np.float64]
UNUSABLE = (
    Quality.LIT_AT_START
    | Quality.PLATEAU_NOT_REACHED
    | Quality.NO_DARK_LEVEL
    | Quality.SATURATED
    | Quality.SEVERAL
    | Quality.FILTERED
)
MOSTLY = 0.3
"""Share of the lit pixels with the same fault beyond which a sweep is refused."""
MIN_PIXELS = 500
MIN_PATTERN_CONTRAST = 40.0


@dataclass(frozen=True)
class FoldedSweep:
    """A calibration sweep, folded."""

    name: str
    crossing: F8
    """[h, w] 0-based frame index, NaN where it cannot be used."""
    sigma: F8
    """[h, w] frames."""
    picture: NDArray[np.generic]
    """[h, w] grey without a light edge in it, for finding the board."""
    frame_t: F8
    """[frames] sweep coordinate in the unit of ``parameter``."""
    parameter: str
    """``position_um`` where the scan knows its positions, else ``frame``."""
    plan: SweepPlan | None
    format: FrameFormat
    zero_id: str = ""
    """Homing that its positions count from; empty where that is not known."""

    @property
    def t(self) -> F8:
        """[h, w] crossing in the unit of ``parameter``."""
        index = np.arange(len(self.frame_t), dtype=np.float64)
        return np.asarray(np.interp(self.crossing, index, self.frame_t), dtype=np.float64)

    @property
    def unit_per_frame(self) -> float:
        """Change of t per frame."""
        return float(np.median(np.diff(self.frame_t)))


def fold_sweep(
    scan: Path, *, method: str = "auto", edge: Edge | None = None, contrast: int | None = None, clean: bool = True
) -> FoldedSweep:
    """Fold SCAN and keep the pixels that crossed once, cleanly, from dark to a plateau.

    ``clean`` False keeps every crossing: a shadow that passes has no plateau to reach.

    Raises:
        ScanFileError, ConfigError: as ``reconstruct``.
        CalibrationError: too many pixels have a fault: the sweep is too short, light leaks, saturation.
    """
    with tempfile.TemporaryDirectory(prefix="sweepscope-") as folder:
        options = ReconstructOptions(method=method, edge=edge, contrast=contrast, out=Path(folder), force=True)
        summary = reconstruct(scan, options)
        maps = read_maps(summary.paths.maps).arrays
    crossing, sigma, quality = (maps[name] for name in ("crossing", "sigma", "quality"))
    mask, low, high = (maps[name] for name in ("mask", "min", "max"))
    with ScanFrames(scan) as frames:
        layout, positions = frames.layout, frames.field("position_um")
    name = sweep_name(layout)
    if clean:
        _refuse_faults(name, quality[mask != 0], int((mask != 0).sum()))
    frame_t, parameter = coordinate_of(positions)
    if clean:
        crossing = np.where((quality & int(UNUSABLE)) == 0, crossing, np.nan)
    depth = 2.0 ** (layout.format.bit_depth - 8)
    return FoldedSweep(
        name, crossing, sigma.astype(np.float64), _pattern_picture(low, high, depth), frame_t,
        parameter, layout.plan, layout.format, layout.zero_id,
    )  # fmt: skip


def sweep_coordinate(scan: Path) -> tuple[F8, str]:
    """Sweep coordinate of each frame [frames], and its unit; as coordinate_of.

    Raises:
        ScanFileError: no readable scan.
    """
    with ScanFrames(scan) as frames:
        return coordinate_of(frames.field("position_um"))


def sweep_name(layout: ScanLayout) -> str:
    """Name of a sweep in messages: that of its folder, or of a file that lies by itself."""
    return layout.path.parent.name if layout.path.name.startswith("scan.") else layout.path.stem


def coordinate_of(positions: F8) -> tuple[F8, str]:
    """Sweep coordinate [frames] and its unit: positions in um where all are known, else 1-based frame numbers."""
    if np.isfinite(positions).all():
        return positions, "position_um"
    return np.arange(1, len(positions) + 1, dtype=np.float64), "frame"


def _pattern_picture(low: NDArray[np.generic], high: NDArray[np.generic], depth: float) -> NDArray[np.generic]:
    """Minimum where room light shows the pattern in it, else maximum: neither has a light edge."""
    contrast = float(np.subtract(*np.percentile(low.astype(np.float64), [95, 5])))
    return low if contrast >= MIN_PATTERN_CONTRAST * depth else high


_FAULTS = {
    Quality.NO_DARK_LEVEL: "never get dark: light leaks in, or the sweep begins within the light",
    Quality.LIT_AT_START: "are lit in the first frame already: the sweep begins too late, start it further out",
    Quality.PLATEAU_NOT_REACHED: "are still within the edge in the last frame: the sweep is too short",
    Quality.SATURATED: "are saturated: lower exposure or gain",
}


def _refuse_faults(name: str, quality: NDArray[np.generic], lit: int) -> None:
    if lit < MIN_PIXELS:
        raise CalibrationError(
            f"{name}: only {lit} pixels change their brightness enough: lamp off, or a sweep too short or elsewhere"
        )
    lit_first = float((quality.astype(np.int64) & int(Quality.LIT_AT_START) != 0).mean())
    if lit_first > NEARLY_ALL:
        raise CalibrationError(
            f"{name}: {100 * lit_first:.0f} % of the pixels begin beyond half brightness: the light goes the other way "
            "than the edge that was looked for; with --edge falling (or rising) it is the other one"
        )
    for bit, text in _FAULTS.items():
        share = float((quality.astype(np.int64) & int(bit) != 0).mean())
        if share > MOSTLY:
            raise CalibrationError(f"{name}: {100 * share:.0f} % of the lit pixels {text}")
