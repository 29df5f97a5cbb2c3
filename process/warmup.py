"""Compiles the kernels, or loads them from the cache, before the first frame: a sweep must not wait for a compiler."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel, TranslatingPlane
from acquire.contract.scan_data.maps_file import MapsHeader, write_maps
from process.cloud.cloud import make_cloud
from process.cloud.light_planes import coordinates, plane_table
from process.cloud.ply import write_ply
from process.cloud.triangulation import rays
from process.crossings.maps import Maps, empty_samples
from process.crossings.two_sample_kernels import sample_columns
from process.edge_fit.early_estimates import EdgeEstimates, estimate_pixels, follow_pixels
from process.edge_fit.filters import filtered
from process.edge_fit.noise_model import assumed_noise
from process.edge_fit.pixel_columns import columns_of_stack
from process.edge_fit.pixel_kernels import FITTED
from process.edge_fit.refine import refine
from process.edge_fit.weighting import EdgeWeighting, FrameSequence, first_at_half
from process.fold.fold import Fold
from process.results.report import versions
from process.results.write import map_arrays

SIZE_PX = 8
FRAMES = 12
"""More than the fold keeps before it makes a pass over its state."""


def warm_up() -> None:
    """Fold a few tiny frames of each kind, make points of them, and write these to a temporary folder."""
    camera = CameraModel(
        width=SIZE_PX,
        height=SIZE_PX,
        K=((1.0, 0.0, 4.0), (0.0, 1.0, 4.0), (0.0, 0.0, 1.0)),
        R=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        T=(0.0, 0.0, 0.0),
    )
    plane = TranslatingPlane("frame", (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    for bit_depth, channels in ((8, 1), (8, 3), (16, 1), (16, 3)):
        fold = Fold((SIZE_PX, SIZE_PX), bit_depth=bit_depth, edge="rising", frames_expected=FRAMES)
        for frame_index in range(FRAMES):
            fold.add(frame_index, _frame(frame_index, bit_depth, channels), keep=True)
        maps = fold.result(contrast=50, median=3, noise_counts=1.0, read_columns=None)
        _estimate(maps, fold, bit_depth)
        present = np.ones(FRAMES, np.bool_)
        frame_t = coordinates(plane, FRAMES, present, np.zeros(FRAMES))
        cloud = make_cloud(maps, rays(camera), plane_table(plane), frame_t, left_out=0)
    versions("")
    with tempfile.TemporaryDirectory(prefix="sweepscope-") as folder:
        write_ply(Path(folder) / "cloud.ply", cloud.vertices())
        write_maps(Path(folder) / "maps.h5", map_arrays(maps), MapsHeader(contrast=50))


def _estimate(maps: Maps, fold: Fold, bit_depth: int) -> None:
    """Estimate the whole edges of a scan of this depth, and read pixels that the log does not know."""
    levels = np.stack([_frame(k, bit_depth, 1) for k in range(FRAMES)])
    sample_columns(np.ascontiguousarray(levels[:, 0, :1]), empty_samples(1))
    sequence = FrameSequence(columns_of_stack(levels), fold.present, "rising", bit_depth)
    filtered(refine(maps, "auto", sequence, 1.0).maps)
    pixel, start, extent = np.zeros(1, np.int64), np.ones(1, np.int64), np.ones(1)
    weighting = EdgeWeighting(assumed_noise(1.0), 1.0)
    found = estimate_pixels(sequence, weighting, pixel, start, extent, local=True, early=True)
    known = EdgeEstimates(np.full(1, FITTED), found.columns, np.zeros(1, np.int64))
    follow_pixels(sequence, weighting, pixel, start, known)
    first_at_half(sequence.columns(pixel, 0 * start, start), sequence.full, 1, start)


def _frame(frame_index: int, bit_depth: int, channels: int) -> NDArray[np.generic]:
    """A read-only frame, as those from a socket or a file are."""
    dtype = np.uint8 if bit_depth == 8 else np.uint16
    shape = (SIZE_PX, SIZE_PX) if channels == 1 else (SIZE_PX, SIZE_PX, channels)
    level = dtype((20 * frame_index) << (bit_depth - 8))
    return np.frombuffer(np.full(shape, level, dtype).tobytes(), dtype).reshape(shape)


if __name__ == "__main__":
    warm_up()
