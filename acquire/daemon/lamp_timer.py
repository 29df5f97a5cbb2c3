"""Time until the light of the lamp is steady. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from acquire.contract.units import NS_PER_S


@dataclass
class LampTimer:
    """Counts from the first update with the lamp on."""

    warm_up_s: float
    """Warm-up time in s."""
    _on_since_ns: int | None = None

    def update(self, now_ns: int, *, on: bool) -> float:
        """Seconds until the lamp is warm; 0 when it is, or when it is off."""
        if not on:
            self._on_since_ns = None
            return 0.0
        if self._on_since_ns is None:
            self._on_since_ns = now_ns
        return max(0.0, self.warm_up_s - (now_ns - self._on_since_ns) / NS_PER_S)
