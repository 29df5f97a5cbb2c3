"""Maps of a sweep from its folded pixels: contrast mask (algorithm 2), crossing (algorithm 3), sigma, quality, counts.

The maps equal those of the paper's two passes, bit for bit. Pixels whose crossing the fold no longer knows are resolved
from the sequence itself, or stay NaN and are counted as unresolved. Beyond the paper: >= in both comparisons, falling
edges, missing frames (docs/design.md, section 4).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from process.crossings.quality import Quality
from process.crossings.two_sample_kernels import (
    Samples,
    blur_of,
    estimate_crossings,
    fill_quantiles,
    look_up,
    sample_columns,
)
from process.pixel_layout import UNKNOWN

Edge: TypeAlias = Literal["rising", "falling"]
ReadColumns: TypeAlias = Callable[[NDArray[np.intp]], tuple[NDArray[Any], NDArray[Any]]]
"""Flat pixel indices -> (frame indices [n], original grey values [n, pixels])."""

COLUMN_BYTES = 64_000_000
"""Most bytes of pixel columns read at once; more flagged pixels are read in several pieces."""


@dataclass(frozen=True)
class Maps:
    """Result of a sweep, or of its first frames: arrays [h, w], never changed afterwards."""

    minimum: NDArray[Any]
    """uint8 or uint16: lowest original intensity, Imin of algorithm 1."""
    maximum: NDArray[Any]
    """uint8 or uint16: highest original intensity, Imax of algorithm 1."""
    mask: NDArray[np.uint8]
    """C of algorithm 2: 1 where max - min >= contrast, after the median filter."""
    crossing: NDArray[np.float64]
    """T of algorithm 3: 0-based fractional frame index; NaN outside the mask, lit at the start, or unresolved."""
    sigma: NDArray[np.float32]
    """Standard deviation of the crossing in frames; NaN where there is none."""
    quality: NDArray[np.uint16]
    """Bits of Quality; 0 outside the mask."""
    colour: NDArray[np.uint8]
    """[h, w, 3] RGB of the frame of the first maximum, in 8 bit."""
    last_maximum: NDArray[np.int32]
    """Frame index of the newest new maximum of the folded signal; -1 where nothing was folded."""
    counts: dict[str, int]
    """over_contrast, past_s_in_first, crossings, flagged, unresolved, and one per quality bit."""


class Folded(NamedTuple):
    """What the fold knows: original extremes [h, w], and flat samples of the folded signal."""

    minimum: NDArray[Any]
    maximum: NDArray[Any]
    mask: NDArray[np.uint8]
    """contrast_mask of the two."""
    samples: Samples
    present: NDArray[np.int64]
    """Frame index of each folded frame, ascending; at least one."""
    edge: Edge
    bit_depth: int


def full_scale(bit_depth: int) -> int:
    """Largest intensity of a depth in bits."""
    return int(2**bit_depth) - 1


def contrast_mask(
    minimum: NDArray[Any], maximum: NDArray[Any], contrast: int, median: int, bit_depth: int
) -> NDArray[np.uint8]:
    """Algorithm 2: [h, w] uint8, 1 where max - min >= contrast x 2^(bit_depth - 8), then the median filter of it.

    Raises:
        ValueError: a negative contrast, or a median that is neither 0 nor odd.
    """
    if contrast < 0:
        raise ValueError(f"the contrast has to be 0 or more, not {contrast}")
    if median < 0 or (median > 0 and median % 2 == 0):
        raise ValueError(f"the median has to be 0 or an odd number of pixels, not {median}")
    # unsigned, and maximum >= minimum: the difference cannot wrap around
    mask: NDArray[np.uint8] = (maximum - minimum >= contrast * 2 ** (bit_depth - 8)).astype(np.uint8)
    if median > 1:
        mask = np.asarray(cv2.medianBlur(mask, median), dtype=np.uint8).reshape(mask.shape)
    return mask


def level_step(seen: NDArray[np.bool_]) -> float:
    """Least difference of two levels that occur, at most a count of 8 bit; seen [2^bit_depth]: whether a level occurs.

    A camera of 12 bit may fill only each 16th level of a file of 16: its rounding is that of 12 bit.
    """
    levels = np.flatnonzero(seen)
    least = float(np.diff(levels).min()) if len(levels) > 1 else 1.0
    return min(least, len(seen) / 256)


class _Interpolation(NamedTuple):
    """Options of estimate_crossings."""

    noise: float
    """Standard deviation in levels."""
    step: float
    """Levels from one that occurs to the next."""
    blur: float
    """Half the interval that a level stands for where its error counts."""
    probit: bool
    quantiles: NDArray[np.float64]
    """Table for 8-bit levels with probit, else empty: an inverse normal per pixel takes longer than all the rest."""


@functools.cache
def _quantiles_8_bit() -> NDArray[np.float64]:
    """[257, 256] of ``fill_quantiles``."""
    table = np.zeros((257, 256))
    fill_quantiles(table)
    return table


_NO_QUANTILES: NDArray[np.float64] = np.zeros((0, 0))


class _Estimates(NamedTuple):
    """Output arrays of the kernels, flat."""

    crossing: NDArray[np.float64]
    sigma: NDArray[np.float32]
    quality: NDArray[np.uint16]

    @classmethod
    def empty(cls, pixels: int) -> _Estimates:
        return cls(np.full(pixels, np.nan), np.full(pixels, np.nan, np.float32), np.zeros(pixels, np.uint16))


def _levels_and_quality(folded: Folded, mask: NDArray[np.uint8], quality: NDArray[np.uint16], step: float) -> None:
    """Set the bits that need the extremes only; dark is meant of the original intensity, for both edges.

    step: from one level that occurs to the next; left-aligned levels end at full scale less this, and one.
    """
    full = full_scale(folded.bit_depth)
    inside = mask.ravel() != 0
    quality[inside & (folded.maximum.ravel() > full - int(step))] |= np.uint16(Quality.SATURATED)
    quality[inside & (folded.minimum.ravel() > full // 2)] |= np.uint16(Quality.NO_DARK_LEVEL)


def _columns(
    read_columns: ReadColumns, pixels: NDArray[np.intp], folded: Folded
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Levels of some pixels in exactly the folded frames, of the folded signal, [frames, pixels]."""
    frames, values = read_columns(pixels)
    frames = np.asarray(frames)
    # the file may hold more frames by now than were folded
    places = np.searchsorted(frames, folded.present)
    known = places < len(frames)
    if not known.all() or not np.array_equal(frames[places], folded.present):
        raise ScanFileError(
            "the scan file lacks frames that were already folded; "
            "the frames in it are safe: run `sweepscope verify`, then `sweepscope reconstruct`"
        )
    columns = np.asarray(values)[places].astype(folded.minimum.dtype)
    if folded.edge == "falling":
        columns = full_scale(folded.bit_depth) - columns
    return np.ascontiguousarray(columns)


def _check_same(samples: Samples, columns: Samples, pixels: NDArray[np.intp]) -> None:
    # a check of the file: other frames than the folded ones would hardly have the same extremes
    same = np.array_equal(samples.minimum[pixels], columns.minimum)
    if not same or not np.array_equal(samples.maximum[pixels], columns.maximum):
        raise ScanFileError(
            "frames in the scan file differ from those that were folded; "
            "the file is what counts: run `sweepscope verify`, then `sweepscope reconstruct`"
        )


def empty_samples(pixels: int) -> Samples:
    """Samples of some pixels, all zero."""
    numbers = ("ordinal", "later_dip", "last_ordinal")
    arrays: list[Any] = [np.zeros(pixels, np.int32 if name in numbers else np.uint16) for name in Samples._fields]
    return Samples(*arrays)


def _resolve(
    read_columns: ReadColumns,
    flagged: NDArray[np.intp],
    folded: Folded,
    interpolation: _Interpolation,
    out: _Estimates,
) -> None:
    """Estimate the flagged pixels by two passes over their sequence, as the paper does, in bounded pieces."""
    size = max(1, COLUMN_BYTES // (folded.minimum.dtype.itemsize * len(folded.present)))
    for start in range(0, len(flagged), size):
        pixels = flagged[start : start + size]
        samples = empty_samples(len(pixels))
        sample_columns(_columns(read_columns, pixels, folded), samples)
        _check_same(folded.samples, samples, pixels)
        part = _Estimates.empty(len(pixels))
        estimate_crossings(np.arange(len(pixels)), samples, folded.present, *interpolation, *part)
        out.crossing[pixels] = part.crossing
        out.sigma[pixels] = part.sigma
        out.quality[pixels] |= part.quality | np.uint16(Quality.FROM_FILE)


def quality_counts(
    mask: NDArray[np.uint8], crossing: NDArray[np.float64], quality: NDArray[np.uint16]
) -> dict[str, int]:
    """Counts over_contrast, past_s_in_first, crossings, and one per quality bit; arrays of one shape."""
    by_value = np.bincount(quality[quality != 0], minlength=256)
    values = np.arange(len(by_value))
    bits = {bit.name.lower(): int(by_value[(values & bit) != 0].sum()) for bit in Quality if bit.name}
    return {
        "over_contrast": int(np.count_nonzero(mask)),
        "past_s_in_first": bits["lit_at_start"],
        "crossings": int(np.count_nonzero(~np.isnan(crossing))),
        **bits,
    }


def make_maps(
    folded: Folded,
    noise_counts: float,
    colour: NDArray[np.uint8],
    read_columns: ReadColumns | None,
    *,
    probit: bool = False,
) -> Maps:
    """Maps of what was folded, by docs/design.md, section 4; colour is taken over as it is.

    noise_counts: standard deviation of the noise, in counts of 8 bit. Raises ScanFileError where the
    file contradicts the fold.
    """
    shape, samples, mask = folded.minimum.shape, folded.samples, folded.mask
    quantiles = _quantiles_8_bit() if probit and folded.bit_depth == 8 else _NO_QUANTILES
    count = 2.0 ** (folded.bit_depth - 8)
    noise, step = noise_counts * count, 1.0
    if folded.bit_depth > 8:
        seen = np.zeros(full_scale(folded.bit_depth) + 1, np.bool_)
        seen[folded.minimum] = seen[folded.maximum] = True
        step = level_step(seen)
    interpolation = _Interpolation(noise, step, blur_of(noise, step, count), probit, quantiles)
    out = _Estimates.empty(mask.size)
    _levels_and_quality(folded, mask, out.quality, step)
    selected = np.flatnonzero(mask != 0)
    estimate_crossings(selected, samples, folded.present, *interpolation, *out)
    # a pixel lit at the start has no crossing, whether the log knows it or not
    unknown = selected[samples.ordinal[selected] == UNKNOWN]
    flagged = unknown[(out.quality[unknown] & np.uint16(Quality.LIT_AT_START)) == 0]
    if read_columns is not None:
        _resolve(read_columns, flagged, folded, interpolation, out)
    last_maximum = np.empty(mask.size, np.int32)
    look_up(folded.present, samples.last_ordinal, last_maximum)
    return Maps(
        minimum=folded.minimum,
        maximum=folded.maximum,
        mask=mask,
        crossing=out.crossing.reshape(shape),
        sigma=out.sigma.reshape(shape),
        quality=out.quality.reshape(shape),
        colour=colour,
        last_maximum=last_maximum.reshape(shape),
        counts=quality_counts(mask, out.crossing, out.quality)
        | {"flagged": len(flagged), "unresolved": 0 if read_columns is not None else len(flagged)},
    )
