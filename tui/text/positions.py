"""Stage positions as people type them; pure."""

from __future__ import annotations

import re


def parse_position(text: str, um_per_microstep: float) -> int:
    """Microsteps of ``1578``, ``1578 steps``, ``5010um`` or ``5.01mm`` (um and mm to the nearest microstep).

    Raises:
        ValueError: it is not a position.
    """
    found = re.fullmatch(r"\s*([+-]?\d+(?:\.\d+)?)\s*(steps|um|mm)?\s*", text)
    if found is None:
        raise ValueError(f"{text!r} is not a position: type microsteps (1578), um (5010um) or mm (5.01mm)")
    value, unit = float(found[1]), found[2] or "steps"
    if unit == "steps":
        if not value.is_integer():
            raise ValueError(f"{text!r}: microsteps are whole numbers; write {found[1]}um for um")
        return int(value)
    return round(value * (1000.0 if unit == "mm" else 1.0) / um_per_microstep)
