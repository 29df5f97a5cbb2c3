"""A viewer that opens one of our HDF5 files shows its default plot: parsers of two viewers must find it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.scan_data.maps_file import MapsHeader, write_maps
from acquire.simulation.truth import Truth, write_truth
from tests.fakes.scans.small_scans import make_scan
from tests.needs import need_module

SHAPE = (6, 8)


def maps(folder: Path) -> Path:
    grey = np.arange(48, dtype=np.uint8).reshape(SHAPE)
    found = {"min": grey, "max": grey, "mask": grey, "quality": grey.astype(np.uint16)}
    found |= {
        "crossing": grey.astype(float),
        "sigma": grey.astype(np.float32),
        "colour": np.zeros((*SHAPE, 3), np.uint8),
    }
    found["crossing"][0, 0] = np.nan
    write_maps(folder / "maps.h5", found, MapsHeader(70))
    return folder / "maps.h5"


def truth(folder: Path) -> Path:
    flat, space = np.zeros(SHAPE), np.zeros((*SHAPE, 3))
    single = flat.astype(np.float32)
    write_truth(
        folder / "truth.h5", Truth(space, flat, space.astype(np.float32), flat.astype(np.uint8), single, single)
    )
    return folder / "truth.h5"


def recorded(folder: Path) -> Path:
    return make_scan(folder / "scan", 5, count=5) / "scan.h5"


FILES = {"maps.h5": (maps, "crossing", 2), "truth.h5": (truth, "crossing", 2), "scan.h5": (recorded, "data", 3)}


@pytest.mark.parametrize("name", FILES)
def test_the_chain_of_defaults_ends_at_a_plot_with_axes_of_its_size(tmp_path, name):
    make, signal, _ = FILES[name]
    with h5py.File(make(tmp_path)) as file:
        assert _text(file.attrs["NX_class"]) == "NXroot"
        entry = file[_text(file.attrs["default"])]
        assert _text(entry.attrs["NX_class"]) == "NXentry"
        data = entry[_text(entry.attrs["default"])]
        assert _text(data.attrs["NX_class"]) == "NXdata" and _text(data.attrs["signal"]) == signal
        axes = [_text(axis) for axis in data.attrs["axes"]]
        assert len(axes) == data[signal].ndim
        for axis, length in zip(axes, data[signal].shape, strict=True):
            assert axis == "." or data[axis].shape == (length,)


@pytest.mark.parametrize("name", FILES)
def test_silx_finds_a_valid_plot(tmp_path, name):
    nxdata = need_module("silx.io.nxdata")
    make, _, least = FILES[name]
    with h5py.File(make(tmp_path)) as file:
        found = nxdata.get_default(file)
        assert found.is_valid and found.issues == []
        assert found.signal.ndim >= least


@pytest.mark.parametrize("name", FILES)
def test_nexpy_finds_the_plot_and_its_axes(tmp_path, name):
    nexus = need_module("nexusformat.nexus")
    make, signal, _ = FILES[name]
    root = nexus.nxload(str(make(tmp_path)))
    found = root.get_default()
    assert found.nxpath == "/entry/data" and found.nxsignal.nxname == signal
    if signal == "crossing":
        assert [axis.nxname for axis in found.nxaxes] == ["row", "column"]


def test_the_plot_stores_no_map_twice(tmp_path):
    with h5py.File(maps(tmp_path)) as file:
        assert file["entry/data/crossing"] == file["crossing"]
        assert set(file) >= {"min", "max", "mask", "crossing", "sigma", "quality", "colour"}


def _text(value: bytes | str) -> str:
    return value.decode() if isinstance(value, bytes) else value
