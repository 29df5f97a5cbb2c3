"""The table of faults: what happened, what is safe, what to do, as the operator reads it."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec.structs import replace

from acquire.contract.messaging.messages import FaultReport


@dataclass(frozen=True)
class Fault:
    """One row of the table; the texts are templates filled by :func:`report`."""

    code: str
    happened: str
    safe: str
    to_do: str


_KEPT = "{committed} of {expected} frames are saved"
_ROWS = (
    Fault("F01", "the rig daemon ended in mid-sweep", _KEPT, "start it again, then resume the scan"),
    Fault("F02", "the rig daemon was frozen for {seconds} s", _KEPT, "nothing: the sweep goes on; look at the load"),
    Fault("F03", "the writer is lost", _KEPT + "; no frame is triggered meanwhile", "nothing: it is being restarted"),
    Fault(
        "F04", "the disk is slower than the camera", "the stage waits, nothing is lost", "nothing, or lower the rate"
    ),
    Fault("F05", "no writer made the scan file ready in {seconds} s", "the stage has not moved", "start the writer"),
    Fault(
        "F06",
        "the disk is full: {detail}",
        _KEPT,
        "make room: the sweep then goes on by itself; storage.data_dir moves the next one",
    ),
    Fault(
        "F07",
        "the scan folder cannot be written: {detail}",
        _KEPT,
        "repair the disk: the sweep then goes on; stop it if the file is gone",
    ),
    Fault("F08", "the worker is away", _KEPT + "; the sweep goes on", "nothing: it catches up from the file"),
    Fault("F09", "a viewer or console is slow", "the sweep does not notice", "nothing"),
    Fault("F10", "a console or viewer went away", "the sweep goes on", "open it again"),
    Fault("F11", "noise on the serial line: {detail}", "damaged blocks are resent", "check cable and ground"),
    Fault(
        "F12",
        "the stage's controller is gone: {detail}",
        _KEPT + "; the stage holds",
        "plug it in again; if the sweep has ended, resume the scan",
    ),
    Fault(
        "F13", "the stage's controller was reset", _KEPT + "; its position is not trusted", "home, then resume the scan"
    ),
    Fault("F14", "another firmware: {detail}", "nothing has moved", "flash the firmware of this version"),
    Fault(
        "F15",
        "the host was too late for the stage",
        _KEPT + "; the stage holds",
        "nothing: it goes on; look at the load, and if the sweep has ended, resume the scan",
    ),
    Fault(
        "F16",
        "frame {frame} was lost {attempts} times",
        _KEPT,
        "check the trigger cable and the camera, then start again",
    ),
    Fault("F17", "the camera sent {count} frames that nobody triggered", "they are dropped", "check the trigger cable"),
    Fault(
        "F18",
        "the camera went away: {detail}",
        _KEPT + "; the stage holds",
        "plug it in if it is out: frames are then re-taken; if the sweep has ended, resume the scan",
    ),
    Fault("F19", "frame {frame} was damaged {attempts} times: {detail}", _KEPT, "check the camera and its cable"),
    Fault(
        "F20",
        "{count} messages could not be read and were dropped",
        "the sweep goes on",
        "nothing, unless it goes on: look for a service of another version",
    ),
    Fault("F21", "the calibration cannot be used: {detail}", "nothing has moved", "calibrate, or name another"),
    Fault("F22", "the clock jumped by {seconds} s", "the sweep goes by the monotonic clock", "nothing"),
    Fault(
        "F23",
        "limit switch or emergency stop: {detail}",
        _KEPT + "; the stage stands",
        "clear it, home, start a new scan",
    ),
    Fault("F24", "the service was told to stop", _KEPT, "start it again; this scan is closed, begin a new one"),
    Fault("F25", "everything ended at once", _KEPT, "nothing: scans are checked at the next start; then resume"),
    Fault("F26", "a second {detail} was started", "the first one goes on", "stop one of them"),
    Fault(
        "F27",
        "the light changed: {detail}",
        _KEPT + "; frames since then are marked",
        "look at lamp and room; resume accepts the light, or stop",
    ),
)
FAULTS: dict[str, Fault] = {row.code: row for row in _ROWS}


def report(code: str, at_mono_ns: int = 0, **facts: object) -> FaultReport:
    """The row ``code`` filled with facts; a fact that is not known stays visible as ``?``."""
    row = FAULTS[code]
    known = _Facts({name: str(value) for name, value in facts.items()})
    return FaultReport(
        code=code,
        happened=row.happened.format_map(known),
        safe=row.safe.format_map(known),
        to_do=row.to_do.format_map(known),
        at_mono_ns=at_mono_ns,
    )


def headline(fault: FaultReport) -> str:
    """``F03 the writer is lost (20261130T101500Z-stapes)``: what happened, and in which scan."""
    return f"{fault.code} {fault.happened}" + (f" ({fault.scan})" if fault.scan else "")


def in_one_line(fault: FaultReport) -> str:
    """``F03 the writer is lost: 412 of 527 frames are saved; it is being restarted``."""
    return f"{fault.code} {fault.happened}: {fault.safe}; {fault.to_do}"


def unfinished(scan: str, committed: int, expected: int) -> FaultReport:
    """The report of a daemon that finds at its start that the last sweep was interrupted."""
    found = report("F01", committed=committed, expected=expected)
    return replace(
        found,
        happened="the last sweep was interrupted",
        to_do="resume it: screen 4, r in the console, or 'sweepscope resume SCAN'",
        scan=scan,
    )


class _Facts(dict[str, str]):
    def __missing__(self, key: str) -> str:
        return "?"
