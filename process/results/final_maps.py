"""From a fold to maps and cloud: the crossings by the method of the settings, then the points."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from process.cloud.cloud import PointCloud, make_cloud
from process.cloud.light_planes import coordinates, plane_table
from process.cloud.triangulation import rays
from process.crossings.light_change import marked
from process.crossings.maps import Maps, ReadColumns
from process.edge_fit.early_estimates import EarlyEstimates
from process.edge_fit.filters import filtered
from process.edge_fit.noise_model import assumed_noise
from process.edge_fit.refine import Refined, refine
from process.edge_fit.weighting import FrameSequence
from process.fold.fold import Fold

from .fold_cursor import FoldCursor
from .scan_frames import ScanFrames
from .settings import Settings


def new_fold(settings: Settings, form: FrameFormat, count: int) -> Fold:
    """An empty fold for ``count`` frames."""
    shape = (form.height, form.width)
    return Fold(shape, bit_depth=form.bit_depth, edge=settings.edge, frames_expected=max(count, 1))


def maps_of(fold: Fold, settings: Settings, read_columns: ReadColumns | None = None) -> Maps:
    """The maps of the frames folded so far, by the quick estimate.

    read_columns: reads the grey values of a few pixels in all folded frames; without it, pixels that need the scan
    file have no crossing.
    """
    return fold.result(
        contrast=settings.contrast,
        median=settings.median,
        method=settings.live_method,
        noise_counts=settings.noise_counts,
        read_columns=read_columns,
    )


def final_maps(
    cursor: FoldCursor, frames: ScanFrames, settings: Settings, early: EarlyEstimates | None = None
) -> Refined:
    """The maps of all frames folded, by the method of the settings; what the fold does not know is in the file.

    early: estimates of the same frames that were made while they came; they change nothing but the time this takes.

    Raises:
        ScanFileError: nothing was folded, or the file contradicts what was.
    """
    if not cursor.folded.any():
        raise ScanFileError(f"{frames.layout.path} holds no frame that can be used: there is nothing to reconstruct")
    present = cursor.fold.present

    def levels(pixels: NDArray[np.intp]) -> tuple[NDArray[np.int64], NDArray[Any]]:
        first = np.zeros(len(pixels), np.int64)
        return present, frames.columns_of(present)(pixels, first, first + len(present)).T

    maps = maps_of(cursor.fold, settings, levels)
    if settings.method == "linear":  # the paper's estimate, as it is: neither filtered nor weighted
        maps = marked(maps, frames.other_light())
        return Refined(maps, assumed_noise(settings.noise_counts), np.full(maps.mask.shape, np.nan, np.float32))
    refined = refine(maps, settings.method, sequence_of(frames, present, settings), settings.noise_counts, early)
    return dataclasses.replace(refined, maps=marked(filtered(refined.maps), frames.other_light()))


def sequence_of(frames: ScanFrames, present: NDArray[np.int64], settings: Settings) -> FrameSequence:
    """The folded frames of a scan file as the estimates see them."""
    return FrameSequence(frames.columns_of(present), present, settings.edge, frames.layout.format.bit_depth)


def cloud_of(
    maps: Maps, settings: Settings, folded: NDArray[np.bool_], position_um: NDArray[np.float64]
) -> PointCloud | None:
    """The default cloud of some maps; None without a light plane.

    Raises:
        CalibrationError: the plane counts in um and the scan does not know its positions.
    """
    plane = settings.light_plane
    if settings.calibration is None or plane is None:
        return None
    frame_t = coordinates(plane, len(folded), folded, position_um)
    return make_cloud(maps, rays(settings.calibration.camera), plane_table(plane), frame_t)
