"""Which browser may move the rig: any while no client holds control, else its holder alone. Pure."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field

from acquire.contract.messaging.messages import Status
from acquire.contract.permissions import needs_control
from acquire.contract.units import NS_PER_S

RENEW_NS = 3 * NS_PER_S
"""Control lapses 10 s after its holder's last command; a browser that is connected keeps it."""


@dataclass
class BrowserControl:
    """The names under which this page's browsers are known to the daemon."""

    page: str = field(default_factory=lambda: secrets.token_hex(2))
    """Tells pages apart, so that a restarted one does not inherit what another's browser held."""
    renewed_ns: int = 0

    def name(self, client_id: int) -> str:
        """The browser's name, for people and for the daemon."""
        return f"browser {client_id + 1} ({self.page})"

    def refusal(self, status: Status | None, client_id: int, command: str) -> str:
        """Why this browser may not give this command, because another client holds control; empty if it may."""
        holder = status.control if status is not None else ""
        if not needs_control(command) or holder in ("", self.name(client_id)):
            return ""
        return f"{holder} holds control; this browser only looks. Take control first. Stop always works."

    def renewal(self, status: Status | None, client_ids: list[int], now_ns: int) -> int | None:
        """The connected browser whose control is to be renewed now; None if there is none."""
        if status is None or now_ns - self.renewed_ns < RENEW_NS:
            return None
        for client_id in client_ids:
            if status.control == self.name(client_id):
                self.renewed_ns = now_ns
                return client_id
        return None
