"""One-pass fold of a sweep: extremes and crossings of each pixel (algorithms 1 to 3 of the paper), a frame at a time.

The paper reads the sequence twice: for minimum and maximum, then for the crossing of S = (minimum + maximum) / 2. The
fold gives the same maps, bit for bit, in one pass and bounded memory: before its crossing a pixel is always below S, so
the crossing is a new running maximum, and only new maxima are logged (docs/design.md, section 4). This holds for rising
and falling edges and for any contrast that is chosen afterwards. One thread at a time.
"""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Edge, Folded, Maps, ReadColumns, contrast_mask, full_scale, make_maps
from process.crossings.two_sample_kernels import Samples
from process.fold.colour import ColourOfMaximum, grey_of_rgb
from process.fold.frame_buffer import FrameBuffer, writable
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
    LoggedCrossings,
    MaximaLog,
    aligned_zeros,
)

BATCH = 4
"""Frames folded in one pass over the state: enough to spare memory traffic, few enough to stay in the cache."""

LOG_ROOM = 16
"""Room for new maxima, per pixel on average over a tile; a noisy edge makes 5 to 15."""

_RESULT_BYTES = 64
"""Bytes per pixel of one result and what it takes to make it."""


def level_type(bit_depth: int) -> np.dtype[Any]:
    """Type that stores a bit depth: uint8 for 8, uint16 (right-aligned) for 9 to 16."""
    if not 8 <= bit_depth <= 16:
        raise ValueError(f"a bit depth of 8 to 16 can be folded, not {bit_depth}")
    return np.dtype(np.uint8 if bit_depth == 8 else np.uint16)


def to_grey(frame: NDArray[Any], bit_depth: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
    """Grey of a frame in its stored depth: [h, w] is returned as it is, [h, w, 3] RGB by OpenCV's weights (into out).

    Raises:
        ValueError: the type does not fit the depth, or the shape is neither.
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
        log_room: int = LOG_ROOM,
    ) -> None:
        """Allocate all memory of the sweep at once (see bytes_needed).

        Args:
            shape: (height, width).
            bit_depth: of the stored levels, 8 to 16.
            edge: rising or falling.
            frames_expected: frame indices lie below it; at most 65536.
            log_room: room for new maxima per pixel, 2 or more.

        Raises:
            ValueError: a value outside these bounds.
        """
        if shape[0] < 1 or shape[1] < 1:
            raise ValueError(f"a frame needs at least one pixel, not {shape}")
        if edge not in ("rising", "falling"):
            raise ValueError(f"the edge is rising or falling, not {edge!r}")
        if not 1 <= frames_expected <= MAX_FRAMES:
            raise ValueError(f"a fold takes 1 to {MAX_FRAMES} frames, not {frames_expected}")
        if log_room < 2:
            raise ValueError(f"the log needs room for 2 maxima per pixel, not {log_room}")
        self._shape, self._edge, self._bit_depth = shape, edge, bit_depth
        self._flip = full_scale(bit_depth) if edge == "falling" else 0
        self._frames_expected = frames_expected
        self._dtype = level_type(bit_depth)
        self._pixels = shape[0] * shape[1]
        tiles = _tiles(shape)
        self._buffer = FrameBuffer(shape, self._dtype, BATCH)
        self._first = aligned_zeros((tiles * TILE,), self._dtype)
        self._state = aligned_zeros((tiles, PLANES, TILE), self._dtype)
        self._log = MaximaLog(
            where=aligned_zeros((tiles, log_room * TILE), np.uint32),
            levels=aligned_zeros((tiles, log_room * TILE, 3), self._dtype),
            entries=np.zeros(tiles, np.int64),
            lost_low=aligned_zeros((tiles, TILE), self._dtype),
        )
        self._colour: ColourOfMaximum | None = None
        self._present: list[int] = []

    @staticmethod
    def bytes_needed(shape: tuple[int, int], bit_depth: int) -> int:
        """Most memory in bytes of a fold of this format, its colour and one result included; shape (height, width)."""
        level = level_type(bit_depth).itemsize
        per_pixel = (BATCH + 1 + PLANES + 2) * level + LOG_ROOM * (4 + 3 * level) + (level + 3) + _RESULT_BYTES
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
        """Memory [h, w] for the next frame: a grey frame written there before :meth:`add` is not copied."""
        return self._buffer.slot()

    def add(self, frame_index: int, frame: NDArray[Any], *, keep: bool = False) -> None:
        """Fold the next frame: [h, w] grey or [h, w, 3] RGB. Indices left out are missing frames.

        The frame is copied. With keep the caller promises not to change it any more, and a grey frame is held by
        reference until it is folded, which saves the copy.

        Raises:
            ValueError: the index does not increase or is not expected, or another shape, type or number of channels;
                nothing was folded.
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
        elif self._buffer.full:
            self._flush()

    def _append(self, frame: NDArray[Any], keep: bool) -> None:
        slot = self._buffer.slot()
        grey = to_grey(frame, self._bit_depth, out=slot)
        if frame.ndim == 3:
            if not self._present:
                self._colour = ColourOfMaximum(self._shape, self._bit_depth)
            assert self._colour is not None
            self._colour.add(grey, frame)
        elif frame is not slot and not (keep and frame.flags.c_contiguous and frame.flags.aligned):
            grey = slot
            np.copyto(grey, frame)
        self._buffer.append(grey)

    def _start(self) -> None:
        (frame, *_), _ = self._buffer.waiting_frames()
        # full scale is all ones, so the complement of a level is its XOR with it
        np.bitwise_xor(frame, self._flip, out=self._first[: self._pixels])
        start_state(self._first, self._state.reshape(-1))

    def _flush(self) -> None:
        """Fold the waiting frames."""
        waiting = self._buffer.waiting
        if waiting == 0:
            return
        frames, tails = self._buffer.waiting_frames()
        ordinal = len(self._present) - waiting
        fold_frames(frames, tails, waiting, ordinal, self._flip, self._state.reshape(-1), self._log)
        self._buffer.clear()

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

        Args:
            contrast: I* of algorithm 2, in counts of 8 bit at any depth.
            median: side of the median filter of the mask in pixels, odd; 0 for none.
            method: interpolation between the two samples about half brightness.
            noise_counts: standard deviation of the noise in counts of 8 bit, for sigma.
            read_columns: gives the sequence of the pixels that the log no longer knows; with None they stay NaN and
                are counted as unresolved.

        Raises:
            ValueError: no frame yet, or a value outside its bounds.
            ScanFileError: the file contradicts what was folded.
        """
        if method not in ("linear", "probit"):
            raise ValueError(f"from two samples the method is linear or probit, not {method!r}")
        if not self._present:
            raise ValueError("nothing was folded yet")
        self._flush()
        # copies: the maps must not change when more frames are folded
        lowest = np.minimum(self._plane(TAIL_DIP), self._plane(MINIMUM)).reshape(self._shape)
        highest = self._plane(MAXIMUM).reshape(self._shape)
        full = full_scale(self._bit_depth)
        if self._bit_depth not in (8, 16) and int(highest.max()) > full:
            raise ValueError(f"a folded frame has values above {full}, the most of {self._bit_depth} bit")
        low, high = lowest, highest
        if self._edge == "falling":  # back from the complement: the maps hold original intensities
            low, high = full - highest, full - lowest
        mask = contrast_mask(low, high, contrast, median, self._bit_depth)
        samples = self._samples(lowest.ravel(), highest.ravel(), mask)
        folded = Folded(low, high, mask, samples, self.present, self._edge, self._bit_depth)
        colour = self._colour.copy() if self._colour else self._grey_colour(high)
        return make_maps(folded, noise_counts, colour, read_columns, probit=method == "probit")

    def _plane(self, plane: int) -> NDArray[Any]:
        return self._state[:, plane].copy().reshape(-1)[: self._pixels]

    def _samples(self, lowest: NDArray[Any], highest: NDArray[Any], mask: NDArray[np.uint8]) -> Samples:
        """Samples of each pixel, flat: copies of the state, and the logged crossings where the mask is true."""
        # whole tiles, as the kernel takes them; the rest of the last tile is cut off below
        size = len(self._first)
        wanted = np.zeros(size, np.uint8)
        wanted[: self._pixels] = mask.ravel()
        types = (np.int32, np.uint16, np.uint16, np.int32, np.int32)
        arrays: list[Any] = [np.empty(size, dtype) for dtype in types]
        found = LoggedCrossings(*arrays)
        find_crossings(self._state.reshape(-1), self._log, wanted, found)
        return Samples(
            minimum=lowest,
            maximum=highest,
            first=self._first[: self._pixels],
            tail_dip=self._plane(TAIL_DIP),
            tail_rise=self._plane(TAIL_RISE),
            **{name: values[: self._pixels] for name, values in found._asdict().items()},
        )

    def _grey_colour(self, maximum: NDArray[Any]) -> NDArray[np.uint8]:
        grey = (maximum >> (self._bit_depth - 8)).astype(np.uint8)
        return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), dtype=np.uint8).reshape(*self._shape, 3)
