"""The arguments of each command as a typed struct with bounds."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Purpose
from acquire.contract.plan import Position


@dataclass(frozen=True)
class Call:
    """One command as it came."""

    client: str
    """Name of the client; empty: a client that cannot hold control."""
    now_ns: int
    """CLOCK_MONOTONIC."""


Result = dict[str, Any]
"""What the reply to a command contains."""
Label = Annotated[str, Meta(max_length=200)]
Shift = Annotated[float, Meta(ge=-5000, le=5000)]


class ScanRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``scan`` and ``estimate``: what is left out comes from the configuration."""

    name: Annotated[str, Meta(min_length=1, max_length=100)] = "scan"
    first_steps: Position | None = None
    last_steps: Position | None = None
    steps_per_frame: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    mode: Literal["step", "fly"] | None = None
    settle_ms: Annotated[float, Meta(ge=0, le=60_000)] | None = None
    specimen: Label = ""
    operator: Label = ""
    notes: Annotated[str, Meta(max_length=4000)] = ""
    tags: Annotated[list[Label], Meta(max_length=50)] = []
    purpose: Purpose = "object"


class ResumeScanRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``resume_scan``: go on with an interrupted or stopped sweep from its last commit."""

    path: Annotated[str, Meta(min_length=1, max_length=4096)]
    """Absolute path of the scan's folder or file."""


class GotoRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``goto``: an absolute move."""

    position_steps: Position


class JogRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``jog``: one bounded relative move."""

    steps: Annotated[int, Meta(ge=-10_000, le=10_000)]


class LampRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``lamp``: on or off."""

    on: bool


class CameraRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``camera``: settings that change; those left out stay."""

    exposure_ms: Annotated[float, Meta(gt=0, le=60_000)] | None = None
    gain: Annotated[float, Meta(ge=0, le=48)] | None = None
    brightness_percent: Annotated[float, Meta(ge=0, le=100)] | None = None


class PreviewRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``preview``: pictures without a sweep, on or off; on again changes the rate."""

    on: bool
    rate_hz: Annotated[float, Meta(gt=0, le=30)] = 5.0


class PrescanRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``prescan``: one picture at every n-th position; what is left out comes from the configuration."""

    first_steps: Position | None = None
    last_steps: Position | None = None
    every_steps: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    """Microsteps between two pictures; None: those of twenty frames."""


class JogHoldRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``jog_hold``: move on under a lease; each call renews it, without one for 300 ms the stage stops."""

    direction: Literal[-1, 1]
    rate_steps_per_s: Annotated[float, Meta(gt=0, le=100_000)] = 200.0


class ControlRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``control``: take it (also from another holder), renew it, or release it. It lapses after 10 s."""

    action: Literal["take", "renew", "release"]


class CaptureRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``capture``: one picture in full size as a PNG file."""

    path: Annotated[str, Meta(max_length=4096)] = ""
    """Absolute path within the folder of scans, of a file that is not there; empty: captures/<UTC>.png there."""


class SpecimenRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``specimen``: lay another specimen under the simulated camera, or turn it; what is left out stays."""

    object: Literal["stirrup", "dome", "wedge", "flat", "checkerboard"] | None = None
    tilt_x_deg: Annotated[float, Meta(ge=-30, le=30)] | None = None
    tilt_y_deg: Annotated[float, Meta(ge=-30, le=30)] | None = None
    yaw_deg: Annotated[float, Meta(ge=-180, le=180)] | None = None
    moved_um: tuple[Shift, Shift, Shift] | None = None
    """Displacement x, y, z from its place, in um."""


class AcknowledgeRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``acknowledge``: the operator has seen a fault; empty means all."""

    code: Annotated[str, Meta(max_length=8)] = ""


class NoArguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Commands that take none."""


R = TypeVar("R", bound=msgspec.Struct)


def parse_request(name: str, kind: type[R], args: dict[str, Any]) -> R:
    """The typed arguments of the command ``name``.

    Raises:
        CommandRefusedError: an unknown argument, or a value out of its bounds.
    """
    try:
        return msgspec.convert(args, kind, strict=True)
    except msgspec.ValidationError as error:
        raise CommandRefusedError(f"{name}: {_plainly(str(error))}") from None


_KINDS = {"float": "a number", "int": "a whole number", "str": "a text", "bool": "true or false", "array": "a list"}


def _plainly(complaint: str) -> str:
    """msgspec's message about a value that does not fit, for operators: ``gain must be a number <= 48.0``."""
    found = re.fullmatch(r"Expected `(\w+)(?: \| null)?`(.*?)(?:, got `\w+`)? - at `\$\.(\w+)`", complaint)
    if found is None:
        return complaint
    kind, bound, field = found.groups()
    return f"{field} must be {_KINDS.get(kind, kind)}{bound}"
