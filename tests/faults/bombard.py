"""A hundred thousand messages that nobody should send, to every socket that listens: counted, bounded, survived."""

from __future__ import annotations

from pathlib import Path

from tests.fakes.bombs import hit

from .harness import a_rig, assert_promise

BATCH = 2000
ALLOWED_GROWTH_BYTES = 100_000_000


def bombard(count: int, seed: int) -> str:
    """Send ``count`` bombs to the daemon's sockets, then take a scan; one line for the table.

    Raises:
        AssertionError: a service died, its memory grew, or the scan was not complete.
    """
    with a_rig(seed, at=0.5) as rig:
        rig.start("daemon", "writer")
        with rig.client() as client:
            scan = rig.begin(client)
            rig.finished(client, scan["scan_uid"])
            before = rig.rss("daemon")
            sent = {"command": 0, "frames": 0}
            for batch in range(0, count, BATCH):
                for lane, number in hit(rig.run_dir, count=min(BATCH, count - batch), seed=seed + batch).items():
                    if lane in sent:
                        sent[lane] += number
                assert client.request("status").ok
            grown = rig.rss("daemon") - before
            assert grown < ALLOWED_GROWTH_BYTES, f"the daemon grew by {grown} bytes"
            scan = rig.begin(client)
            status = rig.finished(client, scan["scan_uid"])
            assert_promise(Path(scan["path"]), rig, "complete")
    return (
        f"{sent['command']} hostile messages to the command socket and {sent['frames']} to the frames socket: "
        f"no crash, {status.counters['malformed']} counted on the frames lane, the daemon's memory changed by "
        f"{grown / 1e6:+.0f} MB, the scan afterwards complete and exact."
    )
