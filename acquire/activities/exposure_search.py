"""Automatic exposure: finds the one with which the brightest pixels lie just below full scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Final

import msgspec

from acquire.cameras.protocol import CameraFrame
from acquire.rigs.base import Rig

from .base import Activity
from .images import measure

TARGET: Final = 0.85
"""Wanted 99.9th percentile, as a share of full scale."""
CLOSE_ENOUGH: Final = 0.03
LEAST: Final = 0.4
"""Below this share at the longest exposure pictures are too dark to be of use."""
SATURATED: Final = 0.985
DARK: Final = 0.02
"""Brightness above black below which the brightness at a longer exposure cannot be predicted."""
MOST_PICTURES: Final = 12
_LONGER, _SHORTER = 8.0, 0.35


@dataclass(frozen=True)
class Advice:
    """The next step after a picture."""

    exposure_ms: float
    done: bool = False
    complaint: str = ""
    """Why there is no good exposure; empty where there may be one."""


def advise(exposure_ms: float, high: float, black: float, bounds_ms: tuple[float, float]) -> Advice:
    """The next exposure after a picture taken at ``exposure_ms``.

    Args:
        exposure_ms: with which the picture was taken, within the bounds.
        high: its 99.9th percentile as a share of full scale.
        black: the black level as a share of full scale.
        bounds_ms: shortest and longest exposure.
    """
    shortest, longest = bounds_ms
    if abs(high - TARGET) <= CLOSE_ENOUGH:
        return Advice(exposure_ms, done=True)
    if high >= SATURATED and exposure_ms <= shortest:
        complaint = f"saturated even at the shortest exposure, {shortest:g} ms: lower the gain, or dim the lamp"
        return Advice(exposure_ms, done=True, complaint=complaint)
    if high < TARGET and exposure_ms >= longest:
        return _at_longest(longest, high)
    if high >= SATURATED:
        factor = _SHORTER
    elif high - black < DARK:
        factor = _LONGER
    else:
        factor = (TARGET - black) / (high - black)
    return Advice(min(max(exposure_ms * factor, shortest), longest))


def _at_longest(longest_ms: float, high: float) -> Advice:
    if high >= LEAST:
        return Advice(longest_ms, done=True)
    return Advice(
        longest_ms,
        done=True,
        complaint=f"too dark even at the longest exposure, {longest_ms:g} ms (the brightest reach {100 * high:.0f} % "
        "of full scale): bring the light over the specimen, raise the gain, or lower sweep.max_rate_hz",
    )


class ExposureSearch(Activity):
    """Takes pictures with one exposure after the other; a failure restores the first one."""

    name: ClassVar[str] = "exposure"
    snaps: ClassVar[bool] = True

    def __init__(self, rig: Rig, snap: Callable[[int], None], bounds_ms: tuple[float, float]) -> None:
        """``snap`` takes a picture at a time (ns); ``bounds_ms`` are the shortest and the longest exposure."""
        super().__init__()
        self._rig, self._snap, self._bounds = rig, snap, bounds_ms
        self._before_ms = rig.camera_settings.exposure_ms
        self._exposure_ms = min(max(self._before_ms, bounds_ms[0]), bounds_ms[1])
        self._black = rig.camera_settings.brightness_percent / 100
        self._pictures = 0

    def begin(self, now_ns: int) -> None:
        """The first picture is taken with the exposure as it is."""
        self._take_picture(self._exposure_ms, now_ns)

    def on_frame(self, frame: CameraFrame, now_ns: int) -> None:
        """Judge the picture; take another one, or end."""
        high = measure(frame.pixels, self._rig.camera_info.format.bit_depth).high / 255
        advice = advise(self._exposure_ms, high, self._black, self._bounds)
        self._pictures += 1
        self.share = self._pictures / MOST_PICTURES
        if advice.complaint:
            self._fail(advice.complaint)
        elif advice.done:
            self.end(f"{self._exposure_ms:.3g} ms, the brightest at {100 * high:.0f} % of full scale; locked")
        elif self._pictures >= MOST_PICTURES:
            self._fail(f"not found in {MOST_PICTURES} pictures: does the light change?")
        else:
            self._take_picture(advice.exposure_ms, now_ns)

    def on_no_frame(self, now_ns: int) -> None:
        """The search cannot go on."""
        self._fail("no usable picture came from the camera: is it connected?")

    def cancel(self) -> None:
        """Restore the exposure."""
        self._expose(self._before_ms)

    def _expose(self, exposure_ms: float) -> float:
        wanted = msgspec.structs.replace(self._rig.camera_settings, exposure_ms=exposure_ms)
        return self._rig.configure_camera(wanted).exposure_ms

    def _take_picture(self, exposure_ms: float, now_ns: int) -> None:
        used_ms = self._expose(exposure_ms)
        # a camera may round: a bound that was asked for counts as reached
        self._exposure_ms = exposure_ms if exposure_ms in self._bounds else used_ms
        self._snap(now_ns)

    def _fail(self, text: str) -> None:
        self.cancel()
        self.end(f"{text}; it is {self._before_ms:g} ms as before", failed=True)
