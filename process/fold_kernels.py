"""Own the compiled loops of the one-pass fold and the layout of its state and log; exact integers only.

Pixels are kept in tiles of TILE. Of each tile, `state` holds four planes (maximum, tail dip, tail rise,
minimum) side by side, which stay in the first-level cache while several frames are folded into them.
Only a new maximum can be a crossing; each is appended to its tile's log (`where`, `levels`), so that
the loop writes memory in order instead of visiting one cache line per pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from process.vector_blocks import BLOCK, count_bits, fold_block, lowest_bit, prefetch

TILE = 2048
"""Pixels per tile; a multiple of BLOCK, and their offsets leave the sign of a 16-bit word free."""

BLOCKS = TILE // BLOCK

PLANES = 4
MAXIMUM, TAIL_DIP, TAIL_RISE, MINIMUM = range(PLANES)
"""Planes of a tile's state. MINIMUM is that of the time before the newest maximum: the tail dip has the rest."""

VALUE, BEFORE, DIP = range(3)
"""Columns of the log's levels: the new maximum, the frame before, the lowest since the maximum before."""

GAP = 0x8000
PIXEL = 0x7FFF
"""`where` of an entry: ordinal << 16 | GAP (an entry of this pixel is missing just below) | offset in the tile."""

MAX_FRAMES = 65536
"""Ordinals have 16 bits."""

NEVER = -1
UNKNOWN = -2
"""Instead of an ordinal in found: no frame reaches S, or the log no longer knows which."""

OUT_OF_REACH = 4 * 65536
"""Above twice every level."""

NO_DIP = 65536
"""later_dip where no new maximum follows the crossing; above every level."""


class Log(NamedTuple):
    """The new maxima of all pixels, by tile, in the order of the frames."""

    where: NDArray[np.uint32]
    """[tiles, room] see PIXEL."""
    levels: NDArray[np.uint8] | NDArray[np.uint16]
    """[tiles, room, 3] VALUE, BEFORE, DIP."""
    waiting: NDArray[np.int64]
    """[tiles] entries in use."""
    lost_low: NDArray[np.uint8] | NDArray[np.uint16]
    """[tiles * TILE] highest value that was dropped from below; 0 for none."""


class Found(NamedTuple):
    """What the log knows of each pixel's crossing, flat over [tiles * TILE]."""

    ordinal: NDArray[np.int32]
    """First frame at or above S (its place among the folded frames), NEVER or UNKNOWN."""
    level: NDArray[np.uint16]
    """Value in that frame."""
    before: NDArray[np.uint16]
    """Value in the folded frame before it."""
    later_dip: NDArray[np.int32]
    """Lowest value between it and the last new maximum; NO_DIP where there is no later one."""
    last_ordinal: NDArray[np.int32]
    """Newest new maximum; 0 (the first frame) where none followed."""


@njit(cache=True, nogil=True)
def compact_tile(tile, where, levels, waiting, lost_low, maxima, minima, dips):
    """Make room in a tile's log; the entries that stay, and lost_low, are returned through the arrays.

    1. Entries below half the running maximum can never be at or above S: dropped for good.
    2. If that frees less than half the room, each pixel keeps at most its share of that half: the
       lowest go while they lie below the running S (remembered as lost_low); if that is not enough
       the newest stays and those just below it go (it is marked GAP).
    """
    room = where.shape[0]
    share = room // (2 * TILE)
    live = np.zeros(TILE, np.int32)
    kept = 0
    for index in range(waiting):
        pixel = np.int64(where[index] & np.uint32(PIXEL))
        if 2 * np.int64(levels[index, VALUE]) >= np.int64(maxima[pixel]):
            live[pixel] += 1
            where[kept] = where[index]
            for column in range(3):
                levels[kept, column] = levels[index, column]
            kept += 1
    if kept <= room // 2:
        return kept
    excess = np.maximum(live - share, 0).astype(np.int32)
    left = live.copy()
    carried = np.full(TILE, NO_DIP, np.int32)
    waiting, kept = kept, 0
    for index in range(waiting):
        entry = np.int64(where[index])
        pixel = entry & PIXEL
        value = np.int64(levels[index, VALUE])
        dip = min(carried[pixel], np.int32(levels[index, DIP]))
        left[pixel] -= 1
        if excess[pixel] > 0:
            running = np.int64(maxima[pixel]) + min(np.int64(minima[pixel]), np.int64(dips[pixel]))
            below = 2 * value < running
            if below or left[pixel] <= excess[pixel]:
                if below:
                    lost_low[tile * TILE + pixel] = value
                    excess[pixel] -= 1
                    continue
                if left[pixel] > 0:
                    carried[pixel] = dip
                    continue
                entry |= GAP
        where[kept] = entry
        levels[kept, VALUE] = value
        levels[kept, BEFORE] = levels[index, BEFORE]
        levels[kept, DIP] = dip
        kept += 1
    return kept


@njit(cache=True, nogil=True)
def start_state(first, state):
    """Begin all planes with the first folded frame, already flipped: levels [tiles * TILE]."""
    for tile in range(first.size // TILE):
        frame = first[tile * TILE : (tile + 1) * TILE]
        base = tile * TILE * PLANES
        for pixel in range(TILE):
            state[base + MAXIMUM * TILE + pixel] = frame[pixel]
            state[base + TAIL_DIP * TILE + pixel] = frame[pixel]
            state[base + TAIL_RISE * TILE + pixel] = 0
            state[base + MINIMUM * TILE + pixel] = frame[pixel]


@njit(cache=True, nogil=True, inline="always")
def list_bits(masks, listed):
    """Places of the set bits of masks [BLOCKS], ascending, into listed [TILE + 2]; returns their number.

    Two per mask are written whether they are there or not: with a new maximum in every third mask or so,
    a branch on each would be predicted wrongly, and cost more than all the rest.
    """
    one = np.uint64(1)
    found = np.uint64(0)
    for block in range(BLOCKS):
        mask = masks[block]
        following = found + count_bits(mask)
        place = np.uint64(block * BLOCK)
        listed[found] = place + lowest_bit(mask)
        mask &= mask - one
        listed[found + one] = place + lowest_bit(mask)
        mask &= mask - one
        found += np.uint64(2)
        while mask != 0:
            listed[found] = place + lowest_bit(mask)
            mask &= mask - one
            found += one
        found = following
    return found


@njit(cache=True, nogil=True)
def fold_frames(frames, tails, n_frames, first_ordinal, flip, state, log):
    """Fold frames[1] .. frames[n_frames], in this order, into state and log; frames[0] is the one before.

    frames: tuple of flat originals [h * w]; values are level ^ flip. tails: tuple of the same frames'
    last, incomplete tile [TILE]. first_ordinal >= 1: frame 0 only starts the state. The result does not
    depend on how the frames are dealt into calls.
    """
    room = log.where.shape[1]
    one = np.uint64(1)
    flip = np.uint64(flip)
    masks = np.empty(BLOCKS, np.uint64)
    listed = np.empty(TILE + 2, np.uint64)
    for tile in range(log.where.shape[0]):
        whole = (tile + 1) * TILE <= frames[0].size
        sources = frames if whole else tails
        at = tile * TILE if whole else 0
        base = tile * TILE * PLANES
        maxima = state[base + MAXIMUM * TILE : base + (MAXIMUM + 1) * TILE]
        dips = state[base + TAIL_DIP * TILE : base + (TAIL_DIP + 1) * TILE]
        rises = state[base + TAIL_RISE * TILE : base + (TAIL_RISE + 1) * TILE]
        minima = state[base + MINIMUM * TILE : base + (MINIMUM + 1) * TILE]
        where = log.where[tile]
        levels = log.levels[tile]
        waiting = np.uint64(log.waiting[tile])
        before = sources[0][at : at + TILE]
        for k in range(n_frames):
            if waiting > np.uint64(room - TILE):
                waiting = np.uint64(
                    compact_tile(tile, where, levels, np.int64(waiting), log.lost_low, maxima, minima, dips)
                )
            source = sources[k + 1]
            frame = source[at : at + TILE]
            stamp = (first_ordinal + k) << 16
            for block in range(0, TILE, BLOCK):
                prefetch(source, at + block + TILE)
                masks[block // BLOCK] = fold_block(source, at + block, flip, state, base + block, TILE)
            for index in range(list_bits(masks, listed)):
                pixel = listed[index]
                value = frame[pixel] ^ flip
                dip = dips[pixel]
                where[waiting] = stamp | pixel
                levels[waiting, VALUE] = value
                levels[waiting, BEFORE] = before[pixel] ^ flip
                levels[waiting, DIP] = dip
                waiting += one
                maxima[pixel] = value
                dips[pixel] = value
                rises[pixel] = 0
                minima[pixel] = min(dip, minima[pixel])
            before = frame
        log.waiting[tile] = np.int64(waiting)


@njit(cache=True, nogil=True)
def find_crossings(state, log, wanted, found):
    """Read the log once, in order: the first entry of each wanted pixel that lies at or above its S.

    wanted: [tiles * TILE], not 0 where the crossing is asked for; last_ordinal is found of every pixel.
    """
    sums = np.empty(TILE, np.int32)
    for tile in range(log.where.shape[0]):
        origin = tile * TILE
        base = origin * PLANES
        for pixel in range(TILE):
            minimum = min(state[base + TAIL_DIP * TILE + pixel], state[base + MINIMUM * TILE + pixel])
            sums[pixel] = np.int32(state[base + pixel]) + np.int32(minimum)
            if wanted[origin + pixel] == 0:
                sums[pixel] = OUT_OF_REACH
            found.ordinal[origin + pixel] = NEVER
            found.later_dip[origin + pixel] = NO_DIP
            found.last_ordinal[origin + pixel] = 0
        where = log.where[tile]
        levels = log.levels[tile]
        for index in range(log.waiting[tile]):
            entry = np.int64(where[index])
            pixel = np.int64(entry & PIXEL)
            at = origin + pixel
            found.last_ordinal[at] = entry >> 16
            value = np.int32(levels[index, VALUE])
            if 2 * value < sums[pixel]:
                continue
            if found.ordinal[at] != NEVER:
                found.later_dip[at] = min(found.later_dip[at], np.int32(levels[index, DIP]))
                continue
            lost = (entry & GAP) != 0 or 2 * np.int32(log.lost_low[at]) >= sums[pixel]
            found.ordinal[at] = UNKNOWN if lost else entry >> 16
            found.level[at] = value
            found.before[at] = levels[index, BEFORE]
