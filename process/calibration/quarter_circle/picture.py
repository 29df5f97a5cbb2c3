"""Relative brightness of a sweep of the slide's pattern over a white flat: 0 dark, 1 fully lit, for each pixel.

Frames and maps [h, w] float32; levels in the stored depth, grey.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from process.calibration.light_plane.sweeps import coordinate_of, sweep_name
from process.fold.fold import to_grey
from process.results.scan_frames import ScanFrames

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
NEAR_LEVEL = 0.08
"""Values within this share of a pixel's range of an extreme belong to its dark level or its plateau."""
MIN_CONTRAST = 40.0
"""Least range in counts of 8 bit of a pixel that is used."""
STEADY_SHARE = 0.05
"""Least duration of a plateau, as a share of the median over all lit pixels."""
MIN_LIT = 2000
ERODED_WIDTHS = 3.5
MIN_PLATEAU = 4
"""Least frames of a plateau."""


@dataclass(frozen=True)
class SlideSweep:
    """Dark level and plateau of each pixel of a sweep, and access to its frames."""

    scan: Path
    name: str
    usable: NDArray[np.bool_]
    """[frames] good in the file."""
    dark: F4
    """[h, w] mean dark level."""
    span: F4
    """[h, w] mean plateau minus dark level."""
    lit: NDArray[np.bool_]
    """[h, w] the light reached the pixel at some time; elsewhere its relative brightness is 0."""
    steady: NDArray[np.bool_]
    """[h, w] the pixel had a dark level and a plateau, so that its half is known."""
    frame_t: F8
    """[frames] sweep coordinate in the unit of ``parameter``."""
    parameter: str
    plan: SweepPlan | None
    format: FrameFormat

    def without_rim(self, width_px: float) -> SlideSweep:
        """The sweep with ``steady`` only at ERODED_WIDTHS widths of the blur from the rim of the lit area.

        A pixel that the rim of the pattern just grazes has a flat, but too low maximum.
        """
        side = 2 * round(ERODED_WIDTHS * width_px) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        half = self.span >= 0.5 * float(np.median(self.span[self.lit]))
        inner = cv2.erode((half & self.lit).astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=1)
        return replace(self, steady=self.steady & (inner != 0))

    def with_plateaus(self, inside: Callable[[float], NDArray[np.bool_]], indices: NDArray[np.intp]) -> SlideSweep:
        """The sweep with plateaus from the frames in which a pixel is fully lit by ``inside`` (t -> mask [h, w]).

        Near the rim of the swept area many values lie just below the plateau and would lower it.
        """
        total, count = np.zeros_like(self.dark), np.zeros_like(self.dark)
        with ScanFrames(self.scan) as frames:
            for index, grey in _greys(frames, indices):
                own = inside(float(self.frame_t[index]))
                total += np.where(own, grey, 0)
                count += own
        steady = self.steady & (count >= MIN_PLATEAU)
        span = np.where(steady, total / np.maximum(count, 1) - self.dark, self.span)
        return replace(self, span=span.astype(np.float32), steady=steady)

    def frames(self, indices: NDArray[np.intp]) -> Iterator[tuple[int, F4]]:
        """(frame index, relative brightness [h, w]) of some frames."""
        with ScanFrames(self.scan) as frames:
            for index, grey in _greys(frames, indices):
                yield index, np.where(self.lit, (grey - self.dark) / self.span, np.float32(0))


def open_slide_sweep(scan: Path) -> SlideSweep:
    """Measure the levels of every pixel; reads the scan twice.

    Raises:
        ScanFileError: no readable scan.
        CalibrationError: hardly any pixel is ever lit.
    """
    with ScanFrames(scan) as frames:
        usable, layout = frames.present(), frames.layout
        indices = np.flatnonzero(usable)
        low, high = _extremes(frames, indices)
        depth = 2.0 ** (layout.format.bit_depth - 8)
        name = sweep_name(layout)
        lit = high - low >= MIN_CONTRAST * depth
        if int(lit.sum()) < MIN_LIT:
            raise CalibrationError(
                f"{name}: only {int(lit.sum())} pixels are ever lit: it takes a sweep over a white flat that fills the "
                "field, the lamp on"
            )
        dark, bright, count = _levels(frames, indices, low, high)
        frame_t, parameter = coordinate_of(frames.field("position_um"))
    typical = float(np.median(count[lit]))
    span = np.where(lit, bright - dark, np.float32(1)).astype(np.float32)
    return SlideSweep(
        scan=scan,
        name=name,
        usable=usable,
        dark=dark,
        span=span,
        lit=lit,
        steady=lit & (count >= max(STEADY_SHARE * typical, 3)),
        frame_t=frame_t,
        parameter=parameter,
        plan=layout.plan,
        format=layout.format,
    )


def _greys(frames: ScanFrames, indices: NDArray[np.intp]) -> Iterator[tuple[int, F4]]:
    checksums = frames.field("crc32")
    for index in indices:
        pixels = frames.pixels(int(index), int(checksums[index]))
        if pixels is not None:
            grey = pixels if pixels.ndim == 2 else to_grey(pixels, frames.layout.format.bit_depth)
            yield int(index), grey.astype(np.float32)


def _extremes(frames: ScanFrames, indices: NDArray[np.intp]) -> tuple[F4, F4]:
    shape = (frames.layout.format.height, frames.layout.format.width)
    low, high = np.full(shape, np.inf, np.float32), np.full(shape, -np.inf, np.float32)
    for _, grey in _greys(frames, indices):
        np.minimum(low, grey, out=low)
        np.maximum(high, grey, out=high)
    return low, high


def _levels(frames: ScanFrames, indices: NDArray[np.intp], low: F4, high: F4) -> tuple[F4, F4, F4]:
    """Mean dark level, mean plateau, and number of frames on the plateau: extremes of noisy samples are biased."""
    margin = NEAR_LEVEL * (high - low)
    sums = [np.zeros_like(low) for _ in range(4)]
    for _, grey in _greys(frames, indices):
        for number, near in enumerate((grey <= low + margin, grey >= high - margin)):
            sums[2 * number] += np.where(near, grey, 0)
            sums[2 * number + 1] += near
    dark, dark_count, bright, count = sums
    levels = [
        (total / np.maximum(number, 1)).astype(np.float32) for total, number in ((dark, dark_count), (bright, count))
    ]
    return levels[0], levels[1], count
