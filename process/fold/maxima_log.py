"""Own the log of new maxima: make room in it without losing what a crossing may need, and search it.

Promises that a crossing read from it is exact, and that a pixel whose crossing may have been dropped is
found as UNKNOWN. What is dropped depends on the sequence alone, never on when anybody looked.
"""

from __future__ import annotations

import numpy as np

from process.numba_cache import kernel
from process.pixel_layout import (
    BEFORE,
    DIP,
    GAP,
    MINIMUM,
    NEVER,
    NO_DIP,
    OUT_OF_REACH,
    PIXEL,
    PLANES,
    TAIL_DIP,
    TILE,
    UNKNOWN,
    VALUE,
)


@kernel
def drop_dead(where, levels, waiting, maxima, live):
    """Drop the entries below half the running maximum: they are below S for ever. live [TILE]: what stays."""
    live[:] = 0
    kept = 0
    for index in range(waiting):
        pixel = np.int64(where[index] & np.uint32(PIXEL))
        if 2 * np.int64(levels[index, VALUE]) >= np.int64(maxima[pixel]):
            live[pixel] += 1
            where[kept] = where[index]
            for column in range(3):
                levels[kept, column] = levels[index, column]
            kept += 1
    return kept


@kernel
def share_of(live, room):
    """Most entries per pixel with which all pixels together need at most `room`; at least 1."""
    share, needed = 0, 0
    while True:
        more = int(np.count_nonzero(live > share))
        if more == 0 or needed + more > room:
            return max(share, 1)
        needed += more
        share += 1


@kernel
def thin_out(where, levels, waiting, lost_low, sums, live, share):
    """Leave each pixel its share of entries; the lowest go while they lie below the running S.

    sums [TILE]: running maximum + minimum. The highest entry dropped so is remembered in lost_low [TILE].
    If more have to go, the newest stays, those just below it go, and it is marked GAP.
    """
    excess = np.maximum(live - share, 0).astype(np.int32)
    left = live.copy()
    carried = np.full(TILE, NO_DIP, np.int32)
    kept = 0
    for index in range(waiting):
        entry = np.int64(where[index])
        pixel = np.int64(entry & PIXEL)
        value = np.int64(levels[index, VALUE])
        dip = min(carried[pixel], np.int32(levels[index, DIP]))
        left[pixel] -= 1
        if excess[pixel] > 0:
            if 2 * value < sums[pixel]:
                lost_low[pixel] = value
                excess[pixel] -= 1
                continue
            if 0 < left[pixel] <= excess[pixel]:
                carried[pixel] = dip
                continue
            if left[pixel] == 0:
                entry |= GAP
        where[kept] = entry
        levels[kept, VALUE] = value
        levels[kept, BEFORE] = levels[index, BEFORE]
        levels[kept, DIP] = dip
        kept += 1
    return kept


@kernel
def compact_tile(where, levels, waiting, lost_low, maxima, minima, dips):
    """Make room in a tile's log: a quarter of it, at least for one frame. Returns the number of entries that stay.

    where [room], levels [room, 3]; lost_low, maxima, minima, dips [TILE]: those of the tile's pixels.
    """
    room = where.shape[0]
    goal = room - max(room // 4, TILE)
    live = np.empty(TILE, np.int32)
    kept = drop_dead(where, levels, waiting, maxima, live)
    if kept <= goal:
        return kept
    sums = maxima.astype(np.int64) + np.minimum(minima, dips).astype(np.int64)
    return thin_out(where, levels, kept, lost_low, sums, live, share_of(live, goal))


@kernel
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
            pixel = int(entry & PIXEL)
            at = origin + pixel
            found.last_ordinal[at] = entry >> 16
            value = np.int32(levels[index, VALUE])
            if 2 * value < sums[pixel]:
                continue
            if found.ordinal[at] != NEVER:
                found.later_dip[at] = min(found.later_dip[at], np.int32(levels[index, DIP]))
                continue
            lost = (entry & GAP) != 0 or 2 * np.int32(log.lost_low[tile, pixel]) >= sums[pixel]
            found.ordinal[at] = UNKNOWN if lost else entry >> 16
            found.level[at] = value
            found.before[at] = levels[index, BEFORE]
