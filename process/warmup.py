"""Owns compiling the kernels before the first frame: a sweep must not wait for a compiler."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from acquire.contract.calibration import CameraModel, TranslatingPlane
from acquire.contract.messages import FrameFormat

from .cloud import make_cloud, write_ply
from .fold import Fold
from .geometry import coordinates, plane_table, rays
from .report import versions
from .results import MapsSource, write_maps
from .settings import ReconstructOptions, Recorded, settle

SIZE_PX = 8
_RECORDED = Recorded(FrameFormat(width=SIZE_PX, height=SIZE_PX, bit_depth=16))


def warm_up() -> None:
    """Fold three tiny frames of 8 and of 16 bit, turn them into points, and write these into a folder of their own."""
    camera = CameraModel(
        width=SIZE_PX,
        height=SIZE_PX,
        K=((1.0, 0.0, 4.0), (0.0, 1.0, 4.0), (0.0, 0.0, 1.0)),
        R=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        T=(0.0, 0.0, 0.0),
    )
    plane = TranslatingPlane("frame", (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    for bit_depth, dtype in ((8, np.uint8), (16, np.uint16)):
        fold = Fold((SIZE_PX, SIZE_PX), bit_depth=bit_depth, edge="rising", frames_expected=3)
        for frame_index, level in enumerate((0, 100, 200)):
            fold.add(frame_index, np.full((SIZE_PX, SIZE_PX), level << (bit_depth - 8), dtype))
        maps = fold.result(contrast=50, median=3, noise_counts=1.0, read_columns=None)
        present = np.ones(3, np.bool_)
        frame_t = coordinates(plane, 3, present, np.zeros(3))
        cloud = make_cloud(maps, rays(camera), plane_table(plane), frame_t, left_out=0)
    versions("")
    with tempfile.TemporaryDirectory(prefix="sweepscope-") as folder:
        write_ply(Path(folder) / "cloud.ply", cloud)
        write_maps(Path(folder) / "maps.h5", maps, settle(_RECORDED, ReconstructOptions()), MapsSource("", "", 2))
