"""Texts for the operator: alarms, refusals and causes of a restart, by the firmware's codes."""

from __future__ import annotations

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.stages.protocol import Alarm

from .wire_format import Cmd, McuAlarm, Reset, Result

_ALARMS: dict[McuAlarm, tuple[str, str]] = {
    McuAlarm.NONE: ("F23", "the controller stopped by itself"),
    McuAlarm.ESTOP_PIN: ("F23", "the emergency stop was pressed"),
    McuAlarm.ESTOP_BYTE: ("F23", "an emergency stop was commanded"),
    McuAlarm.LIMIT: ("F23", "the stage ran into its limit switch"),
    McuAlarm.HOMING: ("F23", "the limit switch was not found where it must be"),
    McuAlarm.LATE_STEP: ("F15", "a step came too late"),
    McuAlarm.UNDERRUN: ("F15", "the controller was too late to plan the next step"),
    McuAlarm.TRIGGER_OVERRUN: ("F15", "triggers follow each other too fast"),
    McuAlarm.RUN_UP: ("F15", "the run-up was too short for the speed"),
}


def alarm_event(alarm: McuAlarm, position_steps: int) -> Alarm:
    """The event of a sticky alarm; after any of them the position is not trusted."""
    code, detail = _ALARMS[alarm]
    return Alarm(code, detail, position_steps, position_trusted=False)


def reset_words(cause: int) -> str:
    """Why the controller has restarted."""
    for flag, words in (
        (Reset.WATCHDOG, "its watchdog timer expired"),
        (Reset.BROWN_OUT, "its supply voltage dipped"),
        (Reset.POWER, "its power was switched"),
        (Reset.EXTERNAL, "its reset line was pulled"),
    ):
        if cause & flag:
            return f"the controller has restarted: {words}"
    return "the controller has restarted"


def refusal(result: Result, kind: Cmd, config: StageConfig) -> CommandRefusedError:
    """Why a command was refused."""
    travel = f"{config.travel_min_steps}..{config.travel_max_steps}"
    words = {
        Result.RANGE: f"it leaves the travel {travel} (with its run-up), or is faster than the stage can go",
        Result.STATE: "the stage is not ready for it",
        Result.UNTRUSTED: "the position is not trusted: home the stage, or zero it by hand",
        Result.ALARM: "an alarm stands: release what caused it, then home the stage",
        Result.UNKNOWN: "the firmware does not know it",
    }
    return CommandRefusedError(f"the stage refuses {kind.name.lower()}: {words.get(result, result.name)}")
