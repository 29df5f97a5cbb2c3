"""Recognises folders of the original program: bitmaps of a sweep with equal steps, and a projector.txt."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

NAME: Final = "projector.txt"
MAX_FILE_BYTES: Final = 100_000
STEPS_PER_FRAME: Final = 3
"""Microsteps from one frame to the next: it knows no other sweep."""
UM_PER_MICROSTEP: Final = 3.175
_FRAME: Final = re.compile(r"^\s*Frame\s+(\d+)\b", re.MULTILINE)


@dataclass(frozen=True)
class OriginalFolder:
    """The sweep as projector.txt describes it."""

    last_frame: int | None
    """1-based number of the last frame; None where the file is not understood."""

    def note(self, pictures: int) -> str:
        """Remark for the operator about the positions."""
        if self.last_frame is None:
            return f"{NAME} is not understood: positions are not known"
        where = (
            f"positions count from the first frame, {STEPS_PER_FRAME} microsteps of {UM_PER_MICROSTEP} um a frame, as "
            "the original program sweeps"
        )
        if self.last_frame == pictures:
            return where
        return f"{NAME} speaks of {self.last_frame} frames and there are {pictures}: positions are not known"

    def um_per_frame(self, pictures: int) -> float | None:
        """Travel per frame; None if pictures are missing, because it is unknown which."""
        return STEPS_PER_FRAME * UM_PER_MICROSTEP if self.last_frame == pictures else None


def look_for_original(folder: Path) -> OriginalFolder | None:
    """The sweep of the original program in ``folder``; None where there is no projector.txt."""
    path = folder / NAME
    if not path.is_file():
        return None
    try:
        text = path.read_text(encoding="latin-1") if path.stat().st_size <= MAX_FILE_BYTES else ""
    except OSError:
        text = ""
    numbers = [int(number) for number in _FRAME.findall(text)]
    return OriginalFolder(max(numbers) if len(numbers) >= 2 else None)
