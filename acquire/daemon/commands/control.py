"""Who holds control of the rig: at most one client, by name, and only as long as it is heard of. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from acquire.contract.errors import CommandRefusedError
from acquire.contract.permissions import needs_control
from acquire.contract.units import NS_PER_S

LAPSE_NS: Final = 10 * NS_PER_S
"""So long after its holder's last word control is free again."""


@dataclass
class Control:
    """Nobody holds it: any client may act. Somebody does: the others may look, ask, and stop."""

    _holder: str = ""
    _until_ns: int = 0

    def holder(self, now_ns: int) -> str:
        """The client that holds control now; empty: nobody."""
        return self._holder if now_ns < self._until_ns else ""

    def hear(self, command: str, client: str, now_ns: int) -> None:
        """A command came: the holder's own keeps control, a stranger's may be refused.

        Raises:
            CommandRefusedError: somebody else holds control; the text names who, and the way out.
        """
        holder = self.holder(now_ns)
        if holder and client == holder:
            self._until_ns = now_ns + LAPSE_NS
        elif holder and needs_control(command):
            raise CommandRefusedError(f"{holder} holds control: take it with 'control take'")

    def change(self, action: Literal["take", "renew", "release"], client: str, now_ns: int) -> None:
        """Take control (from whoever has it), keep it, or give it back.

        Raises:
            CommandRefusedError: a client without a name, or one that does not hold what it renews or gives back.
        """
        if not client:
            raise CommandRefusedError("control is held under a name, and a command has one at a terminal only")
        holder = self.holder(now_ns)
        if action != "take" and holder != client:
            who = f"{holder} holds control" if holder else "nobody holds control"
            raise CommandRefusedError(f"cannot {action} control: {who}; take it with 'control take'")
        self._holder = "" if action == "release" else client
        self._until_ns = now_ns + LAPSE_NS
