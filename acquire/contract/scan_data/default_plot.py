"""The NeXus default plot of a file of maps: what a viewer of HDF5 files shows when it is opened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import h5py
import numpy as np

AXES: Final = ("row", "column")


def add_default_plot(file: h5py.File, signal: str, long_names: Mapping[str, str]) -> None:
    """Describe maps of the root as one plot: ``/@default`` -> ``/entry@default`` -> ``/entry/data@signal``.

    No map is stored twice (hard links), and no times are stored: equal maps give equal files.

    Args:
        file: with the maps as datasets [h, w] or [h, w, 3].
        signal: the map that is shown first.
        long_names: label with unit of each map that can be shown, ``signal`` among them.
    """
    height, width = file[signal].shape
    file.attrs.update(NX_class="NXroot", default="entry")
    entry = _group(file, "entry", "NXentry")
    entry.attrs["default"] = "data"
    data = _group(entry, "data", "NXdata")
    data.attrs["signal"] = signal
    data.attrs["axes"] = list(AXES)
    data.attrs["auxiliary_signals"] = [name for name in long_names if name != signal and file[name].ndim == 2]
    for index, (axis, length) in enumerate(zip(AXES, (height, width), strict=True)):
        data.create_dataset(axis, data=np.arange(length, dtype="<i4"), track_times=False)
        data[axis].attrs["long_name"] = f"{axis} (px)"
        data.attrs[f"{axis}_indices"] = index
    for name, long_name in long_names.items():
        data[name] = file[name]
        file[name].attrs["long_name"] = long_name
        file[name].attrs["interpretation"] = "image" if file[name].ndim == 2 else "rgb-image"


def _group(parent: h5py.Group, name: str, nx_class: str) -> h5py.Group:
    creation = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
    creation.set_obj_track_times(False)
    group = h5py.Group(h5py.h5g.create(parent.id, name.encode(), gcpl=creation))
    group.attrs["NX_class"] = nx_class
    return group
