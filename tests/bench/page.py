"""Measures what the page sends: 2 million points to one browser, or a demonstration sweep from its first second on.

The browser reads and draws nothing.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import parse_qs, urlsplit

from tests.fakes.fake_results import hill_tiles
from tests.fakes.processes.viewer_process import request
from tests.system.viewer.test_connection import Browser, serving
from tui.processes.supervisor import own_command

TILES_AT_ONCE = 24
GIVE_UP_S = 120.0
LINK_BYTES_PER_S = (16e6, 1e6)


def bench_points(bound_bytes_per_s: float) -> str:
    """Seconds to an overview and to all of 2 million points, at a bound on the bytes per second."""
    tiles = hill_tiles(16, 12, 102)
    total = sum(header.count for header, _ in tiles)
    run = Path(tempfile.mkdtemp(prefix="ss-"))
    run.chmod(0o700)
    with serving(run, **{"viewer.max_bytes_per_s": bound_bytes_per_s}) as (viewer, rig):
        for start in range(0, len(tiles), TILES_AT_ONCE):
            rig.publish_tiles(tiles[start : start + TILES_AT_ONCE], folded_through=start)
            time.sleep(0.3)
        time.sleep(3.0)
        browser, begin, overview = Browser(viewer), time.monotonic(), 0.0
        while sum(browser.points.values()) < 0.999 * total and time.monotonic() - begin < GIVE_UP_S:
            read(browser)
            if not overview and len(browser.points) == len(tiles):
                overview, points = time.monotonic() - begin, sum(browser.points.values())
        took = time.monotonic() - begin
        browser.close()
    return (
        f"bound {bound_bytes_per_s / 1e6:g} MB/s: overview of {points:,} points after {overview:.1f} s, "
        f"all {total:,} after {took:.1f} s, {browser.received_bytes / 1e6:.1f} MB"
    )


def bench_demo() -> None:
    """Bytes of each second of a demonstration, and when the first points came."""
    begin = time.monotonic()
    process = subprocess.Popen(own_command("demo"), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    found: list[str] = []
    threading.Thread(target=_follow, args=(process.stdout, found), daemon=True).start()
    while not found and process.poll() is None:
        time.sleep(0.02)
    browser = Browser(_viewer_at(found[0]))
    print(f"page after {time.monotonic() - begin:.1f} s")
    first, seconds, before = 0.0, 0, 0
    while process.poll() is None:
        if not read(browser):
            break
        now = time.monotonic() - begin
        if browser.points and not first:
            first = now
            print(f"first points after {first:.1f} s")
        if int(now) > seconds:
            seconds = int(now)
            print(f"{seconds:4d} s {(browser.received_bytes - before) / 1e3:7.0f} kB")
            before = browser.received_bytes
    print(f"{browser.received_bytes / 1e6:.1f} MB for {sum(browser.points.values()):,} points")
    process.wait(GIVE_UP_S)


def read(browser: Browser) -> bool:
    """Take one message, if one comes within a second; False if the page is gone."""
    import websockets.exceptions

    try:
        browser._take(browser._socket.recv(timeout=1.0))
    except TimeoutError:
        return True
    except websockets.exceptions.ConnectionClosed:
        return False
    return True


def _follow(lines: Any, found: list[str]) -> None:
    for line in lines:
        address = re.search(r"http://\S+token=\S+", line)
        if address:
            found.append(address.group(0))


def _viewer_at(url: str) -> Any:
    port, token = urlsplit(url).port or 0, parse_qs(urlsplit(url).query)["token"][0]
    _, headers = request(port, f"/?token={token}")
    return SimpleNamespace(port=port, cookie=lambda: headers["set-cookie"].partition(";")[0])
