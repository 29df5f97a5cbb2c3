"""Parsers of what people type into forms: positions, the plan, names, folders; ValueErrors say what is wrong; pure."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from tui.console.state.next_scan import NextScan
from tui.text.positions import parse_position

NAME_WORDS = "not a name: use 1 to 64 letters, digits, - _ . without spaces"


def parse_number(text: str, label: str, low: float, high: float) -> float:
    """A number within limits.

    Raises:
        ValueError: not a number, or outside.
    """
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{label}: {text!r} is not a number") from None
    if not low <= value <= high:
        raise ValueError(f"{label}: {text} is outside of {low:g} to {high:g}")
    return value


def parse_plan(texts: dict[str, str], scan: NextScan, travel_steps: tuple[int, int]) -> NextScan:
    """``scan`` with the plan that was typed.

    Raises:
        ValueError: a value is wrong or outside its limits.
    """
    first = parse_position(texts["first"], scan.um_per_microstep)
    last = parse_position(texts["last"], scan.um_per_microstep)
    for label, position in (("first", first), ("last", last)):
        if travel_steps[0] < travel_steps[1] and not travel_steps[0] <= position <= travel_steps[1]:
            raise ValueError(f"{label}: {position} is outside of the travel, {travel_steps[0]} to {travel_steps[1]}")
    steps = parse_number(texts["steps"], "steps per frame", 1, 100_000)
    if not steps.is_integer():
        raise ValueError("steps per frame: whole microsteps")
    mode = texts["mode"].lower()
    if mode not in ("step", "fly"):
        raise ValueError(f"mode: {texts['mode']!r} is neither step nor fly")
    settle_ms = parse_number(texts["settle"], "settle time", 0, 60_000)
    return replace(scan, first_steps=first, last_steps=last, steps_per_frame=int(steps), mode=mode, settle_ms=settle_ms)


def parse_words(texts: dict[str, str], scan: NextScan) -> NextScan:
    """``scan`` with name, specimen, operator, notes and tags.

    Raises:
        ValueError: the name cannot be part of a folder's name.
    """
    tags = tuple(tag for tag in re.split(r"[,\s]+", texts["tags"]) if tag)
    return replace(
        scan,
        name=parse_name(texts["name"]),
        specimen=texts["specimen"],
        operator=texts["operator"],
        notes=texts["notes"],
        tags=tags,
    )


def parse_start(texts: dict[str, str], scan: NextScan) -> NextScan:
    """``scan`` with name, specimen and operator.

    Raises:
        ValueError: the name cannot be part of a folder's name.
    """
    return replace(scan, name=parse_name(texts["name"]), specimen=texts["specimen"], operator=texts["operator"])


def numbered(name: str) -> str:
    """The name of the next scan of a series: ``ear-2`` after ``ear``, ``ear-3`` after ``ear-2``."""
    found = re.fullmatch(r"(.*[A-Za-z_.])-(\d{1,3})", name)
    return f"{found[1]}-{int(found[2]) + 1}" if found else f"{name}-2"


def parse_name(text: str) -> str:
    """The name of a scan.

    Raises:
        ValueError: it cannot be part of a folder's name.
    """
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", text) is None:
        raise ValueError(NAME_WORDS)
    return text


def parse_folder(text: str) -> str:
    """An absolute path, ``~`` expanded.

    Raises:
        ValueError: it is not absolute.
    """
    try:
        path = Path(text).expanduser()
    except RuntimeError:
        raise ValueError(f"the home folder in {text} is not known: give the whole path") from None
    if not text or not path.is_absolute():
        raise ValueError("give the whole path of a folder, for example /mnt/disk/scans")
    return str(path)
