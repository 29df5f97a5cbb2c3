"""Scripted faults of the simulated camera and lamp, by exposure number. For tests; an empty script means none.

``lose:12,extra:30`` loses the frame of exposure 12 and delivers an untriggered one after exposure 30.
Exposures are counted from 0 since the camera was opened (checks and re-taken frames count).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from acquire.contract.errors import ConfigError

from .protocol import CameraFrame, CameraGone

MANUAL: Final = {
    "lose": "its frame never comes, its id is used up",
    "skip": "the trigger is not seen, no id is used up",
    "extra": "another frame follows that nobody triggered",
    "double": "it is delivered twice",
    "late": "it is delivered after the one that follows",
    "stray": "the frame before comes once more, ahead of it",
    "shape": "its frame has a row less",
    "type": "its frame has another type",
    "restart": "the camera restarts: the frame is lost, ids start at 0",
    "dim": "from here on the lamp gives 70 % of its light",
    "dark": "from here on the lamp is out",
    "room": "from here on the room is bright",
    "mend": "from here on the light is as it was",
}
_LIGHTS: Final = {"dim": (0.7, 1.0), "dark": (0.0, 1.0), "room": (1.0, 5.0), "mend": (1.0, 1.0)}
Event = CameraFrame | CameraGone


def parse_script(text: str) -> dict[int, list[str]]:
    """``verb:exposure,...`` as exposure -> verbs.

    Raises:
        ConfigError: an unknown verb, or no number.
    """
    script: dict[int, list[str]] = {}
    for part in filter(None, text.split(",")):
        verb, _, number = part.strip().partition(":")
        if verb not in MANUAL or not number.isdecimal():
            raise ConfigError(f"simulation.faults: {part!r} is not one of {', '.join(MANUAL)}, ':' and an exposure")
        script.setdefault(int(number), []).append(verb)
    return script


@dataclass
class ScriptedFaults:
    """Applied to each exposure in order, in the camera's thread."""

    script: dict[int, list[str]]
    lamp: float = 1.0
    """Factor on the lamp's light now."""
    room: float = 1.0
    """Factor on the room's light now."""
    _exposure: int = -1
    _id_shift: int = 0
    _late: list[CameraFrame] = field(default_factory=list)
    _before: CameraFrame | None = None

    def begin(self) -> tuple[float, float]:
        """Begin the next exposure, in which the light may change; returns the factors ``lamp`` and ``room``."""
        self._exposure += 1
        for verb in self._verbs():
            if verb in _LIGHTS:
                self.lamp, self.room = _LIGHTS[verb]
        return self.lamp, self.room

    def deliver(self, frame: CameraFrame) -> Iterator[Event]:
        """The frames that are really delivered for a frame."""
        events: list[Event] = [replace(frame, camera_frame_id=frame.camera_frame_id + self._id_shift)]
        for verb in self._verbs():
            if verb in _DOERS:
                events = _DOERS[verb](self, events[0]) if isinstance(events[0], CameraFrame) else events
        self._before = events[-1] if events and isinstance(events[-1], CameraFrame) else None
        late, self._late = ([], self._late) if not events else (self._late, [])
        yield from events
        yield from late

    def _verbs(self) -> list[str]:
        return self.script.get(self._exposure, [])

    def _skip(self, frame: CameraFrame) -> list[Event]:
        self._id_shift -= 1
        return []

    def _extra(self, frame: CameraFrame) -> list[Event]:
        self._id_shift += 1
        return [frame, replace(frame, camera_frame_id=frame.camera_frame_id + 1)]

    def _stray(self, frame: CameraFrame) -> list[Event]:
        return [frame] if self._before is None else [self._before, frame]

    def _delay(self, frame: CameraFrame) -> list[Event]:
        self._late.append(frame)
        return []

    def _restart(self, frame: CameraFrame) -> list[Event]:
        self._id_shift -= frame.camera_frame_id + 1
        return [CameraGone("the camera restarted"), CameraGone("", back=True)]

    def _other_type(self, frame: CameraFrame) -> list[Event]:
        kind = np.uint16 if frame.pixels.dtype == np.uint8 else np.uint8
        return [replace(frame, pixels=frame.pixels.astype(kind))]


_DOERS: Final[dict[str, Callable[[ScriptedFaults, CameraFrame], list[Event]]]] = {
    "lose": lambda _faults, _frame: [],
    "skip": ScriptedFaults._skip,
    "extra": ScriptedFaults._extra,
    "double": lambda _faults, frame: [frame, frame],
    "late": ScriptedFaults._delay,
    "stray": ScriptedFaults._stray,
    "shape": lambda _faults, frame: [replace(frame, pixels=frame.pixels[:-1].copy())],
    "type": ScriptedFaults._other_type,
    "restart": ScriptedFaults._restart,
}
