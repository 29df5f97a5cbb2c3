"""What goes over the wire to each browser: a slow one keeps nobody waiting, and nobody gets more than the bound."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import viser
import websockets.exceptions
import websockets.sync.client
import zstandard

from tests.fakes.fake_results import FakeRig, hill_tiles
from tests.fakes.processes.viewer_process import ViewerProcess
from tests.system.viewer.test_access import camera_message
from tests.waiting import WALL_CLOCK_S, wait_for

TILES = hill_tiles(8, 6, 60)
POINTS = 8 * 6 * 60 * 60
POINT_BYTES = 15


class Browser:
    """As much of a browser as the wire sees; one that does not read is as slow as can be."""

    def __init__(self, viewer: ViewerProcess) -> None:
        self._socket = websockets.sync.client.connect(
            f"ws://127.0.0.1:{viewer.port}",
            origin=f"http://127.0.0.1:{viewer.port}",
            additional_headers={"Cookie": viewer.cookie()},
            subprotocols=[f"viser-v{viser.__version__}"],
            proxy=None,
            compression=None,
            max_size=None,
            max_queue=1,  # what was not asked for stays in the pipe
            ping_interval=None,
            close_timeout=0.1,
        )
        self._socket.send(msgspec.msgpack.encode(camera_message()))
        self.received_bytes = 0
        self.points: dict[str, int] = {}
        self.panel = ""

    def read_until(self, wanted: str) -> None:
        """Take messages until the panel says ``wanted`` (empty: until all points are there)."""

        def take_one() -> None:
            with contextlib.suppress(TimeoutError):
                self._take(self._socket.recv(timeout=1.0))

        wait_for(
            lambda: wanted in self.panel if wanted else sum(self.points.values()) == POINTS,
            wanted or f"{POINTS} points",
            pause=take_one,
            why=lambda: f"{sum(self.points.values())} points; {self.panel}",
        )

    def _take(self, raw: str | bytes) -> None:
        assert isinstance(raw, bytes)
        self.received_bytes += len(raw)
        packed = raw[16 : 16 + int.from_bytes(raw[8:16], "little")]
        inner = zstandard.ZstdDecompressor().decompress(packed, max_output_size=int.from_bytes(raw[:8], "little"))
        window = msgspec.msgpack.decode(inner)
        for message in window["messages"]:
            self._note(message, window["binaryBufferLengths"])

    def _note(self, message: dict[str, Any], lengths: list[int]) -> None:
        if message["type"] == "PointCloudMessage":
            index = message["props"]["points"]["__binary_index"]
            self.points[message["name"]] = lengths[index] // 12
        text = str(message.get("props", {}).get("content", "")) + str(message.get("updates", {}).get("content", ""))
        if "sw-state" in text:
            self.panel = text

    def close(self) -> None:
        """Hang up, and take what is left, so that the library's thread can end."""
        self._socket.socket.shutdown(socket.SHUT_RDWR)
        with contextlib.suppress(websockets.exceptions.ConnectionClosed):
            while True:
                self._socket.recv(timeout=WALL_CLOCK_S)


@contextlib.contextmanager
def serving(run_dir: Path, **overrides: object) -> Iterator[tuple[ViewerProcess, FakeRig]]:
    with ViewerProcess(run_dir, overrides) as viewer, FakeRig(run_dir) as rig:
        rig.set_status(state="sweeping")
        assert rig.subscribed.wait(WALL_CLOCK_S)
        yield viewer, rig


def test_a_browser_that_does_not_read_keeps_the_others_from_nothing_and_is_called_slow(run_dir: Path) -> None:
    with serving(run_dir) as (viewer, rig):
        hanging, reading = Browser(viewer), Browser(viewer)
        rig.publish_tiles(TILES, folded_through=300)
        reading.read_until("")
        reading.read_until("1 slow")
        rig.publish_tiles(TILES[:2], folded_through=301)
        reading.read_until('data-cloud-through="301"')
        assert reading.received_bytes < 3 * POINTS * POINT_BYTES, "what changed, not all again and again"
        for browser in (hanging, reading):
            browser.close()


@pytest.mark.parametrize("bound", [500_000.0])
def test_a_browser_never_gets_more_bytes_per_second_than_the_bound(run_dir: Path, bound: float) -> None:
    with serving(run_dir, **{"viewer.max_bytes_per_s": bound}) as (viewer, rig):
        rig.publish_tiles(TILES, folded_through=300)
        browser = Browser(viewer)
        begin = time.monotonic()
        browser.read_until("")
        took = time.monotonic() - begin
        assert browser.received_bytes > POINTS * POINT_BYTES
        # one second's worth may come at once; the last message and those before the camera's are not waited for
        assert took > (POINTS * POINT_BYTES - bound) / bound - 1.0
        browser.close()
