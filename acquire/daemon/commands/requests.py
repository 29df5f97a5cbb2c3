"""What clients may ask of the daemon: each command's arguments as a typed struct with bounds."""

from __future__ import annotations

import difflib
import re
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Purpose
from acquire.contract.plan import Position

Label = Annotated[str, Meta(max_length=200)]
Shift = Annotated[float, Meta(ge=-5000, le=5000)]


class ScanRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``scan``: what is left out comes from the configuration."""

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
    """``resume_scan``: go on with an interrupted sweep from its last commit."""

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
    """``prescan``: a quick look at every n-th position; what is left out comes from the configuration."""

    first_steps: Position | None = None
    last_steps: Position | None = None
    every_steps: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    """Microsteps between two looks; None: twenty frames' worth."""


class JogHoldRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``jog_hold``: move on under a lease; each call renews it, without one for 300 ms the stage stops."""

    direction: Literal[-1, 1]
    rate_steps_per_s: Annotated[float, Meta(gt=0, le=100_000)] = 200.0


class ControlRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``control``: take it (from whoever holds it), renew it, or give it back; it lapses 10 s after the last word."""

    action: Literal["take", "renew", "release"]


class CaptureRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``capture``: one picture in full size as a PNG file."""

    path: Annotated[str, Meta(max_length=4096)] = ""
    """Absolute path within the folder of scans, of a file that is not there; empty: captures/<UTC>.png there."""


class SpecimenRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``specimen``: lay something else under the simulated camera, or turn it; what is left out stays."""

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


REQUESTS: dict[str, type[msgspec.Struct]] = {
    "scan": ScanRequest,
    "resume_scan": ResumeScanRequest,
    "pause": NoArguments,
    "resume": NoArguments,
    "stop": NoArguments,
    "status": NoArguments,
    "goto": GotoRequest,
    "jog": JogRequest,
    "home": NoArguments,
    "zero": NoArguments,
    "lamp": LampRequest,
    "camera": CameraRequest,
    "preview": PreviewRequest,
    "control": ControlRequest,
    "expose": NoArguments,
    "prescan": PrescanRequest,
    "jog_hold": JogHoldRequest,
    "estimate": ScanRequest,
    "capture": CaptureRequest,
    "specimen": SpecimenRequest,
    "acknowledge": AcknowledgeRequest,
    "shutdown": NoArguments,
}

R = TypeVar("R", bound=msgspec.Struct)


def parse_request(name: str, args: dict[str, Any]) -> msgspec.Struct:
    """The typed arguments of a command.

    Raises:
        CommandRefusedError: an unknown command (with the nearest one), an unknown argument, or a value out of bounds.
    """
    struct = REQUESTS.get(name)
    if struct is None:
        near = difflib.get_close_matches(name, REQUESTS, n=1, cutoff=0.0)
        raise CommandRefusedError(f"there is no command {name[:40]!r}; did you mean {near[0]!r}?")
    try:
        return msgspec.convert(args, struct, strict=True)
    except msgspec.ValidationError as error:
        raise CommandRefusedError(f"{name}: {_plainly(str(error))}") from None


_KINDS = {"float": "a number", "int": "a whole number", "str": "a text", "bool": "true or false", "array": "a list"}


def _plainly(complaint: str) -> str:
    """msgspec's words for a value that does not fit, for people: ``gain must be a number <= 48.0``."""
    found = re.fullmatch(r"Expected `(\w+)(?: \| null)?`(.*?)(?:, got `\w+`)? - at `\$\.(\w+)`", complaint)
    if found is None:
        return complaint
    kind, bound, field = found.groups()
    return f"{field} must be {_KINDS.get(kind, kind)}{bound}"
