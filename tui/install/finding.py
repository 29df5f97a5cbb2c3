"""Owns what a check of the machine says: what was found, how bad it is, and the mend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "note", "wrong"]


@dataclass(frozen=True)
class Finding:
    """What one check says."""

    name: str
    level: Level
    text: str
    mend: str = ""
    """What to do; empty if nothing."""
