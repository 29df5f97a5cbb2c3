"""What the console's input thread tells the screen: bundles of updates, the newest of each kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from textual.message import Message

from acquire.contract.messaging.messages import ResultEnd, ResultProgress, Status
from tui.console.link.rig_view import MapsView, PictureView


@dataclass(frozen=True)
class StatusArrived:
    """The newest state of the rig."""

    status: Status


@dataclass(frozen=True)
class ProgressArrived:
    """How far the worker is."""

    progress: ResultProgress


@dataclass(frozen=True)
class PictureArrived:
    """The newest camera picture."""

    picture: PictureView


@dataclass(frozen=True)
class MapsArrived:
    """The newest sampled maps."""

    maps: MapsView


@dataclass(frozen=True)
class ResultsOnDisk:
    """Maps and cloud of a scan are on disk."""

    result: ResultEnd


@dataclass(frozen=True)
class LinkChanged:
    """The daemon answers, or no longer."""

    connected: bool
    detail: str
    """Where it answers, or why it does not."""


@dataclass(frozen=True)
class CommandAnswered:
    """What became of a command that was sent from here."""

    name: str
    ok: bool
    detail: str
    """What the daemon replied, or why there is no reply."""
    at_mono_ns: int = 0
    """CLOCK_MONOTONIC when the daemon answered, or when the answer was given up."""
    request_id: str = ""
    """As :meth:`tui.console.shell.RigConnection.send` returned it."""
    result: dict[str, Any] = field(default_factory=dict)
    """Values of the reply."""


@dataclass(frozen=True)
class PageKnown:
    """The address of the page in the browser; empty when the viewer is away."""

    url: str


Update = (
    StatusArrived
    | ProgressArrived
    | PictureArrived
    | MapsArrived
    | ResultsOnDisk
    | LinkChanged
    | CommandAnswered
    | PageKnown
)


@dataclass
class Updates(Message):
    """Everything that came since the last bundle; no more is posted until this one is ``taken``."""

    parts: list[Update]
    taken: Callable[[], None]


@dataclass
class LogMessage(Message):
    """A line for the log, posted from another thread."""

    text: str
    level: str = "info"
    """``info``, ``warning`` or ``error``."""
