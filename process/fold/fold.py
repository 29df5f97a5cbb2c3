"""Own the one-pass fold of a sweep: each frame once, in order, in bounded memory, exact.

Promises the same maps as reading the whole sequence twice (first the extremes, then the crossing), bit
for bit, for rising and falling edges and whatever the contrast chosen afterwards. One thread at a time.
"""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Edge, Folded, Maps, ReadColumns, contrast_mask, empty_samples, full_scale, make_maps
from process.crossings.two_sample_kernels import Samples, sample_columns
from process.fold.colour import ColourOfMaximum, grey_of_rgb
from process.fold.frame_buffer import RecentFrames, writable
from process.fold.kernels import fold_frames, start_state
from process.fold.maxima_log import find_crossings
from process.pixel_layout import (
    MAX_FRAMES,
    MAXIMUM,
    MINIMUM,
    PLANES,
    TAIL_DIP,
    TAIL_RISE,
    TILE,
    Found,
    Log,
    aligned_zeros,
)

__all__ = ["Fold", "Maps", "level_type", "to_grey", "warm_up"]

BATCH = 4
"""Frames kept before a pass over the state: enough to spare memory traffic, few enough to stay in the cache."""

RECORDS = 16
"""Room for new maxima, per pixel on average over a tile; a noisy edge makes 5 to 15."""

_RESULT_BYTES = 64
"""Bytes per pixel of one result and what it takes to make it."""


def level_type(bit_depth: int) -> np.dtype[Any]:
    """Type that stores a depth of 8 (uint8) or 9 to 16 bits (uint16, right-aligned)."""
    if not 8 <= bit_depth <= 16:
        raise ValueError(f"a bit depth of 8 to 16 can be folded, not {bit_depth}")
    return np.dtype(np.uint8 if bit_depth == 8 else np.uint16)


def to_grey(frame: NDArray[Any], bit_depth: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
    """Grey of a frame in its stored depth: [h, w] as it is, [h, w, 3] RGB by OpenCV's weights (into out).

    Raises ValueError where the type does not fit the depth or the shape is neither.
    """
    if frame.dtype != level_type(bit_depth):
        raise ValueError(f"frames of {bit_depth} bit are {level_type(bit_depth)}, not {frame.dtype}")
    if frame.ndim == 2:
        return frame
    if frame.ndim != 3 or frame.shape[2] != 3:
        raise ValueError(f"a frame is [h, w] grey or [h, w, 3] RGB, not {frame.shape}")
    if out is None:
        out = np.empty(frame.shape[:2], frame.dtype)
    frame = np.ascontiguousarray(frame)
    if frame.dtype == np.uint8 and out.flags.c_contiguous:
        grey_of_rgb(writable(frame.reshape(-1)), out.reshape(-1))
    else:
        cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY, dst=out)
    return out


def _tiles(shape: tuple[int, int]) -> int:
    return -(-shape[0] * shape[1] // TILE)


class Fold:
    """One-pass exact fold of one sweep."""

    def __init__(
        self,
        shape: tuple[int, int],
        *,
        bit_depth: int,
        edge: Edge,
        frames_expected: int,
        records: int = RECORDS,
    ) -> None:
        """Take all memory of the sweep at once (see bytes_needed).

        shape: (height, width). frames_expected: frame indices lie below it; at most 65536. records:
        room for new maxima per pixel, 2 or more. Raises ValueError for anything outside these.
        """
        if shape[0] < 1 or shape[1] < 1:
            raise ValueError(f"a frame needs at least one pixel, not {shape}")
        if edge not in ("rising", "falling"):
            raise ValueError(f"the edge is rising or falling, not {edge!r}")
        if not 1 <= frames_expected <= MAX_FRAMES:
            raise ValueError(f"a fold takes 1 to {MAX_FRAMES} frames, not {frames_expected}")
        if records < 2:
            raise ValueError(f"the log needs room for 2 records per pixel, not {records}")
        self._shape, self._edge, self._bit_depth = shape, edge, bit_depth
        self._flip = full_scale(bit_depth) if edge == "falling" else 0
        self._frames_expected = frames_expected
        self._dtype = level_type(bit_depth)
        self._pixels = shape[0] * shape[1]
        tiles = _tiles(shape)
        self._recent = RecentFrames(shape, self._dtype, BATCH)
        self._first = aligned_zeros((tiles * TILE,), self._dtype)
        self._state = aligned_zeros((tiles, PLANES, TILE), self._dtype)
        self._log = Log(
            where=aligned_zeros((tiles, records * TILE), np.uint32),
            levels=aligned_zeros((tiles, records * TILE, 3), self._dtype),
            waiting=np.zeros(tiles, np.int64),
            lost_low=aligned_zeros((tiles, TILE), self._dtype),
        )
        self._colour: ColourOfMaximum | None = None
        self._present: list[int] = []

    @staticmethod
    def bytes_needed(shape: tuple[int, int], bit_depth: int) -> int:
        """Memory in bytes that a fold of this format takes at most, one result and colour included."""
        level = level_type(bit_depth).itemsize
        per_pixel = (BATCH + 1 + PLANES + 2) * level + RECORDS * (4 + 3 * level) + (level + 3) + _RESULT_BYTES
        return _tiles(shape) * TILE * per_pixel

    @property
    def folded_through(self) -> int:
        """Index of the last frame folded; -1 before the first."""
        return self._present[-1] if self._present else -1

    @property
    def present(self) -> NDArray[np.int64]:
        """Indices of all folded frames, ascending."""
        return np.array(self._present, np.int64)

    def room(self) -> NDArray[Any]:
        """Memory [h, w] of the next frame: a grey one that is put there before :meth:`add` need not be copied."""
        return self._recent.slot()

    def add(self, frame_index: int, frame: NDArray[Any], *, keep: bool = False) -> None:
        """Fold the next frame: [h, w] grey or [h, w, 3] RGB. Indices left out are missing frames.

        The frame is copied. With keep the caller promises not to change it any more, and a grey frame
        is held by reference until a few more have come, which saves the copy. Raises ValueError, and
        folds nothing, for an index that does not increase or is not expected, and for another shape,
        type or number of channels.
        """
        if not self.folded_through < frame_index < self._frames_expected:
            raise ValueError(
                f"frame {frame_index} cannot follow frame {self.folded_through} of {self._frames_expected} expected"
            )
        if frame.shape[:2] != self._shape:
            raise ValueError(f"frame {frame_index} is {frame.shape[:2]}, the fold {self._shape}")
        if self._present and (frame.ndim == 3) != (self._colour is not None):
            raise ValueError(f"frame {frame_index} is {frame.shape}: grey and RGB cannot be mixed")
        self._append(frame, keep)
        self._present.append(frame_index)
        if len(self._present) == 1:
            self._start()
        elif self._recent.full:
            self._flush()

    def _append(self, frame: NDArray[Any], keep: bool) -> None:
        slot = self._recent.slot()
        grey = to_grey(frame, self._bit_depth, out=slot)
        if frame.ndim == 3:
            if not self._present:
                self._colour = ColourOfMaximum(self._shape, self._bit_depth)
            assert self._colour is not None
            self._colour.add(grey, frame)
        elif frame is not slot and not (keep and frame.flags.c_contiguous and frame.flags.aligned):
            grey = slot
            np.copyto(grey, frame)
        self._recent.append(grey)

    def _start(self) -> None:
        (frame, *_), _ = self._recent.waiting_frames()
        np.bitwise_xor(frame, self._flip, out=self._first[: self._pixels])
        start_state(self._first, self._state.reshape(-1))

    def _flush(self) -> None:
        """Fold the frames that wait."""
        waiting = self._recent.waiting
        if waiting == 0:
            return
        frames, tails = self._recent.waiting_frames()
        ordinal = len(self._present) - waiting
        fold_frames(frames, tails, waiting, ordinal, self._flip, self._state.reshape(-1), self._log)
        self._recent.clear()

    def result(
        self,
        *,
        contrast: int,
        median: int,
        method: Literal["linear", "probit"] = "linear",
        noise_counts: float,
        read_columns: ReadColumns | None,
    ) -> Maps:
        """Maps of the frames folded so far; more can be added afterwards.

        contrast and noise_counts in counts of 8 bit, at any depth; median: odd, or 0 for none.
        read_columns gives the sequence of the pixels that the log no longer knows; with None they stay
        NaN and are counted as unresolved. Raises ValueError before the first frame and for bad values,
        ScanFileError where the file contradicts what was folded.
        """
        if method not in ("linear", "probit"):
            raise ValueError(f"from two samples the method is linear or probit, not {method!r}")
        if not self._present:
            raise ValueError("nothing was folded yet")
        self._flush()
        lowest = np.minimum(self._plane(TAIL_DIP), self._plane(MINIMUM)).reshape(self._shape)
        highest = self._plane(MAXIMUM).reshape(self._shape)
        full = full_scale(self._bit_depth)
        if self._bit_depth not in (8, 16) and int(highest.max()) > full:
            raise ValueError(f"a folded frame has values above {full}, the most of {self._bit_depth} bit")
        low, high = lowest, highest
        if self._edge == "falling":
            low, high = full - highest, full - lowest
        mask = contrast_mask(low, high, contrast, median, self._bit_depth)
        samples = self._samples(lowest.ravel(), highest.ravel(), mask)
        folded = Folded(low, high, mask, samples, self.present, self._edge, self._bit_depth)
        colour = self._colour.copy() if self._colour else self._grey_colour(high)
        return make_maps(folded, noise_counts, colour, read_columns, probit=method == "probit")

    def _plane(self, plane: int) -> NDArray[Any]:
        return self._state[:, plane].copy().reshape(-1)[: self._pixels]

    def _samples(self, lowest: NDArray[Any], highest: NDArray[Any], mask: NDArray[np.uint8]) -> Samples:
        """Copies of the state, and what the log knows of the crossings where the mask is true; flat."""
        size = len(self._first)
        wanted = np.zeros(size, np.uint8)
        wanted[: self._pixels] = mask.ravel()
        found = Found(
            ordinal=np.empty(size, np.int32),
            level=np.empty(size, np.uint16),
            before=np.empty(size, np.uint16),
            later_dip=np.empty(size, np.int32),
            last_ordinal=np.empty(size, np.int32),
        )
        find_crossings(self._state.reshape(-1), self._log, wanted, found)
        return Samples(
            minimum=lowest,
            maximum=highest,
            first=self._first[: self._pixels],
            ordinal=found.ordinal[: self._pixels],
            level=found.level[: self._pixels],
            before=found.before[: self._pixels],
            later_dip=found.later_dip[: self._pixels],
            last_ordinal=found.last_ordinal[: self._pixels],
            tail_dip=self._plane(TAIL_DIP),
            tail_rise=self._plane(TAIL_RISE),
        )

    def _grey_colour(self, maximum: NDArray[Any]) -> NDArray[np.uint8]:
        grey = (maximum >> (self._bit_depth - 8)).astype(np.uint8)
        return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), dtype=np.uint8).reshape(*self._shape, 3)


def warm_up() -> None:
    """Compile or load every kernel now, so that the first frames of a sweep do not wait for it."""
    for bit_depth in (8, 16):
        for shape in ((2, 2), (2, 2, 3)):
            fold = Fold((2, 2), bit_depth=bit_depth, edge="rising", frames_expected=BATCH + 1, records=2)
            for index in range(BATCH + 1):
                fold.add(index, np.full(shape, index, level_type(bit_depth)))
            maps = fold.result(contrast=0, median=0, noise_counts=1.0, read_columns=None)
            columns = np.zeros((BATCH + 1, 1), maps.maximum.dtype)
            sample_columns(columns, empty_samples(1))
