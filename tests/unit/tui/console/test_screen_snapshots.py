"""How the screens look beside the scan screen; after a wanted change: --snapshot-update, and look at them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

import tui.scans.folder
from acquire.contract.faults import report
from acquire.contract.messaging.messages import Picture
from acquire.contract.states import State
from tests.fakes.fake_daemon import IDLE, PROGRESS, SWEEPING
from tests.fakes.fake_link import FakeLink
from tests.fakes.scans.small_scans import make_scan
from tests.fakes.scans.some_maps import live_maps
from tui.console.app import ConsoleApp
from tui.console.jobs import Job
from tui.console.link.messages import LinkChanged, MapsArrived, PictureArrived, ProgressArrived, StatusArrived, Updates
from tui.console.link.rig_view import PictureView
from tui.console.options import ConsoleOptions
from tui.console.screens import scans
from tui.console.state.fault_log import FaultLog
from tui.console.widgets import scan_rows
from tui.console.widgets.rows import RowList

SIZES = [(80, 24), (160, 50)]
FAULTS = [
    report("F03", 10**9, committed=410, expected=527),
    msgspec.structs.replace(report("F20", 2 * 10**9, count=3), acknowledged=True),
    report("F11", 3 * 10**9, detail="checksum of block 7"),
]


def hear(pilot, *updates) -> None:
    pilot.app.post_message(Updates(list(updates), lambda: None))


async def maps(pilot) -> None:
    hear(pilot, ProgressArrived(msgspec.structs.replace(PROGRESS, scan_uid="uid-1")), MapsArrived(live_maps()))
    await pilot.pause()


async def faults(pilot) -> None:
    hear(pilot, StatusArrived(msgspec.structs.replace(SWEEPING, faults=FAULTS)))
    await pilot.pause()


async def news(pilot) -> None:
    pilot.app.say("the lamp is 3 % dimmer than at the start", "warning")
    pilot.app.say("scan: the disk is full: 3.0 GB are needed", "error")
    await pilot.pause()


async def listed(pilot) -> None:
    for _ in range(500):
        if "incus" in pilot.app.rig_screen.query_one(RowList).plain:
            return
        await pilot.pause(0.02)
    raise AssertionError("the folder of scans was never listed")


async def board(pilot) -> None:
    hear(pilot, StatusArrived(msgspec.structs.replace(IDLE, state=State.PREVIEW, activity="preview")))
    await pilot.pause()
    y, x = np.mgrid[:96, :128]
    squares = (y // 8 + x // 8) % 2
    pixels = np.where((x > 12) & (x < 100) & (y > 12) & (y < 76), 40 + 170 * squares, 12).astype(np.uint8)
    header = Picture(shape=[96, 128], source_shape=[768, 1024], high=210.0, low=12.0)
    hear(pilot, PictureArrived(PictureView.of(header, pixels.tobytes())))
    corners = [[px / 127, py / 95] for px in range(16, 100, 8) for py in range(16, 76, 8)]
    views = [
        {"name": "view-01.png", "found": True, "words": "flat (2 degrees)"},
        {"name": "view-02.png", "found": True, "words": "right side higher by 14 degrees"},
        {"name": "view-03.png", "found": False, "words": "no chessboard found: is it sharp, lit and in the field?"},
    ]
    advice = ["tilt it the other way: left side higher", "move it: corner top right is empty", "6 more views"]
    live = {"found": True, "corners": corners, "words": "top side higher by 12 degrees: a new view, capture it"}
    facts = {"views": views, "coverage": [[2, 2, 1, 0], [2, 2, 2, 1], [1, 2, 2, 1]], "advice": advice, "live": live}
    pilot.app.jobs.on_result(facts)
    await pilot.pause()


PLAYS: dict[str, Callable[..., Awaitable[None]]] = {
    "reconstruct": maps,
    "calibrate": board,
    "scans": listed,
    "faults": faults,
    "log": news,
}


class NoJobs:
    """Starts none, and keeps the function that takes the results of the last one."""

    running = work = ()

    def start(self, *_, on_result=None, **__):
        self.on_result = on_result
        return Job("job", "subject")

    def cancel(self, job) -> None:
        """It never ran."""

    def running_on(self, subject) -> None:
        """Nothing does."""

    async def close(self) -> None:
        """There is nothing to close."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, frames, points in (("stapes-left", 8, 76_123), ("malleus", 5, 40_311), ("incus", 8, None)):
        make_scan(tmp_path / f"20260101T120000Z-{name}", frames, started_utc="", points=points, specimen="left ear")
    make_scan(tmp_path / "20260101T110000Z-cut", 3, seal=False, started_utc="")
    return tmp_path


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize("screen", list(PLAYS))
def test_the_screen_looks_as_it_did(snap_compare, screen, size, folder, monkeypatch):
    monkeypatch.setattr(scans, "_free", lambda _folder: "57.4 GB")
    for module in (scans, scan_rows, tui.scans.folder):  # how large a scan's file is, is not what this compares
        monkeypatch.setattr(module, "format_bytes", lambda _size: "1.2 GB")
    app = ConsoleApp(FakeLink, ConsoleOptions(screen=screen, data_dir=folder), clock=lambda: "12:00:00")
    app.state.faults = FaultLog(wall_time=lambda ns: f"2026-01-01 12:00:0{ns // 10**9}")
    app.jobs = NoJobs()  # type: ignore[assignment]

    async def play(pilot):
        hear(pilot, LinkChanged(True, "/run/sweepscope"), StatusArrived(SWEEPING))
        await pilot.pause()
        await PLAYS[screen](pilot)
        await pilot.pause()

    assert snap_compare(app, terminal_size=size, run_before=play)
