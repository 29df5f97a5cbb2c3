"""The table of commands: for each name its arguments, its handler, and how a command is served."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Command, Status
from acquire.contract.permissions import PERMISSIONS, check_permission
from acquire.daemon.requests import (
    AcknowledgeRequest,
    Call,
    CameraRequest,
    CaptureRequest,
    ControlRequest,
    GotoRequest,
    JogHoldRequest,
    JogRequest,
    LampRequest,
    NoArguments,
    PrescanRequest,
    PreviewRequest,
    Result,
    ResumeScanRequest,
    ScanRequest,
    SpecimenRequest,
    parse_request,
)

from .activity_commands import ActivityCommands
from .control import Control
from .device_commands import DeviceCommands
from .scan_commands import ScanCommands
from .service_commands import ServiceCommands


@dataclass(frozen=True)
class CommandSpec:
    """One row: when the command is allowed stands in ``acquire.contract.permissions`` under the same name."""

    request: type[msgspec.Struct]
    """Type of its arguments."""
    handler: Callable[[Any, Call], Result]
    """Takes the arguments; returns the reply's result, or raises SweepscopeError."""
    checks_permission: bool = False
    """The handler asks the table of permissions itself."""


def command_table(
    scans: ScanCommands, devices: DeviceCommands, activities: ActivityCommands, service: ServiceCommands
) -> dict[str, CommandSpec]:
    """Every command of the daemon by its name."""
    return {
        "scan": CommandSpec(ScanRequest, scans.scan),
        "resume_scan": CommandSpec(ResumeScanRequest, scans.resume_scan),
        "estimate": CommandSpec(ScanRequest, scans.estimate),
        "pause": CommandSpec(NoArguments, scans.pause),
        "resume": CommandSpec(NoArguments, scans.resume),
        "stop": CommandSpec(NoArguments, scans.stop),
        "goto": CommandSpec(GotoRequest, devices.goto),
        "jog": CommandSpec(JogRequest, devices.jog),
        "home": CommandSpec(NoArguments, devices.home),
        "zero": CommandSpec(NoArguments, devices.zero),
        "lamp": CommandSpec(LampRequest, devices.lamp),
        "camera": CommandSpec(CameraRequest, devices.camera),
        "preview": CommandSpec(PreviewRequest, devices.preview),
        "jog_hold": CommandSpec(JogHoldRequest, activities.jog_hold, checks_permission=True),
        "expose": CommandSpec(NoArguments, activities.expose),
        "prescan": CommandSpec(PrescanRequest, activities.prescan),
        "capture": CommandSpec(CaptureRequest, activities.capture),
        "specimen": CommandSpec(SpecimenRequest, activities.specimen),
        "control": CommandSpec(ControlRequest, service.control),
        "status": CommandSpec(NoArguments, service.status),
        "acknowledge": CommandSpec(AcknowledgeRequest, service.acknowledge),
        "shutdown": CommandSpec(NoArguments, service.shutdown),
    }


class CommandDispatcher:
    """Serves commands: control, arguments, permission, handler, in this order."""

    def __init__(
        self, table: Mapping[str, CommandSpec], control: Control, current_status: Callable[[int], Status]
    ) -> None:
        """``current_status`` makes the status message of a moment (ns), by which a command is allowed or refused."""
        self._table, self._control, self._current_status = table, control, current_status

    def serve(self, command: Command, now_ns: int) -> Result:
        """Do a command; returns what its reply contains.

        Raises:
            SweepscopeError: refused; the text says why and what to do.
        """
        self._control.hear(command.name, command.client, now_ns)
        spec = self._table.get(command.name)
        if spec is None:
            near = difflib.get_close_matches(command.name, self._table, n=1, cutoff=0.0)
            raise CommandRefusedError(f"there is no command {command.name[:40]!r}; did you mean {near[0]!r}?")
        request = parse_request(command.name, spec.request, command.args)
        # a STOP must not fail because the status cannot be made
        if not (spec.checks_permission or PERMISSIONS[command.name].always):
            check_permission(command.name, self._current_status(now_ns))
        return spec.handler(request, Call(command.client, now_ns))
