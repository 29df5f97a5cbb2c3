"""One answer to "what may be done now": the daemon's, the console's, and the page's."""

from __future__ import annotations

from unittest.mock import MagicMock

import msgspec
import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Command, Status
from acquire.contract.permissions import PERMISSIONS, needs_control, refusal, why_not_offered
from acquire.contract.states import HoldReason, State
from acquire.daemon.commands.activity_commands import ActivityCommands
from acquire.daemon.commands.control import Control
from acquire.daemon.commands.table import CommandDispatcher, command_table
from acquire.daemon.requests import Call, JogHoldRequest, Result
from acquire.stages.protocol import StageStatus
from process.viewer.rig_client.control import BrowserControl
from process.viewer.status_text import allowed
from tui.console.state.scan_rules import COMMAND_OF, why_not

ARGUMENTS = {
    "resume_scan": {"path": "/nowhere"},
    "goto": {"position_steps": 10},
    "jog": {"steps": 1},
    "jog_hold": {"direction": 1},
    "lamp": {"on": True},
    "preview": {"on": True},
    "control": {"action": "take"},
}
STATUSES = [
    Status(state=state, hold_reason=hold_reason, activity=activity, position_trusted=trusted)
    for state in State
    for hold_reason in (["", *HoldReason] if state is State.HOLDING else [""])
    for activity in ("", "preview", "jog", "prescan", "exposure", "specimen", "capture")
    for trusted in (False, True)
]


def commands(statuses: list[Status]) -> CommandDispatcher:
    """The daemon's commands, which judge by the newest of these statuses and do nothing."""
    rig, parts = MagicMock(), MagicMock()
    rig.stage.status.return_value = StageStatus(0, False, "", False, 0)

    def newest(_now_ns: int) -> Status:
        return statuses[-1]

    def first_press(request: JogHoldRequest, call: Call) -> Result:
        return ActivityCommands(rig, parts.config, parts.runner, parts.lamp, newest).jog_hold(request, call)

    parts.activities.jog_hold = first_press
    return CommandDispatcher(
        command_table(parts.scans, parts.devices, parts.activities, parts.service), Control(), newest
    )


@pytest.mark.parametrize("command", PERMISSIONS)
def test_daemon_console_and_page_give_one_answer_for_each_state(command):
    actions = [command, *(action for action, other in COMMAND_OF.items() if other == command)]
    asked = Command(request_id="1", name=command, args=ARGUMENTS.get(command, {}))
    statuses: list[Status] = []
    daemon = commands(statuses)
    for status in STATUSES:
        statuses.append(status)
        offered = why_not_offered(command, status)
        try:
            daemon.serve(asked, 0)
            refused = ""
        except CommandRefusedError as error:
            refused = str(error).partition(": ")[2]
        if status.hold_reason == HoldReason.PAUSED and command == "pause":
            assert (refused, offered) == ("", "the sweep is paused already"), "done, but without effect"
        else:
            assert refused == offered
        assert {why_not(action, status) for action in actions} == {offered}
        assert allowed(status, live=True)[command] == (not offered)


def test_a_stop_is_done_even_if_the_state_of_the_rig_cannot_be_found():
    parts, broken = MagicMock(), MagicMock(side_effect=OSError("the stage does not answer"))
    daemon = CommandDispatcher(command_table(parts.scans, parts, parts, parts), Control(), broken)
    daemon.serve(Command(request_id="1", name="stop"), 0)
    parts.scans.stop.assert_called_once()
    with pytest.raises(OSError, match="does not answer"):
        daemon.serve(Command(request_id="2", name="home"), 0)


def test_the_table_has_every_command_of_the_daemon_and_no_other():
    parts = MagicMock()
    assert PERMISSIONS.keys() == command_table(parts, parts, parts, parts).keys()


RIGS = {
    State.IDLE: ({}, []),
    State.PREVIEW: ({}, [("preview", {"on": True})]),
    State.MOVING: ({"simulation__time_scale": 5.0}, [("goto", {"position_steps": 4000})]),
    State.HOMING: ({"simulation__time_scale": 5.0}, [("goto", {"position_steps": 100}), ("home", {})]),
    State.ARMED: ({"limits__writer_start_s": 60.0}, [("scan", {"purpose": "raw"})]),
}


@pytest.mark.parametrize("state", RIGS)
def test_the_daemon_refuses_what_the_table_refuses_in_its_words(start_rig, state):
    settings, commands = RIGS[state]
    rig = start_rig(**settings)
    for name, args in commands:
        rig.until(lambda now: now["state"] in ("idle", "preview"), "the rig rests")
        rig.ask(name, **args)
    status = msgspec.convert(rig.status(), Status)
    refused = {name: reason for name in PERMISSIONS if (reason := refusal(name, status))}
    for name, reason in refused.items():
        with pytest.raises(CommandRefusedError) as caught:
            rig.ask(name, **ARGUMENTS.get(name, {}))
        assert str(caught.value) == f"{name} was refused: cannot {PERMISSIONS[name].purpose}: {reason}"
    assert status.state == rig.status()["state"] == state and refused
    rig.ask("stop")


def test_only_commands_of_the_table_are_given_while_another_client_holds_control(start_rig):
    rig = start_rig()
    rig.ask_as("anna", "control", action="take")
    held = Status(state=State.IDLE, control="anna")
    free = {name for name in PERMISSIONS if not needs_control(name)}
    assert free == {"stop", "status", "estimate", "control"}
    for name in PERMISSIONS:
        lease = BrowserControl()
        assert bool(lease.refusal(held, 0, name)) == (name not in free)
        if name not in free:
            with pytest.raises(CommandRefusedError, match="anna holds control"):
                rig.ask_as("ben", name, **ARGUMENTS.get(name, {}))
    rig.ask_as("ben", "stop")
    rig.ask_as("ben", "status")
    rig.ask_as("ben", "estimate", purpose="raw")
