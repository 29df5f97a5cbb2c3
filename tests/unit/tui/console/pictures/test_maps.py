"""What people see of the maps: masks, counts, windows, values."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.errors import ScanFileError
from process.crossings.maps import contrast_mask
from tui.console.pictures.maps import (
    MapKind,
    MapSet,
    MapWindow,
    cell_of_cursor,
    cells_of,
    counts_of,
    histogram,
    layers_of,
    mask_of,
    pixel_words,
    sample_at,
    window_on,
)
from tui.console.pictures.maps_file import read_maps


def some_maps(height: int = 48, width: int = 64, *, step: int = 1, bit_depth: int = 8, median: int = 5) -> MapSet:
    rng = np.random.default_rng(7)
    top = 2**bit_depth
    low = rng.integers(0, top // 4, (height, width)).astype(np.uint16)
    high = (low + rng.integers(0, 3 * top // 4, (height, width))).astype(np.uint16)
    crossing = rng.uniform(0, 99, (height, width)).astype(np.float32)
    crossing[rng.uniform(size=crossing.shape) < 0.2] = np.nan
    return MapSet(low, high, crossing, step, 70, bit_depth, 99, 100, median)


@pytest.mark.parametrize("bit_depth", [8, 12])
@pytest.mark.parametrize("median", [0, 3, 5])
def test_the_mask_of_unsampled_maps_is_that_of_the_reconstruction_at_every_threshold(bit_depth, median):
    maps = some_maps(bit_depth=bit_depth, median=median)
    for contrast in (0, 40, 70, 120, 255):
        wanted = contrast_mask(maps.minimum, maps.maximum, contrast, median, bit_depth)
        assert np.array_equal(mask_of(maps, contrast), wanted > 0)


def test_counts_grow_as_the_threshold_falls_and_say_when_they_are_not_exact():
    maps = some_maps()
    found = [counts_of(maps, mask_of(maps, contrast), contrast) for contrast in (150, 100, 70, 30)]
    assert [counts.over_contrast for counts in found] == sorted(counts.over_contrast for counts in found)
    assert all(counts.with_crossing <= counts.over_contrast for counts in found)
    assert found[2].exact and not found[3].exact, "below the fold's threshold crossings are not known"
    coarse = some_maps(step=3)
    assert not counts_of(coarse, mask_of(coarse, 70), 70).exact
    assert counts_of(coarse, np.ones(coarse.shape, bool), 70).over_contrast == 9 * coarse.minimum.size


def test_the_histogram_holds_every_sample():
    maps = some_maps(bit_depth=12)
    assert histogram(maps, 40).sum() == maps.minimum.size


def test_layers_have_fixed_ranges_and_a_crossing_outside_the_mask_is_no_value():
    maps = some_maps()
    mask = mask_of(maps, 100)
    layers = {layer.kind: layer for layer in layers_of(maps, mask)}
    assert (layers[MapKind.MAXIMUM].low, layers[MapKind.MAXIMUM].high) == (0.0, 255.0)
    assert layers[MapKind.CROSSING].high == 99.0
    assert np.isnan(layers[MapKind.CROSSING].values[~mask]).all()


def test_cells_are_means_of_what_they_cover_and_nan_only_where_nothing_is_known():
    values = np.arange(16, dtype=np.float32).reshape(4, 4)
    values[0, 0] = np.nan
    values[2:, 2:] = np.nan
    found = cells_of(values, MapWindow(4, 4), 2, 2)
    assert found[0, 0] == pytest.approx((1 + 4 + 5) / 3)
    assert found[0, 1] == pytest.approx((2 + 3 + 6 + 7) / 4)
    assert np.isnan(found[1, 1])


@pytest.mark.parametrize("size", [(1, 1), (3, 7), (48, 64), (50, 200)])
def test_any_number_of_cells_can_be_drawn_of_any_window(size):
    maps = some_maps()
    window = window_on(maps)
    for _ in range(8):
        found = cells_of(maps.minimum.astype(np.float32), window, *size)
        assert found.shape == size and np.isfinite(found).all()
        window = window.zoomed(1).moved(-5, 9)


def test_zooming_keeps_the_cursor_in_view_and_out_again_shows_everything():
    window = MapWindow(48, 64, row=47, column=0)
    for _ in range(10):
        window = window.zoomed(1)
        assert window.top <= window.row < window.top + window.height
        assert window.left <= window.column < window.left + window.width
    for _ in range(10):
        window = window.zoomed(-1)
    assert (window.top, window.left, window.height, window.width) == (0, 0, 48, 64)


def test_the_cursor_stops_at_the_border_and_takes_the_window_with_it():
    window = MapWindow(48, 64).zoomed(1).zoomed(1).moved(500, 500)
    assert (window.row, window.column) == (47, 63)
    assert window.top + window.height == 48 and window.left + window.width == 64
    window = window.moved(-500, -500)
    assert (window.row, window.column, window.top, window.left) == (0, 0, 0.0, 0.0)


def test_a_cell_that_is_pointed_at_is_the_cell_of_the_cursor():
    window = MapWindow(48, 64, row=5, column=5).zoomed(1)
    for row, column in ((0, 0), (3, 9), (11, 15)):
        assert cell_of_cursor(sample_at(window, row, column, 12, 16), 12, 16) == (row, column)


def test_the_values_under_the_cursor_are_those_of_the_pixel():
    maps = some_maps(step=2)
    mask = np.ones(maps.shape, bool)
    found = pixel_words(maps, mask, MapWindow(48, 64, row=3, column=4))
    low, high = maps.minimum[3, 4], maps.maximum[3, 4]
    assert found.startswith(f"x 8  y 6  min {low}  max {high}  contrast {high - low} (over)  crossing ")
    assert pixel_words(maps, ~mask, MapWindow(48, 64, row=3, column=4)).endswith("(under)  crossing none")


def written(folder: Path, maps: MapSet) -> Path:
    folder.mkdir()
    with h5py.File(folder / "maps.h5", "w") as file:
        file["min"], file["max"] = maps.minimum.astype(np.uint8), maps.maximum.astype(np.uint8)
        file["crossing"] = maps.crossing.astype(np.float64)
        file.attrs.update({"contrast": 70, "median": 3, "folded_through": 98})
    return folder


def test_maps_are_read_back_from_their_file(tmp_path):
    maps = some_maps()
    found = read_maps(written(tmp_path / "scan", maps))
    assert np.array_equal(found.minimum, maps.minimum) and np.array_equal(found.maximum, maps.maximum)
    assert np.array_equal(found.crossing, maps.crossing, equal_nan=True)
    assert (found.contrast, found.median_px, found.folded_through, found.bit_depth) == (70, 3, 98, 8)


def test_maps_that_are_missing_or_broken_are_refused_in_one_line(tmp_path):
    (tmp_path / "none").mkdir()
    with pytest.raises(ScanFileError, match="has no maps.h5 yet: reconstruct it first"):
        read_maps(tmp_path / "none")
    folder = written(tmp_path / "broken", some_maps())
    (folder / "maps.h5").write_bytes(b"not HDF5")
    with pytest.raises(ScanFileError, match="is not a readable maps.h5"):
        read_maps(folder)
    (folder / "maps.h5").unlink()
    with h5py.File(folder / "maps.h5", "w") as file:
        file["min"], file["max"], file["crossing"] = np.zeros((2, 2), "u1"), np.zeros((3, 2), "u1"), np.zeros((2, 2))
    with pytest.raises(ScanFileError, match="different shapes"):
        read_maps(folder)
