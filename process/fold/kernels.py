"""Compiled loop of the one-pass fold: running extremes and the log of new maxima (algorithm 1 of the paper).

Exact integers only. Levels are uint8 or uint16, flat arrays of whole tiles (see ``process.pixel_layout``). A falling
edge
is folded as the rising edge of the complement: every level is XORed with ``flip`` (full scale, or 0) when it is read.

The paper's algorithm 1 updates the minimum only where a pixel is no new maximum, so that a pixel that only brightens
never gets a minimum. Here both are compared for every frame.
"""

from __future__ import annotations

import numpy as np

from process.fold.maxima_log import compact_tile
from process.numba_cache import inlined_kernel, kernel
from process.pixel_layout import BEFORE, BLOCKS, DIP, MAXIMUM, MINIMUM, PLANES, TAIL_DIP, TAIL_RISE, TILE, VALUE
from process.simd import BLOCK, count_bits, fold_block, lowest_bit, prefetch


@kernel
def start_state(first, state):
    """Begin all planes with the first folded frame [tiles * TILE], already flipped; state [tiles * PLANES * TILE]."""
    for tile in range(first.size // TILE):
        frame = first[tile * TILE : (tile + 1) * TILE]
        base = tile * TILE * PLANES
        for pixel in range(TILE):
            state[base + MAXIMUM * TILE + pixel] = frame[pixel]
            state[base + TAIL_DIP * TILE + pixel] = frame[pixel]
            state[base + TAIL_RISE * TILE + pixel] = 0
            state[base + MINIMUM * TILE + pixel] = frame[pixel]


@inlined_kernel
def list_bits(masks, used, listed):
    """Offsets of the set bits of masks [BLOCKS], ascending, into listed [TILE + 2]; returns their number.

    used [BLOCKS + 1] is scratch: the masks that are not zero.
    """
    one = np.uint64(1)
    # No branch on the data here: new maxima are rare and irregular, a mispredicted branch on each costs more than all
    # the rest. So the counter advances by a comparison, and two bits are written per mask whether they are set or not;
    # `following` then sets the counter right.
    n_used = 0
    for block in range(BLOCKS):
        used[n_used] = block
        n_used += masks[block] != 0
    found = np.uint64(0)
    for index in range(n_used):
        mask = masks[used[index]]
        following = found + count_bits(mask)
        place = np.uint64(used[index]) * np.uint64(BLOCK)
        listed[found] = place + lowest_bit(mask)
        mask &= mask - one  # clears the lowest set bit
        listed[found + one] = place + lowest_bit(mask)
        mask &= mask - one
        found += np.uint64(2)
        while mask != 0:
            listed[found] = place + lowest_bit(mask)
            mask &= mask - one
            found += one
        found = following
    return found


@kernel
def fold_frames(frames, tails, n_frames, first_ordinal, flip, state, log):
    """Fold frames[1] .. frames[n_frames], in this order, into state and log; frames[0] is the one before them.

    Args:
        frames: tuple of flat original frames [h * w].
        tails: tuple of the same frames' last, incomplete tile [TILE].
        n_frames: frames to fold.
        first_ordinal: number of frames[1] among the folded frames, >= 1: frame 0 only starts the state.
        flip: XORed into each level; full scale for falling edges, else 0.
        state: [tiles * PLANES * TILE], see ``process.pixel_layout``.
        log: MaximaLog.

    The result does not depend on how the frames are split into calls.
    """
    room = log.where.shape[1]
    one = np.uint64(1)
    flip = np.uint64(flip)
    masks = np.empty(BLOCKS, np.uint64)
    used = np.empty(BLOCKS + 1, np.uint64)
    listed = np.empty(TILE + 2, np.uint64)
    # Tiles outside, frames inside: the four planes of a tile stay in the first-level cache for all frames of the call.
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
        entries = np.uint64(log.entries[tile])
        before = sources[0][at : at + TILE]
        for k in range(n_frames):
            # One frame adds at most one entry per pixel: with room for TILE more, the loop below need not check.
            if entries > np.uint64(room - TILE):
                lost_low = log.lost_low[tile]
                entries = np.uint64(compact_tile(where, levels, np.int64(entries), lost_low, maxima, minima, dips))
            source = sources[k + 1]
            frame = source[at : at + TILE]
            stamp = (first_ordinal + k) << 16
            for block in range(0, TILE, BLOCK):
                prefetch(source, at + block + TILE)  # the same block of the next tile: frames come from main memory
                masks[block // BLOCK] = fold_block(source, at + block, flip, state, base + block, TILE)
            # Every crossing is a new maximum: before it all values lie below S, and S <= max. So only these are logged.
            for index in range(list_bits(masks, used, listed)):
                pixel = listed[index]
                value = frame[pixel] ^ flip
                dip = dips[pixel]
                where[entries] = stamp | pixel
                levels[entries, VALUE] = value
                levels[entries, BEFORE] = before[pixel] ^ flip
                levels[entries, DIP] = dip
                entries += one
                maxima[pixel] = value
                # dip and rise count from the newest maximum on; the minimum takes over what the dip had before
                dips[pixel] = value
                rises[pixel] = 0
                minima[pixel] = min(dip, minima[pixel])
            before = frame
        log.entries[tile] = np.int64(entries)
