"""Own the compiled loop that folds frames into state and log; exact integers only."""

from __future__ import annotations

import numpy as np

from process.fold.maxima_log import compact_tile
from process.numba_cache import inlined_kernel, kernel
from process.pixel_layout import BEFORE, BLOCKS, DIP, MAXIMUM, MINIMUM, PLANES, TAIL_DIP, TAIL_RISE, TILE, VALUE
from process.simd import BLOCK, count_bits, fold_block, lowest_bit, prefetch


@kernel
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


@inlined_kernel
def list_bits(masks, used, listed):
    """Places of the set bits of masks [BLOCKS], ascending, into listed [TILE + 2]; returns their number.

    The used masks are listed first [BLOCKS + 1], and two bits of each are written whether they are there
    or not: a branch on each would be predicted wrongly, and cost more than all the rest.
    """
    one = np.uint64(1)
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


@kernel
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
    used = np.empty(BLOCKS + 1, np.uint64)
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
                lost_low = log.lost_low[tile]
                waiting = np.uint64(compact_tile(where, levels, np.int64(waiting), lost_low, maxima, minima, dips))
            source = sources[k + 1]
            frame = source[at : at + TILE]
            stamp = (first_ordinal + k) << 16
            for block in range(0, TILE, BLOCK):
                prefetch(source, at + block + TILE)
                masks[block // BLOCK] = fold_block(source, at + block, flip, state, base + block, TILE)
            for index in range(list_bits(masks, used, listed)):
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
