"""Answers of the writer: the scan file is ready; a frame, or the file, is refused."""

from __future__ import annotations

from acquire.contract.states import Outcome

from .actions import Action, RaiseFault, Say, SetLamp, Snap
from .events import Refused, WriterReady
from .finish import abandon, give_up
from .phases import Decision, Phase
from .sweep_state import SweepState


def writer_ready(sweep: SweepState, event: WriterReady, now_ns: int) -> list[Action]:
    """The first writer has created the file: take the ambient frame, light the lamp. A later one is reported."""
    sweep.window.commit(event.committed)
    if not sweep.has_writer and sweep.phase is Phase.SEAL:
        sweep.deadline_ns = now_ns + sweep.settings.seal_ns
    sweep.has_writer = True
    if sweep.phase is not Phase.WAIT_WRITER:
        return [Say("the writer is back: frames without an ack are sent again")] if event.came_back else []
    actions: list[Action] = []
    if not event.reserved:
        actions = [Say("this file system cannot reserve space: watch the disk")]
    settings = sweep.settings
    if settings.resume is not None:
        sweep.retakes.taken |= sweep.window.committed.keys()
    elif settings.dark_frames:
        sweep.go(Decision.TAKE_AMBIENT, now_ns, settings.exposure_ns + settings.frame_timeout_ns)
        return [*actions, SetLamp(on=False), Snap()]
    return actions + sweep.light_lamp(now_ns)


def refused(sweep: SweepState, event: Refused, now_ns: int) -> list[Action]:
    """The writer refused a frame or the file.

    A full or failing disk (F06, F07) is a fault but does not end the sweep: ``FrameSender`` sends the frame again every
    second, and the stage holds because its credit does not grow. A refusal that cannot be cured ends the sweep.
    """
    nack = event.nack
    detail = f"{nack.reason}: {nack.detail}" if nack.detail else nack.reason
    fault = sweep.fault("F06" if nack.reason == "no space" else "F07", detail=detail)
    if sweep.phase is Phase.WAIT_WRITER:
        return abandon(sweep, Outcome.FAILED, detail, fault, now_ns)
    if event.is_final:
        sweep.window.refuse(nack.role, nack.frame_index)
        # without this frame the committed prefix, and so the credit, would never grow again; a check frame may be in
        # the file from before an interruption
        return give_up(sweep, Outcome.FAILED, "F07", detail, now_ns) if nack.role == "sweep" else []
    if nack.reason in ("crc", "shape"):
        # damaged on its way; it is sent again
        detail = f"on its way to the writer: {detail}"
        return [RaiseFault(sweep.fault("F19", frame=nack.frame_index, attempts=1, detail=detail))]
    # the last three happen while a writer starts or ends
    return [] if nack.reason in ("no such scan", "busy", "superseded") else [RaiseFault(fault)]
