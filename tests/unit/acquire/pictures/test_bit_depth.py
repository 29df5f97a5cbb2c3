"""The depth of 16-bit pictures is found by a look at their values, and said."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.contract.errors import ScanFileError
from acquire.pictures.bit_depth import SeenValues, depth_of

RNG = np.random.default_rng(2)


def levels(bits: int) -> np.ndarray:
    """Values of a scan of so many bits: most levels, not the ends."""
    top = 1 << bits
    return np.unique(RNG.integers(top // 50, top - top // 50, 40 * top))


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
@pytest.mark.parametrize("how", ["right-aligned", "left-aligned", "rounded", "cut", "repeated"])
def test_fewer_bits_in_sixteen_are_found_and_stored_right_aligned(bits, how):
    plain, full = levels(bits), (1 << bits) - 1
    stored = {
        "right-aligned": plain,
        "left-aligned": plain << (16 - bits),
        "rounded": np.round(plain * 65535 / full).astype(np.int64),
        "cut": plain * 65535 // full,
        "repeated": (plain << (16 - bits)) | (plain >> (2 * bits - 16)),
    }[how]
    found = depth_of(stored)
    assert found.bits == bits and f"taken for {bits} bit" in found.words and "--bit-depth" in found.words
    assert np.array_equal(found.stored(stored), plain)
    again = depth_of(stored, bits)
    assert again.bits == bits and np.array_equal(again.stored(stored), plain)


def test_sixteen_true_bits_are_left_alone_without_a_word():
    found = depth_of(levels(16))
    assert (found.bits, found.table, found.words) == (16, None, "")


@pytest.mark.parametrize("values", [[0], [0, 65535], [0, 30000, 60000], list(range(0, 60000, 2000))])
def test_few_levels_are_no_scale(values):
    assert depth_of(np.array(values)).bits == 16


def test_a_common_factor_is_taken_out():
    found = depth_of(100 * levels(8))
    assert found.bits == 8 and "multiplied by 100" in found.words


def test_a_depth_that_the_values_exceed_is_refused():
    with pytest.raises(ScanFileError, match="more than 12 bit have"):
        depth_of(levels(16), 12)


def test_a_depth_that_was_asked_for_is_kept_where_the_values_fit():
    assert depth_of(levels(12), 16).bits == 16 and depth_of(257 * levels(8), 16).table is None


def test_values_of_all_pictures_count():
    seen = SeenValues()
    seen.add(np.arange(256, dtype=np.uint16).reshape(16, 16))
    seen.add(np.full((2, 2, 3), 4095, np.uint16))
    seen.add(np.full((2, 2), 255, np.uint8))
    assert seen.depth().bits == 12


def test_a_depth_that_was_asked_for_keeps_values_that_fit_right_aligned_whatever_their_step():
    found = depth_of(16 * levels(8), 12)
    assert found.bits == 12 and found.table is None
