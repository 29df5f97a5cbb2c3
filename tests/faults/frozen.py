"""A writer that stands still for a minute in a sweep of large frames: how much memory does the daemon take?

python -m tests.faults.frozen --seconds 60
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path

from acquire.contract.messaging.lanes import LIVE_MARK
from acquire.writer.verify import verify

from .harness import Rig, a_rig

WIDTH, HEIGHT, BYTES_PER_PIXEL = 1024, 768, 3
FRAME_BYTES = WIDTH * HEIGHT * BYTES_PER_PIXEL
WINDOW_BYTES = 256_000_000
BESIDE_FRAMES = 16
"""Frames beside the window: exposures that wait in the simulated camera, and those kept for the checks."""
SLACK_BYTES = 32_000_000


def bound_bytes(window_frames: int, frame_bytes: int, live_subscribers: int) -> int:
    """By how much the daemon may grow: the window, what lossy subscribers have not taken yet, a handful of frames."""
    frames = window_frames + LIVE_MARK * live_subscribers + BESIDE_FRAMES
    return frames * frame_bytes + SLACK_BYTES


def freeze_writer(seconds: float, seed: int) -> str:
    """Freeze the writer in mid-sweep and measure; one line for the table.

    Raises:
        AssertionError: the daemon grew beyond the bound, or the scan is not complete and sound afterwards.
    """
    with a_rig(seed, at=0.1) as rig:
        rig.set(CAMERA__WIDTH=WIDTH, CAMERA__HEIGHT=HEIGHT, SWEEP__STEPS_PER_FRAME=6)
        rig.set(LIMITS__WINDOW_BYTES=WINDOW_BYTES, SIMULATION__TIME_SCALE=0.01, SWEEP__MAX_RATE_HZ=1000.0)
        rig.start("daemon", "writer")
        with rig.client() as client:
            scan = rig.begin(client)
            rig.until_status(client, lambda s: s.committed >= 5, "frames are committed")
            before = rig.rss("daemon")
            rig.send_signal("writer", signal.SIGSTOP)
            try:
                most = _watch(rig, "daemon", seconds)
                held = rig.until_status(client, lambda s: s.hold_reason == "no credit", "the stage holds")
            finally:
                rig.send_signal("writer", signal.SIGCONT)
            rig.deadline_s = 300
            status = rig.finished(client, scan["scan_uid"])
            assert verify(Path(scan["path"])).complete
    slots = WINDOW_BYTES // FRAME_BYTES
    bound = bound_bytes(slots, FRAME_BYTES, live_subscribers=0)
    assert held.triggered - held.committed <= slots == held.window
    assert most - before <= bound, f"the daemon grew by {most - before} bytes, {bound} are allowed"
    assert status.outcome == "complete" and status.missing == 0
    grown = most - before
    return (
        f"Writer frozen for {seconds:g} s in a sweep of {status.expected} frames of {FRAME_BYTES / 1e6:.2f} MB: the "
        f"daemon's memory went from {before / 1e6:.0f} to at most {most / 1e6:.0f} MB ({grown / 1e6:+.0f} MB; "
        f"bound (W + {LIVE_MARK} x subscribers + {BESIDE_FRAMES}) x frame + {SLACK_BYTES / 1e6:.0f} MB = "
        f"{bound / 1e6:.0f} MB with W = {slots}), and the scan was complete afterwards."
    )


def _watch(rig: Rig, service: str, seconds: float) -> int:
    most, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        most = max(most, rig.rss(service))
        rig.pause(0.2)
    return most


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="tests.faults.frozen", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(freeze_writer(options.seconds, options.seed))
    return 0


if __name__ == "__main__":
    sys.exit(main())
