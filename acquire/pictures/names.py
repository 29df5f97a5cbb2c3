"""Names of pictures as a person can read them, and their series: which share a pattern and differ in a number only."""

from __future__ import annotations

import glob
import os
import re
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Final, NamedTuple

_DIGITS: Final = re.compile(r"\d+")
_SIGN: Final = re.compile(r"(?:^|[\W_])-$")
_MARK: Final = "\0"
"""Stands for a number; no file name holds it."""
_SAME_SUFFIX: Final = {".tiff": ".tif", ".jpeg": ".jpg"}
_SHOWN: Final = 8
_FEW_WIDTH: Final = 9


def readable(name: str | os.PathLike[str]) -> str:
    r"""A file name for messages and reports: bytes that are no UTF-8, and control characters, as ``\xff``, ``\n``."""
    text = os.fsencode(name).decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def listed(names: Sequence[str], most: int = _SHOWN) -> str:
    """Names with commas, cut short where there are many."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


class Member(NamedTuple):
    """A picture of a series."""

    name: str
    number: int | None
    """The number that counts; None in a name without one."""
    text: str
    """The number as it stands in the name,"""
    at: int
    """and where in the name it begins."""


@dataclass(frozen=True)
class Series:
    """Names that differ in one number only, in the order of that number."""

    pattern: str
    """As a person reads it: ``left_####.png``."""
    members: tuple[Member, ...]
    globs: tuple[str, ...] = ()
    """Shell patterns that may select it."""
    contradiction: str = ""
    """Why the order is not told by the names: two numbers disagree. Empty where it is."""

    @property
    def names(self) -> list[str]:
        """In the order of the numbers."""
        return [member.name for member in self.members]

    def words(self) -> str:
        """The series in a few words."""
        return readable(self.pattern) + (f" ({len(self.members)} pictures)" if len(self.members) > 1 else "")


def series_of(names: Sequence[str]) -> list[Series]:
    """The series that ``names`` consist of, the longest first; a name that belongs to no other is one by itself."""
    by_template: dict[str, list[_Name]] = defaultdict(list)
    for name in _signed([_Name.of(name) for name in names]):
        by_template[name.template].append(name)
    found = [series for group in by_template.values() for series in _of_one_template(group)]
    return sorted(found, key=lambda series: (-len(series.members), series.pattern))


def matching(names: Sequence[str], pattern: str) -> list[str]:
    """Names that a shell pattern (``left_*.png``) fits, whatever their case."""
    return [name for name in names if fnmatchcase(_plain(name), _plain(pattern))]


def choosing(series: Series, names: Sequence[str]) -> str:
    """A shell pattern for --pattern that fits this series and no other of ``names``; empty where there is none."""
    wanted = set(series.names)
    return next((tried for tried in series.globs if set(matching(names, tried)) == wanted), "")


@dataclass(frozen=True)
class _Name:
    """A file name taken apart into text and numbers."""

    name: str
    template: str
    texts: tuple[str, ...]
    """The numbers as they stand in it."""
    negative: int = -1
    """Which of them has a minus sign; -1 for none."""

    @classmethod
    def of(cls, name: str) -> _Name:
        plain = _plain(name)
        return cls(name, _DIGITS.sub(_MARK, plain), tuple(_DIGITS.findall(plain)))

    @property
    def numbers(self) -> tuple[int, ...]:
        return tuple(-int(text) if place == self.negative else int(text) for place, text in enumerate(self.texts))


def _plain(name: str) -> str:
    # Mac folders hold decomposed letters; cameras change the case of suffixes
    plain = unicodedata.normalize("NFC", name).casefold()
    suffix = Path(plain).suffix
    return plain.removesuffix(suffix) + _SAME_SUFFIX.get(suffix, suffix)


def _signed(names: list[_Name]) -> list[_Name]:
    """Where the folder holds both ``-#`` and ``#``, the dash is a sign; elsewhere it separates."""
    templates = {name.template for name in names}
    if not any(f"-{_MARK}" in template for template in templates):
        return names
    return [_with_sign(name, templates) for name in names]


def _with_sign(name: _Name, templates: set[str]) -> _Name:
    parts = name.template.split(_MARK)
    for place in range(len(name.texts)):
        before = parts[place]
        without = _MARK.join([*parts[:place], before[:-1], *parts[place + 1 :]])
        if _SIGN.search(before) and without in templates:
            return _Name(name.name, without, name.texts, place)
    return name


def _of_one_template(names: list[_Name]) -> list[Series]:
    """The series among names that differ in numbers only."""
    columns = list(zip(*(name.numbers for name in names), strict=True))
    varying = [place for place, values in enumerate(columns) if len(set(values)) > 1]
    if not varying:  # one name, or several that differ in case or in leading zeros only
        return [_series(names, len(columns) - 1)]
    counters = [place for place in varying if len(set(columns[place])) == len(names)]
    if counters:
        counter = max(counters, key=lambda place: (*_evenness(columns[place]), place))
        others = [place for place in varying if place != counter]
        return [_series(names, counter, _disagreement(names, counter, others))]
    counter = min(varying, key=lambda place: (len(_grouped(names, varying, place)), -place))
    return [_series(group, counter) for group in _grouped(names, varying, counter)]


def _grouped(names: list[_Name], varying: list[int], counter: int) -> list[list[_Name]]:
    groups: dict[tuple[int, ...], list[_Name]] = defaultdict(list)
    for name in names:
        groups[tuple(name.numbers[place] for place in varying if place != counter)].append(name)
    return list(groups.values())


def _evenness(values: Sequence[int]) -> tuple[float, int]:
    """Share of the steps from one value to the next that are the most frequent one, and how small that is."""
    steps = Counter(after - before for before, after in pairwise(sorted(values)))
    step, times = steps.most_common(1)[0]
    return times / steps.total(), -step


def _disagreement(names: list[_Name], counter: int, others: list[int]) -> str:
    """Where the other numbers (a time, a part) go back while the counter goes up; empty where they never do."""
    ordered = sorted(names, key=lambda name: name.numbers[counter])
    for before, after in pairwise(ordered):
        if [after.numbers[place] for place in others] < [before.numbers[place] for place in others]:
            return (
                f"two numbers in the names disagree about the order: {readable(before.name)} and {readable(after.name)}"
            )
    return ""


def _series(names: list[_Name], counter: int, contradiction: str = "") -> Series:
    def member(name: _Name) -> Member:
        if counter < 0:
            return Member(name.name, None, "", 0)
        at = [found.start() for found in _DIGITS.finditer(name.name)][counter]
        return Member(name.name, name.numbers[counter], name.texts[counter], at)

    members = sorted((member(name) for name in names), key=lambda m: (m.number or 0, m.name))
    widths = {len(member.text) for member in members}
    width = widths.pop() if len(widths) == 1 else 0
    pattern = _filled(names, counter, "#" * min(max(width, 1), _FEW_WIDTH), escape=False)
    globs = [_filled(names, counter, filler, escape=True) for filler in ("*", "?" * width or "*")]
    globs += [str(Path(tried).with_suffix(".*")) for tried in globs]
    return Series(pattern, tuple(members), tuple(globs), contradiction)


def _filled(names: list[_Name], counter: int, filler: str, *, escape: bool) -> str:
    """The common text of names, with ``filler`` for the number that counts and ``*`` for others that vary."""
    shown = next((name for name in names if name.negative < 0), names[0])
    first = unicodedata.normalize("NFC", shown.name)
    texts = [filler if place == counter else text for place, text in enumerate(shown.texts)]
    for place in range(len(texts)):
        if place != counter and len({name.texts[place] for name in names}) > 1:
            texts[place] = "*"
    if len(names) == 1:
        texts = list(names[0].texts)
    # what a shell pattern would take for a set of characters or a wildcard stands for itself
    parts = [glob.escape(part) if escape else part for part in _DIGITS.split(first)]
    return "".join(part + text for part, text in zip_longest(parts, texts, fillvalue=""))
