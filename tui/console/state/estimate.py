"""What a scan would take according to the daemon, or why the daemon would refuse it; pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from acquire.contract.units import format_bytes, format_duration
from tui.console.state.next_scan import NextScan


@dataclass(frozen=True)
class Estimate:
    """An answer to ``estimate``; the default is: not known."""

    known: bool = False
    expected: int = 0
    seconds: float = 0.0
    nbytes: int = 0
    free_bytes: int = 0
    warnings: tuple[str, ...] = ()
    refused: str = ""
    """Why such a scan would be refused; empty if it would not."""

    @classmethod
    def of_answer(cls, *, ok: bool, detail: str, result: Mapping[str, Any]) -> Estimate:
        """From a reply; one without numbers leaves it unknown."""
        if not ok:
            return cls(refused=detail)
        try:
            return cls(
                known=True,
                expected=int(result["expected"]),
                seconds=float(result["seconds"]),
                nbytes=int(result["bytes"]),
                free_bytes=int(result["free_bytes"]),
                warnings=tuple(str(text) for text in result.get("warnings", ())),
            )
        except (KeyError, TypeError, ValueError):
            return cls()

    def words(self, scan: NextScan, width: int = 80) -> str:
        """``527 frames  0:00:36  415.2 MB of 80.1 GB free``, without the free space where there is no room."""
        if not self.known:
            return f"{scan.frames} frames"
        short = f"{self.expected} frames  {format_duration(self.seconds)}  {format_bytes(self.nbytes)}"
        long = f"{short} of {format_bytes(self.free_bytes)} free"
        return long if len(long) <= width else short
