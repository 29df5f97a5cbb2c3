"""TCP ports of the gateway: one per socket, consecutive from the first."""

from __future__ import annotations

import re
from dataclasses import dataclass

from acquire.contract.errors import ConfigError

SPOKEN = ("status", "results", "preview")
"""Lanes on which the rig speaks; every key that is allowed may listen."""
ASKED = "command"
"""The lane on which the rig is asked; only keys that may steer are let in."""
OFFERED = (*SPOKEN, ASKED)
"""In the order of their ports. Frames and the live lane never leave the machine."""
_FORM = re.compile(r"^tcp://(?P<host>[^:/\[\]]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})$")


@dataclass(frozen=True)
class Address:
    """TCP address of a gateway."""

    host: str
    """Name or address; of IPv6 without brackets."""
    port: int
    """The first of ``len(OFFERED)`` ports."""

    def endpoint(self, lane: str) -> str:
        """ZeroMQ endpoint of one socket."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"tcp://{host}:{self.port + OFFERED.index(lane)}"

    def __str__(self) -> str:
        """In the form of ``--connect``."""
        return self.endpoint(OFFERED[0])


def parse_address(text: str) -> Address:
    """The address in ``tcp://host:port``.

    Raises:
        ConfigError: it has another form.
    """
    found = _FORM.match(text)
    if found is None or not 1 <= int(found["port"]) <= 65_536 - len(OFFERED):
        raise ConfigError(f"{text!r} is no address of a rig: write tcp://HOST:PORT, with the rig's network.port")
    return Address(found["host"].strip("[]"), int(found["port"]))
