"""Proves that the numbers of a series count frames: equal steps, no gap, no number twice."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Final

from acquire.contract.plan import MAX_FRAMES

from .names import Member, readable

_PROVEN: Final = 3
"""Pictures that prove a step other than 1; of fewer nobody knows whether some are missing between."""
_SPARSE: Final = 3
"""Where there are more places than so many times the pictures, uneven numbers are no count of frames with gaps."""


@dataclass(frozen=True)
class Gap:
    """Numbers that are missing between two pictures."""

    first: str
    """Name of the first missing picture, without suffix, as it would be."""
    last: str
    frames: int
    before: str
    after: str

    def words(self) -> str:
        """What is missing where."""
        what = f"{self.first} is" if self.frames == 1 else f"{self.first} to {self.last} ({self.frames} pictures) are"
        return f"{what} missing between {self.before} and {self.after}"


@dataclass(frozen=True)
class Numbering:
    """Frame indices of a series by its numbers."""

    first: int
    """Number of frame 0."""
    step: int
    """From one frame to the next."""
    indices: tuple[int, ...]
    """Frame index of each member, ascending."""
    gaps: tuple[Gap, ...]
    faults: tuple[str, ...]
    """What forbids to take the numbers for frames, missing ones or not; in words."""

    @property
    def count(self) -> int:
        """Frames from the first to the last number."""
        return self.indices[-1] + 1

    def words(self) -> str:
        """First and last number, and the step if it is not 1."""
        last = self.first + self.indices[-1] * self.step
        return f"numbers {self.first} to {last}" + (f" in steps of {self.step}" if self.step != 1 else "")


def number_of(members: Sequence[Member]) -> Numbering:
    """The numbering of a series, in its order; what is wrong with it is in ``gaps`` and ``faults``."""
    numbers = [member.number or 0 for member in members]
    faults = _doubles(members)
    distinct = sorted(set(numbers))
    step = _step(distinct)
    uneven = next((pair for pair in pairwise(distinct) if (pair[1] - pair[0]) % step), None)
    count = (distinct[-1] - distinct[0]) // step + 1
    if uneven is not None or (count > MAX_FRAMES and len(distinct) > 1):
        faults.append(_uneven_words(members, step, uneven))
        return Numbering(numbers[0], step, tuple(range(len(members))), (), tuple(faults))
    indices = tuple((number - distinct[0]) // step for number in numbers)
    gaps = tuple(
        _gap(before, after, step)
        for before, after in pairwise(members)
        if (after.number or 0) - (before.number or 0) > step
    )
    return Numbering(distinct[0], step, indices, gaps, tuple(faults))


def _step(numbers: list[int]) -> int:
    if len(numbers) < _PROVEN:
        return 1
    steps = Counter(after - before for before, after in pairwise(numbers))
    usual = min(step for step, times in steps.items() if times == max(steps.values()))
    common = math.gcd(*steps)
    dense = (numbers[-1] - numbers[0]) // common < _SPARSE * len(numbers)
    return common if dense and any(step % usual for step in steps) else usual


def _doubles(members: Sequence[Member]) -> list[str]:
    by_number = [list(group) for _, group in groupby(members, key=lambda member: member.number)]
    return [
        f"number {group[0].text} is there {len(group)} times: {' and '.join(readable(m.name) for m in group[:3])}"
        for group in by_number
        if len(group) > 1
    ]


def _uneven_words(members: Sequence[Member], step: int, uneven: tuple[int, int] | None) -> str:
    if uneven is None:
        return f"the numbers reach from {members[0].text} to {members[-1].text}: they do not count frames"
    names = {member.number: readable(member.name) for member in members}
    return (
        f"the numbers in the names do not count in equal steps: {names[uneven[0]]} and {names[uneven[1]]} are "
        f"{uneven[1] - uneven[0]} apart, most are {step} (are they times?)"
    )


def _gap(before: Member, after: Member, step: int) -> Gap:
    first, last = (before.number or 0) + step, (after.number or 0) - step
    return Gap(
        _with_number(before, first),
        _with_number(before, last),
        (last - first) // step + 1,
        readable(Path(before.name).stem),
        readable(Path(after.name).stem),
    )


def _with_number(member: Member, number: int) -> str:
    """The member's name without suffix, with another number as wide as its own."""
    stem = Path(member.name).stem
    text = str(abs(number)).zfill(len(member.text))
    negative = (member.number or 0) < 0
    head, tail = stem[: member.at - negative], stem[member.at + len(member.text) :]
    return readable(f"{head}{'-' if number < 0 else ''}{text}{tail}")
