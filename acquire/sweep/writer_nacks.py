"""What a writer's refusal means to the sweep: a thing of the moment, a fault, or the end of it. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from acquire.contract.messaging.messages import Nack

DAMAGED: Final = ("crc", "shape")
"""The frame was not what was sent; it is sent again."""
PASSING: Final = ("no such scan", "busy", "superseded")
"""What a writer says while it comes and goes."""
FOR_GOOD: Final = ("immutable", "protocol")
"""Sending the frame again would not change it."""


@dataclass(frozen=True)
class Refusal:
    """One refusal, understood."""

    code: str
    """The fault that it is; empty when there is none."""
    detail: str
    facts: dict[str, object] = field(default_factory=dict)
    """What else the fault's words need."""
    is_final: bool = False
    """The writer will never take the frame: it is not sent again."""
    ends_sweep: bool = False
    """A frame of the sweep can never be committed: it would block all that follow."""


def understand(nack: Nack, *, has_file: bool) -> Refusal:
    """Tell the kinds of refusals apart; where the file was never made (``has_file``) there is only one."""
    detail = f"{nack.reason}{': ' if nack.detail else ''}{nack.detail}"
    as_disk = Refusal("F06" if nack.reason == "no space" else "F07", detail)
    if not has_file:
        return as_disk
    if nack.reason in FOR_GOOD and nack.frame_index >= 0:
        # a check frame may be there from before an interruption
        ends_sweep = nack.role == "sweep"
        return Refusal("F07" if ends_sweep else "", detail, is_final=True, ends_sweep=ends_sweep)
    if nack.reason in DAMAGED:
        return Refusal("F19", f"on its way to the writer: {detail}", {"frame": nack.frame_index, "attempts": 1})
    return Refusal("", detail) if nack.reason in PASSING else as_disk
