"""Which client holds control of the rig: at most one, by name, and only while it sends commands. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from acquire.contract.errors import CommandRefusedError
from acquire.contract.permissions import needs_control
from acquire.contract.units import NS_PER_S

LAPSE_NS: Final = 10 * NS_PER_S
"""Control is free again so long after the last command of its holder."""


@dataclass
class Control:
    """While no client holds it, any may act; while one does, the others may only watch, estimate, and stop."""

    _holder: str = ""
    _until_ns: int = 0

    def holder(self, now_ns: int) -> str:
        """The client that holds control now; empty: none."""
        return self._holder if now_ns < self._until_ns else ""

    def hear(self, command: str, client: str, now_ns: int) -> None:
        """A command has come: one of the holder renews control, one of another client may be refused.

        Raises:
            CommandRefusedError: another client holds control; the text names it, and says how to take over.
        """
        holder = self.holder(now_ns)
        if holder and client == holder:
            self._until_ns = now_ns + LAPSE_NS
        elif holder and needs_control(command):
            raise CommandRefusedError(f"{holder} holds control: take it with 'control take'")

    def change(self, action: Literal["take", "renew", "release"], client: str, now_ns: int) -> None:
        """Take control (also from another holder), renew it, or release it.

        Raises:
            CommandRefusedError: a client without a name, or one that does not hold what it renews or releases.
        """
        if not client:
            raise CommandRefusedError("control is held under a name, and a command has one at a terminal only")
        holder = self.holder(now_ns)
        if action != "take" and holder != client:
            who = f"{holder} holds control" if holder else "nobody holds control"
            raise CommandRefusedError(f"cannot {action} control: {who}; take it with 'control take'")
        self._holder = "" if action == "release" else client
        self._until_ns = now_ns + LAPSE_NS
