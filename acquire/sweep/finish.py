"""The end of a sweep: early or after its last frame, with a message that accounts for every frame.

A sweep of which a frame is missing never ends as complete. A sweep ends also when no writer answers.
"""

from __future__ import annotations

import msgspec
import numpy as np

from acquire.contract.frame_ranges import ranges_of
from acquire.contract.messaging.messages import End, FaultReport
from acquire.contract.scan_data.checksums import scan_digest
from acquire.contract.states import Outcome
from acquire.contract.units import NS_PER_S

from .actions import Action, Disarm, RaiseFault, SendEnd, StopStage
from .events import Sealed
from .phases import BEFORE_MOTION, STAGE_PHASES, Decision, Phase
from .sweep_state import SweepState


def give_up(sweep: SweepState, outcome: Outcome, code: str, detail: str, now_ns: int) -> list[Action]:
    """A fault ends the sweep."""
    fault = RaiseFault(sweep.fault(code, detail=detail))
    return [fault, *end_early(sweep, outcome, f"{code} {detail}", now_ns)]


def end_early(sweep: SweepState, outcome: Outcome, reason: str, now_ns: int) -> list[Action]:
    """Stop the stage and end with what was taken; the rest is missing.

    Only the first call decides the outcome; the writer can still turn it into INTERRUPTED.
    """
    if sweep.is_decided or sweep.phase not in BEFORE_MOTION | STAGE_PHASES:
        return []
    sweep.paused = sweep.window.short = False
    if sweep.phase in (Phase.REPEAT, Phase.LIMIT) and outcome is Outcome.STOPPED:
        sweep.skip_checks = True  # all frames are there: only the checks end early
    else:
        sweep.outcome, sweep.reason = outcome, reason
    return sweep.stop_stage(Decision.END_EARLY, now_ns)


def drain(sweep: SweepState, now_ns: int) -> None:
    """The stage has no more to do: wait until every frame that was taken is committed."""
    sweep.go(Decision.DRAIN, now_ns, sweep.settings.seal_ns)


def seal_if_settled(sweep: SweepState, now_ns: int) -> list[Action]:
    """Send the end message when every frame that was taken is committed."""
    if not sweep.intake.is_settled:
        return []
    # without any writer yet, wait as long as at the start
    wait_ns = sweep.settings.seal_ns if sweep.has_writer else sweep.settings.writer_start_ns
    sweep.go(Decision.SEAL, now_ns, wait_ns)
    if not sweep.is_decided:
        sweep.outcome = Outcome.COMPLETE if sweep.window.prefix == sweep.count else Outcome.FAILED
    return [SendEnd(_end_message(sweep))]


def sealed(sweep: SweepState, event: Sealed, now_ns: int) -> list[Action]:
    """The writer answered the end message; where it could not seal, the scan can be recovered and resumed."""
    if sweep.phase is not Phase.SEAL:
        return []
    end_ack = sweep.end_ack = event.end_ack
    sweep.go(Decision.CLOSE, now_ns, None)
    # the writer has verified every checksum by now
    sweep.window.revoke(end_ack.missing)
    if sweep.outcome is Outcome.INTERRUPTED or end_ack.sealed:
        return []
    sweep.outcome, sweep.reason = Outcome.INTERRUPTED, end_ack.reason
    fault = sweep.fault("F07", detail=end_ack.reason)
    return [RaiseFault(msgspec.structs.replace(fault, to_do="repair the disk, then resume the scan"))]


def writer_is_late(sweep: SweepState, now_ns: int) -> list[Action]:
    """The writer did not create the file, commit or seal in time."""
    if not sweep.has_writer and sweep.phase is not Phase.DRAIN:
        fault = sweep.fault("F05", seconds=f"{sweep.settings.writer_start_ns / NS_PER_S:g}")
        return abandon(sweep, Outcome.FAILED, "no writer created the scan file", fault, now_ns)
    reason = sweep.reason if sweep.outcome is Outcome.INTERRUPTED else "F03 the writer did not seal in time"
    return abandon(sweep, Outcome.INTERRUPTED, reason, sweep.fault("F03"), now_ns)


def abandon(sweep: SweepState, outcome: Outcome, reason: str, fault: FaultReport, now_ns: int) -> list[Action]:
    """End without a sealed file."""
    sweep.outcome, sweep.reason = outcome, reason
    sweep.go(Decision.ABANDON, now_ns, None)
    return [StopStage(), Disarm(), RaiseFault(fault)]


def _end_message(sweep: SweepState) -> End:
    """The account of the sweep. An interrupted one is not sealed, so that it can be resumed."""
    count, committed = sweep.count, sweep.window.committed
    crc32 = np.zeros(count, np.uint32)
    for frame_index, value in committed.items():
        crc32[frame_index] = value
    return End(
        scan_uid=sweep.settings.scan_uid,
        outcome=sweep.outcome,
        reason="; ".join(filter(None, (sweep.reason, sweep.checks.light_note()))),
        expected=count,
        sent=len(sweep.retakes.taken),
        missing=ranges_of([k for k in range(count) if k not in committed]),
        retaken=ranges_of(sweep.retaken),
        digest=scan_digest(crc32),
        counters=sweep.counters,
        checks=dict(sweep.checks.measured),
    )
