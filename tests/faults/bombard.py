"""A hundred thousand messages that nobody should send, to every socket that listens: counted, bounded, survived."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from tests.fakes.bombs import hit

from .harness import START_S, a_rig, assert_promise

SERVICES = ("daemon", "writer", "worker")
BATCH = 500
"""Bombs to each socket before the daemon is asked whether it still lives."""
ALLOWED_GROWTH_BYTES = 100_000_000


def bombard(count: int, seed: int) -> str:
    """Send ``count`` bombs, spread over every socket that listens, then take a scan; one line for the table.

    Raises:
        AssertionError: a service died, its memory grew, or the scan was not complete.
    """
    with a_rig(seed, at=0.5) as rig:
        rig.start(*SERVICES)
        with rig.client() as client:
            rig.until((rig.run_dir / "results.sock").exists, "the worker is up", START_S)
            scan = rig.begin(client)
            rig.finished(client, scan["scan_uid"])
            before = {service: rig.rss(service) for service in SERVICES}
            sent: Counter[str] = Counter()
            while sent.total() < count:
                sent.update(hit(rig.run_dir, count=BATCH, seed=seed + sent.total()))
                assert client.request("status").ok
            assert all(process.poll() is None for process in rig.processes.values()), "a service died"
            grown = {service: rig.rss(service) - before[service] for service in SERVICES}
            assert max(grown.values()) < ALLOWED_GROWTH_BYTES, f"memory grew: {grown}"
            scan = rig.begin(client)
            status = rig.finished(client, scan["scan_uid"])
            assert_promise(Path(scan["path"]), rig, "complete")
    lanes = ", ".join(f"{number} to the {lane} socket" for lane, number in sorted(sent.items()) if number)
    memory = ", ".join(f"{service} {size / 1e6:+.0f} MB" for service, size in grown.items())
    return (
        f"{sent.total()} hostile messages ({lanes}): no crash, {status.counters['malformed']} counted on the frames "
        f"lane; memory: {memory}; the scan afterwards complete and exact."
    )
