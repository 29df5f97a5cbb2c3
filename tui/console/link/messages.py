"""What the console's input thread tells the screen, as Textual messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from textual.message import Message

from acquire.contract.messaging.messages import ResultEnd, ResultProgress, Status
from tui.console.link.rig_view import MapsView, PictureView
from tui.processes.child_jobs import Job


@dataclass
class Updates(Message):
    """Everything that came since the last bundle; no more is posted until this one is ``taken``."""

    parts: list[Message]
    taken: Callable[[], None]


@dataclass
class StatusArrived(Message):
    """The newest state of the rig."""

    status: Status


@dataclass
class ProgressArrived(Message):
    """How far the worker is."""

    progress: ResultProgress


@dataclass
class PictureArrived(Message):
    """The newest camera picture."""

    picture: PictureView


@dataclass
class MapsArrived(Message):
    """The newest sampled maps."""

    maps: MapsView


@dataclass
class ResultsOnDisk(Message):
    """Maps and cloud of a scan are on disk."""

    result: ResultEnd


@dataclass
class LinkChanged(Message):
    """The daemon is heard, or no longer."""

    connected: bool
    detail: str
    """Where it is heard, or why not."""


@dataclass
class CommandAnswered(Message):
    """What became of a command that was sent from here."""

    name: str
    ok: bool
    detail: str
    """The daemon's words, or why there are none."""
    at_mono_ns: int = 0
    """CLOCK_MONOTONIC when the daemon answered, or when the answer was given up."""
    request_id: str = ""
    """As :meth:`tui.console.options.Link.send` returned it."""
    result: dict[str, Any] = field(default_factory=dict)
    """What the reply carried."""


@dataclass
class PageKnown(Message):
    """The address of the page in the browser; empty when the viewer is away."""

    url: str


@dataclass
class Note(Message):
    """A line for the log from somewhere else in this process."""

    text: str
    level: str = "info"
    """``info``, ``warning`` or ``error``."""


@dataclass
class JobChanged(Message):
    """A child process of the console is further, or has ended."""

    job: Job

    def can_replace(self, message: Message) -> bool:
        """Only the newest counts."""
        return isinstance(message, JobChanged) and message.job.number == self.job.number
