"""The rig's state in words and signs, the same on every screen and in every printed line; pure."""

from __future__ import annotations

from collections.abc import Sequence

from acquire.contract.faults import headline
from acquire.contract.messaging.messages import FaultReport, ResultProgress, Status
from acquire.contract.states import RUNNING_STATES, Outcome, State, outcome_words, sign_of
from acquire.contract.units import format_duration


def state_words(status: Status) -> str:
    """``HOLDING (paused)``."""
    held = f" ({status.hold_reason})" if status.hold_reason else ""
    return status.state.upper() + held


def is_running(status: Status | None) -> bool:
    """True while a sweep runs."""
    return status is not None and status.state in RUNNING_STATES


def position_words(status: Status) -> str:
    """``1 234.5 um   389 microsteps (trusted)``."""
    trust = "trusted" if status.position_trusted else "NOT TRUSTED: home first"
    return f"{status.position_um:,.1f} um  {status.position_steps} microsteps  {trust}".replace(",", " ")


def scan_name(status: Status) -> str:
    """Name of the running or last scan's folder; empty before the first."""
    return status.scan_path.rstrip("/").rpartition("/")[2]


def outcome_line(status: Status) -> str:
    """How the last scan ended; empty before the first, and until the daemon has closed the sealed file."""
    if status.outcome in ("", Outcome.RUNNING) or is_running(status):
        return ""
    words = outcome_words(status.outcome, status.committed, status.expected)
    if words.startswith("SAVED") and status.missing:
        return f"{status.outcome}: {status.committed} of {status.expected} frames are safe"
    return words


def fraction_done(status: Status) -> float:
    """Committed frames over expected ones, 0..1."""
    return min(1.0, status.committed / status.expected) if status.expected else 0.0


def bar(fraction: float, width: int) -> str:
    """A progress bar of ``width`` characters."""
    filled = round(max(0.0, min(1.0, fraction)) * width)
    return "█" * filled + "░" * (width - filled)


def rate_words(status: Status) -> str:
    """``14.8 frames/s  remaining 0:00:07``; no time is given while the sweep holds."""
    eta_s = status.eta_s if status.state == State.SWEEPING else None
    return f"{status.rate_hz:.1f} frames/s  remaining {format_duration(eta_s)}"


def credit_words(status: Status) -> str:
    """``credit 37 of 120 frames``."""
    writer = "" if status.writer_alive else "  no writer"
    return f"credit {status.credit} of {status.window} frames{writer}"


def newest_fault(faults: Sequence[FaultReport]) -> FaultReport | None:
    """The newest fault that is not acknowledged: the one that a banner shows."""
    waiting = [fault for fault in faults if not fault.acknowledged]
    return max(waiting, key=lambda fault: fault.at_mono_ns) if waiting else None


def progress_line(status: Status, progress: ResultProgress | None = None) -> str:
    """One line for a log: state, frames, rate, remaining time, and points once the worker has reported some."""
    percent = f"{100 * fraction_done(status):.0f} %"
    found = progress.points_settled + progress.points_provisional if progress else 0
    points = f"  {found} points" if found else ""
    rate = f"  {rate_words(status)}" if status.state == State.SWEEPING and status.rate_hz else ""
    return f"{state_words(status):<12} {status.committed}/{status.expected} frames  {percent:>5}{rate}{points}"


def status_lines(status: Status) -> list[str]:
    """The whole state, as `sweepscope status` prints it."""
    devices = f"{status.stage_kind or 'no'} stage, {status.camera_kind or 'no'} camera, lamp {_on(status.lamp_on)}"
    lines = [f"{sign_of(status.state).glyph} {state_words(status)}  {devices}", f"position  {position_words(status)}"]
    if status.activity:
        lines.append(f"doing     {status.activity}  {100 * status.activity_share:.0f} %")
    if status.control:
        lines.append(f"control   {status.control}")
    if status.proposal is not None:
        found = status.proposal
        ends = f"{found.first_steps} to {found.last_steps}, {found.frames} frames, {found.exposure_ms:.3g} ms"
        lines += [f"proposal  {ends}", *(f"warning   {warning}" for warning in found.warnings)]
    if status.scan_path:
        counts = (
            f"triggered {status.triggered}  received {status.received}  committed {status.committed}  "
            f"durable {status.durable}  retaken {status.retaken}  missing {status.missing}"
        )
        lines += [f"scan      {status.scan_path}", f"frames    {counts}  of {status.expected}"]
        lines += [outcome_line(status) or f"progress  {rate_words(status)}  {credit_words(status)}"]
    lines += [f"FAULT {headline(fault)}. Safe: {fault.safe}. To do: {fault.to_do}" for fault in status.faults]
    if status.message:
        lines.append(status.message)
    return lines


def _on(value: bool) -> str:
    return "on" if value else "off"
