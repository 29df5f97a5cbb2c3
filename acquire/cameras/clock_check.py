"""Checks a camera's time stamps against the host's clock: some cameras count in another unit, or not at all."""

from __future__ import annotations

from dataclasses import dataclass

_LEAST_NS = 200_000_000
"""So far apart must two frames be to judge by."""
_SHARE, _JITTER_NS = 0.1, 50_000_000
"""So much may its time differ from the host's: a share of the time between them, and how late a frame may come."""


@dataclass
class CameraClock:
    """Trusts the camera's clock once it has agreed with the host's over an interval."""

    _first: tuple[int, int] | None = None
    _agreed: bool = False

    def believed(self, camera_ns: int, now_ns: int) -> int:
        """``camera_ns`` of a frame that came at ``now_ns`` (host's clock) if the clock is trusted, else 0 (unknown)."""
        if camera_ns <= 0:
            return 0
        if not self._agreed:
            self._compare(camera_ns, now_ns)
        return camera_ns if self._agreed else 0

    def _compare(self, camera_ns: int, now_ns: int) -> None:
        if self._first is None:
            self._first = camera_ns, now_ns
            return
        elapsed_ns = now_ns - self._first[1]
        if elapsed_ns < _LEAST_NS:
            return
        differ_ns = abs(camera_ns - self._first[0] - elapsed_ns)
        self._agreed = differ_ns <= _SHARE * elapsed_ns + _JITTER_NS
        self._first = camera_ns, now_ns
