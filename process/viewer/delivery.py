"""Owns the couriers: one for each browser that is connected; says what each was sent and who cannot keep up."""

from __future__ import annotations

from dataclasses import dataclass

from .cloud import Cloud
from .courier import Courier
from .door import Page
from .wire import BrowserLink, Meter

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
        self._cloud = cloud
        self._couriers: dict[int, tuple[Courier, Meter]] = {}

    @property
    def pending(self) -> bool:
        """True while some browser lacks something."""
        return any(courier.refined(self._cloud) < 1.0 for courier, _ in self._couriers.values())

    def turn(self, now_ns: int) -> int:
        """One step for each browser whose last one has arrived; returns the bytes of points and colours."""
        clients = self._page.get_clients()
        for gone in set(self._couriers) - set(clients):
            del self._couriers[gone]
        for client_id in set(clients) - set(self._couriers):
            meter = self._page.meter_of(client_id)
            if meter is not None:
                self._couriers[client_id] = Courier(BrowserLink(clients[client_id], meter)), meter
        return sum(courier.turn(self._cloud, now_ns) for courier, _ in self._couriers.values())

    def news(self) -> list[LinkNews]:
        """One line for each browser."""
        return [
            LinkNews(client_id, meter.recent_bytes_per_s(), meter.rate_bytes_per_s, courier.refined(self._cloud))
            for client_id, (courier, meter) in sorted(self._couriers.items())
        ]
