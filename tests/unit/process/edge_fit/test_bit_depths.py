"""The same scan has the same crossings and sigmas within the noise, in whatever depth its levels are stored."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.importing.folder import import_folder
from acquire.pictures.sequence import Asked
from process.crossings.maps import Maps
from process.crossings.quality import Quality
from process.edge_fit.filters import filtered
from process.edge_fit.pixel_columns import columns_of_stack
from process.edge_fit.refine import Method, refine
from process.edge_fit.weighting import FrameSequence, step_of
from process.fold.fold import Fold
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from tests.unit.process.edge_fit.test_edge_fit import edges

F8 = NDArray[np.float64]
Store = Callable[[F8], NDArray[np.generic]]
"""Levels in counts of 8 bit -> as they are stored."""


def rounded(levels: F8, factor: float, unit: int = 1, bits: int = 16) -> NDArray[np.generic]:
    whole = np.clip(np.rint(levels * factor), 0, (1 << bits) - 1) * unit
    return whole.astype(np.uint8 if bits == 8 and unit == 1 else np.uint16)


STORED: dict[str, tuple[int, Store]] = {
    "8 bit": (8, lambda levels: rounded(levels, 1, bits=8)),
    "8 bit x 257 in 16": (16, lambda levels: rounded(levels, 1, 257, bits=8)),
    "8 bit x 256 in 16": (16, lambda levels: rounded(levels, 1, 256, bits=8)),
    "8 bit x 16 in 12": (12, lambda levels: rounded(levels, 1, 16, bits=8)),
    "12 bit": (12, lambda levels: rounded(levels, 4095 / 255, bits=12)),
    "12 bit x 16 in 16": (16, lambda levels: rounded(levels, 4095 / 255, 16, bits=12)),
    "16 bit": (16, lambda levels: rounded(levels, 257)),
}


def scene(flat: float = 0.0) -> F8:
    """Edges of several widths [160 frames, 8, 96]; flat: share of pixels in whose dark plateau nothing varies."""
    parts = [edges(80.3 + k, width=width, pixels=256, seed=k) for k, width in enumerate((0.3, 1.5, 4.0))]
    levels = np.concatenate(parts, axis=2)
    still = np.random.default_rng(1).random(levels.shape[1:]) < flat
    quiet = still & (levels < 40)
    return np.where(quiet, 20.0, levels)


def maps_of(name: str, levels: F8, method: Method, edge: str = "rising") -> Maps:
    bits, store = STORED[name]
    frames = store(levels if edge == "rising" else 255 - levels)
    fold = Fold(frames.shape[1:], bit_depth=bits, edge=edge, frames_expected=len(frames))  # type: ignore[arg-type]
    for index, frame in enumerate(frames):
        fold.add(index, frame)
    maps = fold.result(contrast=40, median=0, method="probit", noise_counts=2.0, read_columns=None)
    sequence = FrameSequence(columns_of_stack(frames), fold.present, edge, bits)  # type: ignore[arg-type]
    return filtered(refine(maps, method, sequence, 2.0).maps)


def points(maps: Maps) -> int:
    return int((np.isfinite(maps.crossing) & ((maps.quality & int(Quality.FILTERED)) == 0)).sum())


@pytest.mark.parametrize("edge", ["rising", "falling"])
@pytest.mark.parametrize("method", ["auto", "probit"])
@pytest.mark.parametrize("flat", [0.0, 0.9])
@pytest.mark.parametrize("name", list(STORED)[1:])
def test_crossings_and_sigmas_do_not_depend_on_the_depth(name, flat, method, edge):
    levels = scene(flat)
    plain, deep = maps_of("8 bit", levels, method, edge), maps_of(name, levels, method, edge)
    assert abs(points(deep) - points(plain)) <= 0.005 * points(plain)
    both = np.isfinite(plain.crossing) & np.isfinite(deep.crossing)
    off = np.abs(plain.crossing - deep.crossing)[both]
    assert np.median(off / plain.sigma[both]) < 0.5 and np.percentile(off, 95) < 0.5
    assert np.median(deep.sigma[both] / plain.sigma[both]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", ["8 bit", "8 bit x 256 in 16", "12 bit x 16 in 16", "16 bit"])
def test_saturated_pixels_are_found_wherever_the_scale_ends(name):
    bright, plain = (maps_of(name, scene() + more, "auto").quality for more in (150, 0))
    assert ((bright & int(Quality.SATURATED)) != 0).all()
    assert ((plain & int(Quality.SATURATED)) == 0).all()


@pytest.mark.parametrize(
    ("factor", "bits", "step"), [(257, 16, 256), (16, 16, 16), (16, 12, 16), (1, 12, 1), (1, 8, 1)]
)
def test_the_step_of_the_levels_is_found_and_at_most_a_count(factor, bits, step):
    stack = factor * np.random.default_rng(2).integers(0, 200, (40, 8, 8))
    stack = stack.astype(np.uint8 if bits == 8 else np.uint16)
    sequence = FrameSequence(columns_of_stack(stack), np.arange(40), "rising", bits)
    assert step_of(sequence, np.arange(64)) == step


@pytest.mark.slow
@pytest.mark.parametrize("asked", [None, 16])
def test_the_frog_in_sixteen_bits_has_the_points_of_eight(real_scan: Path, tmp_path: Path, asked: int | None) -> None:
    found = []
    for factor in (1, 257):
        frames, scan = tmp_path / f"x{factor}", tmp_path / f"x{factor}.h5"
        frames.mkdir()
        for path in sorted((real_scan / "frames").glob("*.jpg")):
            grey = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2GRAY)
            pixels = grey if factor == 1 else grey.astype(np.uint16) * factor
            assert cv2.imwrite(str(frames / f"{path.stem}.png"), pixels)
        import_folder(frames, scan, asked=Asked(bit_depth=asked if factor > 1 else None))
        options = ReconstructOptions(
            calibration=real_scan / "calibration.json", edge="falling", contrast=50, median=0, method="auto",
            out=tmp_path / f"out{factor}",
        )  # fmt: skip
        found.append(reconstruct(scan, options).points)
    assert found[0] > 121_000 and abs(found[1] - found[0]) <= (0 if asked is None else 50)
