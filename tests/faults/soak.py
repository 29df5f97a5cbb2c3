"""``make soak``: sweeps back to back with random faults for as long as asked; counts, and the memory of each process.

    python -m tests.faults.soak --minutes 60

The services live through the whole soak (kills have a campaign of their own), so that what grows is seen to grow.
"""

from __future__ import annotations

import argparse
import random
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fakes.bombs import hit
from tui.client.rig_client import RigClient

from .harness import FRAME_BYTES, Rig, a_rig, assert_promise

SERVICES = ("daemon", "writer", "worker")
WARM_UP_SWEEPS = 20
"""Memory is taken for the first time after so many: caches and pools are filled by then."""
GROWTH_BYTES = 20_000_000
"""More than this between the first and the last measurement is called growth."""
WINDOW_BYTES = 40 * FRAME_BYTES


def _nothing(_rig: Rig, _client: RigClient) -> None:
    """Some sweeps are left in peace."""


def _freeze(service: str, longest_s: float) -> Callable[[Rig, RigClient], None]:
    def freeze(rig: Rig, _client: RigClient) -> None:
        rig.freeze(service, rig.random.random() * longest_s)

    return freeze


def _pause(rig: Rig, client: RigClient) -> None:
    if client.request("status").result["state"] == "sweeping":
        client.request("pause")
        rig.pause(0.2)
        client.request("resume")


def _visitors(rig: Rig, _client: RigClient) -> None:
    for _ in range(10):
        with RigClient(rig.run_dir, timeout_s=20) as visitor:
            visitor.request("status")


def _bombs(rig: Rig, _client: RigClient) -> None:
    hit(rig.run_dir, count=50, seed=rig.random.randrange(2**31))


FAULTS: dict[str, Callable[[Rig, RigClient], None]] = {
    "none": _nothing,
    "daemon frozen": _freeze("daemon", 1.0),
    "writer frozen": _freeze("writer", 1.0),
    "worker frozen": _freeze("worker", 2.0),
    "paused": _pause,
    "clients": _visitors,
    "bombs": _bombs,
}


def soak(minutes: float, seed: int) -> int:
    """Run; prints counts and memory. 0 if everything held and nothing grew."""
    end, counts, source = time.monotonic() + 60 * minutes, Counter[str](), random.Random(seed)
    first: dict[str, int] = {}
    course: list[dict[str, int]] = []
    began = time.monotonic()
    with a_rig(seed, at=0.4) as rig:
        rig.set(LIMITS__WINDOW_BYTES=WINDOW_BYTES)
        rig.start(*SERVICES)
        with rig.client() as client:
            while time.monotonic() < end:
                counts[_sweep(rig, client, source)] += 1
                if time.monotonic() - began > 6 * minutes * (len(course) + 1):
                    course.append({service: rig.rss(service) for service in SERVICES})
                if sum(counts.values()) == WARM_UP_SWEEPS:
                    first = {service: rig.rss(service) for service in SERVICES}
            last = {service: rig.rss(service) for service in SERVICES}
            for service in SERVICES:
                assert rig.end(service, signal.SIGTERM) == 0, f"{service} did not end well"
    print(f"seed {seed}, {minutes:g} minutes, {sum(counts.values())} sweeps complete and exact: {dict(counts)}")
    grew = False
    for service in SERVICES:
        before, after = first.get(service, last[service]), last[service]
        grew |= after - before > GROWTH_BYTES
        tenths = ", ".join(f"{sizes[service] / 1e6:.0f}" for sizes in course)
        print(f"{service} at each tenth of the time: {tenths} MB")
        print(f"{service}: {before / 1e6:.0f} MB after {WARM_UP_SWEEPS} sweeps, {after / 1e6:.0f} MB at the end")
    return int(grew)


def _sweep(rig: Rig, client: RigClient, source: random.Random) -> str:
    """One sweep with one fault; it must be complete and exact."""
    name = source.choice(list(FAULTS))
    scan = _begin(rig, client)
    rig.at = source.random() * 0.8
    rig.moment(client)
    FAULTS[name](rig, client)
    status = rig.finished(client, scan["scan_uid"])
    assert_promise(Path(scan["path"]), rig, "complete")
    assert status.outcome == "complete"
    report = Path(scan["path"]) / "report.json"
    rig.until(report.exists, "the worker's results")
    rig.seen.clear()
    shutil.rmtree(scan["path"], ignore_errors=True)
    return name


def _begin(rig: Rig, client: RigClient) -> dict[str, Any]:
    client.request("acknowledge")
    return rig.begin(client)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="make soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    return soak(options.minutes, options.seed)


if __name__ == "__main__":
    sys.exit(main())
