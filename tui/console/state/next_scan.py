"""The sweep that is being prepared on the scan screen; pure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from acquire.contract.config.model import RigConfig
from acquire.contract.messaging.messages import Proposal


@dataclass(frozen=True)
class NextScan:
    """Everything that can be set before a scan starts."""

    first_steps: int = 0
    """Position of frame 0 in microsteps."""
    last_steps: int = 1578
    """Position of the last frame in microsteps; below ``first_steps`` sweeps the other way."""
    steps_per_frame: int = 3
    mode: str = "step"
    """``step`` or ``fly``."""
    settle_ms: float = 5.0
    """Time between the end of a step and the trigger, in ms."""
    um_per_microstep: float = 3.175
    name: str = "sweep"
    specimen: str = ""
    operator: str = ""
    notes: str = ""
    tags: tuple[str, ...] = ()

    @classmethod
    def of_config(cls, rig: RigConfig, operator: str = "") -> NextScan:
        """The defaults of the configuration."""
        return cls(
            first_steps=rig.sweep.first_steps,
            last_steps=rig.sweep.last_steps,
            steps_per_frame=rig.sweep.steps_per_frame,
            mode=rig.sweep.mode,
            settle_ms=rig.stage.settle_ms,
            um_per_microstep=rig.stage.um_per_microstep,
            operator=operator,
        )

    @property
    def frames(self) -> int:
        """Number of frames, both ends included."""
        return abs(self.last_steps - self.first_steps) // max(1, self.steps_per_frame) + 1

    def um(self, steps: int) -> float:
        """A position or distance in um."""
        return steps * self.um_per_microstep

    def plan_args(self) -> dict[str, Any]:
        """The arguments of ``estimate`` and ``prescan`` that say where and how."""
        return {
            "first_steps": self.first_steps,
            "last_steps": self.last_steps,
            "steps_per_frame": self.steps_per_frame,
            "mode": self.mode,
            "settle_ms": self.settle_ms,
        }

    def scan_args(self) -> dict[str, Any]:
        """The arguments of ``scan``."""
        words = {"specimen": self.specimen, "operator": self.operator, "notes": self.notes}
        return {
            "name": self.name,
            **self.plan_args(),
            **{key: text for key, text in words.items() if text},
            **({"tags": list(self.tags)} if self.tags else {}),
            "purpose": "object",
        }

    def with_proposal(self, proposal: Proposal) -> NextScan:
        """The same with the bounds of a pre-scan."""
        return replace(self, first_steps=proposal.first_steps, last_steps=proposal.last_steps)
