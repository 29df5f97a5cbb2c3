"""The log of new maxima: compact it when a tile's room is full, and read the crossings from it (algorithm 3).

A crossing read from the log is exact. A pixel whose crossing may have been dropped is reported as UNKNOWN and has to be
read from the file. What is dropped depends on the sequence alone, not on batches or results made during the sweep.

Levels are uint8 or uint16 of the folded signal; S = (minimum + maximum) / 2 is compared as 2 value >= minimum +
maximum, in integers. Rules: docs/decisions/0005-fold-keeps-new-maxima-in-a-log.md.
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
def drop_dead(where, levels, entries, maxima, live):
    """Drop the entries below half the running maximum; returns how many stay, live [TILE]: how many of each pixel."""
    live[:] = 0
    kept = 0
    for index in range(entries):
        pixel = np.int64(where[index] & np.uint32(PIXEL))
        # S >= maximum / 2, and the maximum only grows: below half of it an entry can never be a crossing
        if 2 * np.int64(levels[index, VALUE]) >= np.int64(maxima[pixel]):
            live[pixel] += 1
            where[kept] = where[index]
            for column in range(3):
                levels[kept, column] = levels[index, column]
            kept += 1
    return kept


@kernel
def share_of(live, room):
    """Most entries per pixel with which all pixels together need at most `room`; at least 1. live [TILE]: entries."""
    share, needed = 0, 0
    while True:
        more = int(np.count_nonzero(live > share))
        if more == 0 or needed + more > room:
            return max(share, 1)
        needed += more
        share += 1


@kernel
def thin_out(where, levels, entries, lost_low, sums, live, share):
    """Leave each pixel its share of entries; returns how many stay.

    sums [TILE]: running maximum + minimum. A pixel with too many first loses its lowest entries, as long as they lie
    below the running S; the highest of these is kept in lost_low [TILE]. If it still has too many, its newest entry
    stays, the entries next below it are dropped, and the newest is marked GAP.
    """
    excess = np.maximum(live - share, 0).astype(np.int32)
    left = live.copy()
    carried = np.full(TILE, NO_DIP, np.int32)
    kept = 0
    for index in range(entries):
        entry = np.int64(where[index])
        pixel = np.int64(entry & PIXEL)
        value = np.int64(levels[index, VALUE])
        # the dips of dropped entries are still needed: one of them may be the darkest after the crossing
        dip = min(carried[pixel], np.int32(levels[index, DIP]))
        left[pixel] -= 1
        if excess[pixel] > 0:
            if 2 * value < sums[pixel]:
                # S may fall again if the minimum does: lost_low tells find_crossings whether it fell too far
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
def compact_tile(where, levels, entries, lost_low, maxima, minima, dips):
    """Make room in a tile's log: a quarter of it, at least for one frame. Returns the number of entries that stay.

    where [room], levels [room, 3]; lost_low, maxima, minima, dips [TILE]: of the tile's pixels.
    """
    room = where.shape[0]
    goal = room - max(room // 4, TILE)
    live = np.empty(TILE, np.int32)
    kept = drop_dead(where, levels, entries, maxima, live)
    if kept <= goal:
        return kept
    sums = maxima.astype(np.int64) + np.minimum(minima, dips).astype(np.int64)
    return thin_out(where, levels, kept, lost_low, sums, live, share_of(live, goal))


@kernel
def find_crossings(state, log, wanted, found):
    """Algorithm 3 for all wanted pixels: read the log once, in order, for the first entry at or above the pixel's S.

    state: [tiles * PLANES * TILE]. wanted: [tiles * TILE], not 0 where the crossing is asked for. found:
    LoggedCrossings, filled; last_ordinal is filled for every pixel.
    """
    sums = np.empty(TILE, np.int32)
    for tile in range(log.where.shape[0]):
        origin = tile * TILE
        base = origin * PLANES
        for pixel in range(TILE):
            minimum = min(state[base + TAIL_DIP * TILE + pixel], state[base + MINIMUM * TILE + pixel])
            sums[pixel] = np.int32(state[base + pixel]) + np.int32(minimum)
            if wanted[origin + pixel] == 0:
                # one comparison for both: an unwanted pixel gets an S that no entry reaches
                sums[pixel] = OUT_OF_REACH
            found.ordinal[origin + pixel] = NEVER
            found.later_dip[origin + pixel] = NO_DIP
            found.last_ordinal[origin + pixel] = 0
        where = log.where[tile]
        levels = log.levels[tile]
        for index in range(log.entries[tile]):
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
            # an earlier maximum at or above S may have been dropped: from just below this entry, or from the bottom
            lost = (entry & GAP) != 0 or 2 * np.int32(log.lost_low[tile, pixel]) >= sums[pixel]
            found.ordinal[at] = UNKNOWN if lost else entry >> 16
            found.level[at] = value
            found.before[at] = levels[index, BEFORE]
