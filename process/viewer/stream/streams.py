"""Owns the couriers: one for each browser that is connected; says what each was sent and who cannot keep up."""

from __future__ import annotations

from dataclasses import dataclass

from process.viewer.server.connection import BrowserLink
from process.viewer.server.guarded_server import Page

from .browser_stream import Courier
from .point_nodes import Cloud

SLOW_BYTES_PER_S = 400_000.0
"""A link that carries less than this is called slow."""


@dataclass(frozen=True)
class LinkNews:
    """What the page says about one browser's link."""

    client_id: int
    bytes_per_s: float
    """Sent over the last two seconds."""
    rate_bytes_per_s: float
    """What the link carries, as far as it was seen."""
    refined: float
    """Share of the cloud that it has in full, 0..1."""

    @property
    def slow(self) -> bool:
        """True if it gets overviews because it cannot keep up."""
        return self.rate_bytes_per_s < SLOW_BYTES_PER_S and self.refined < 1.0


class Delivery:
    """Lets every courier take its turn. One thread calls everything."""

    def __init__(self, page: Page, cloud: Cloud) -> None:
        self._page = page
        self.cloud = cloud
        self._couriers: dict[int, tuple[Courier, BrowserLink]] = {}
        self._posted: set[int] = set()

    @property
    def pending(self) -> bool:
        """True while some browser lacks something, points or a file."""
        return any(link.posting or courier.refined(self.cloud) < 1.0 for courier, link in self._couriers.values())

    def turn(self, now_ns: int) -> int:
        """One step for each browser whose last one has arrived; returns the bytes of points and colours."""
        clients = self._page.get_clients()
        for gone in set(self._couriers) - set(clients):
            del self._couriers[gone]
        for client_id in set(clients) - set(self._couriers):
            meter = self._page.meter_of(client_id)
            if meter is not None:
                link = BrowserLink(clients[client_id], meter)
                self._couriers[client_id] = Courier(link), link
        return sum(self._serve(client_id, now_ns) for client_id in self._couriers)

    def post(self, client_id: int, filename: str, content: bytes) -> bool:
        """Let one browser save a file; False if it is gone."""
        known = self._couriers.get(client_id)
        if known is None:
            return False
        known[1].post(filename, content)
        return True

    def _serve(self, client_id: int, now_ns: int) -> int:
        """Points and parts of files take turns."""
        courier, link = self._couriers[client_id]
        if link.idle() and client_id not in self._posted and link.post_part():
            self._posted.add(client_id)
            return 0
        self._posted.discard(client_id)
        return courier.turn(self.cloud, now_ns)

    def news(self) -> list[LinkNews]:
        """One line for each browser."""
        return [
            LinkNews(client_id, link.meter.recent_bytes_per_s(), link.rate_bytes_per_s, courier.refined(self.cloud))
            for client_id, (courier, link) in sorted(self._couriers.items())
        ]
