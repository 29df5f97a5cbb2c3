"""Frame indices as ranges, as messages and reports contain them."""

from __future__ import annotations


def ranges_of(indices: list[int]) -> list[tuple[int, int]]:
    """Sorted indices as ranges [first, last], both ends included."""
    ranges: list[tuple[int, int]] = []
    for index in sorted(indices):
        if ranges and index == ranges[-1][1] + 1:
            ranges[-1] = (ranges[-1][0], index)
        else:
            ranges.append((index, index))
    return ranges


def indices_of(ranges: list[tuple[int, int]]) -> list[int]:
    """The indices in ranges [first, last]."""
    return [index for first, last in ranges for index in range(first, last + 1)]
