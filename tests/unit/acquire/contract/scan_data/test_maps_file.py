"""maps.h5: what is written is read back, whole or sampled; what is no maps.h5 is refused in one line."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.maps_file import MAPS, MapsHeader, read_maps, write_maps

HEADER = MapsHeader(70, 3, "falling", "auto", 98, "ab" * 32, "0123")
SHAPE = (30, 40)


def some_maps() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    kinds = {"mask": "u1", "crossing": "f8", "sigma": "f4", "quality": "u2"}
    maps = {name: rng.integers(0, 99, SHAPE).astype(kinds.get(name, "u2")) for name in MAPS}
    return maps | {"colour": rng.integers(0, 256, (*SHAPE, 3)).astype("u1")}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_maps(tmp_path / "maps.h5", some_maps(), HEADER)
    return tmp_path / "maps.h5"


def test_maps_and_header_are_read_back(path):
    found = read_maps(path)
    assert found.header == HEADER and list(found.arrays) == list(MAPS)
    for name, expected in some_maps().items():
        assert found.arrays[name].dtype == expected.dtype and np.array_equal(found.arrays[name], expected)


def test_equal_maps_give_equal_files(path):
    again = path.with_name("again.h5")
    write_maps(again, some_maps(), HEADER)
    assert again.read_bytes() == path.read_bytes()


def test_a_sampled_map_has_every_nth_pixel_from_the_first_on(path):
    found = read_maps(path, ("min", "colour"), max_samples=100)
    assert found.step == 4
    assert np.array_equal(found.arrays["min"], some_maps()["min"][::4, ::4])
    assert np.array_equal(found.arrays["colour"], some_maps()["colour"][::4, ::4])


def test_the_header_alone_reads_no_map(path):
    assert read_maps(path, ()).arrays == {}


def _drop(file: h5py.File) -> None:
    del file["sigma"]


def _reshape(file: h5py.File) -> None:
    del file["sigma"]
    file["sigma"] = np.zeros((3, 2), "f4")


def _retype(file: h5py.File) -> None:
    del file["quality"]
    file["quality"] = np.zeros(SHAPE, "f4")


def _forget(file: h5py.File) -> None:
    del file.attrs["contrast"]


@pytest.mark.parametrize("damage", [_drop, _reshape, _retype, _forget])
def test_a_file_of_other_content_is_refused_in_one_line(path, damage):
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(ScanFileError, match=r"maps\.h5 .*reconstruct the scan again") as caught:
        read_maps(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [None, b"", b"no HDF5"])
def test_what_is_no_hdf5_file_is_refused_in_one_line(tmp_path, content):
    if content is not None:
        (tmp_path / "maps.h5").write_bytes(content)
    with pytest.raises(ScanFileError, match=r"is not a readable maps\.h5") as caught:
        read_maps(tmp_path / "maps.h5")
    assert "\n" not in str(caught.value)
