"""How the console looks; after a wanted change: pytest tests/tui/test_snapshots.py --snapshot-update, and look."""

from __future__ import annotations

import msgspec
import pytest

from acquire.contract.messages import FaultReport
from acquire.contract.states import Outcome, State
from tests.fakes.fake_daemon import IDLE, PROGRESS, SWEEPING
from tests.fakes.fake_link import FakeLink
from tui.app import ConsoleApp
from tui.messages import LinkChanged, PageKnown, ProgressArrived, StatusArrived

SIZES = [(80, 24), (160, 50)]
URL = "http://127.0.0.1:8080/?token=Zsw-hPl2uiU7AXeLkp8znj7naotsP8bJM9rRWYchyW0"
FAULT = FaultReport(
    code="F03",
    happened="the writer is lost",
    safe="410 of 527 frames are saved; no frame is triggered meanwhile",
    to_do="nothing: it is being restarted",
    at_mono_ns=7,
)
HOLDING = msgspec.structs.replace(
    SWEEPING,
    state=State.HOLDING,
    hold_reason="no credit",
    credit=0,
    writer_alive=False,
    faults=[FAULT],
    message="F03 the writer is lost",
)
SAVED = msgspec.structs.replace(
    SWEEPING, state=State.IDLE, outcome=Outcome.COMPLETE, triggered=527, received=527, committed=527, durable=527,
    message="SAVED: 527 of 527 frames are safe",
)  # fmt: skip


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize(
    "states",
    [[IDLE, SWEEPING], [IDLE, SWEEPING, HOLDING], [IDLE, SWEEPING, SAVED]],
    ids=["sweeping", "holding", "saved"],
)
def test_the_rig_screen_looks_as_it_did(snap_compare, states, size):
    async def play(pilot):
        pilot.app.post_message(LinkChanged(True, "/run/sweepscope"))
        pilot.app.post_message(PageKnown(URL))
        for status in states:
            pilot.app.post_message(StatusArrived(status))
            await pilot.pause()
        pilot.app.post_message(ProgressArrived(PROGRESS))
        await pilot.pause()

    app = ConsoleApp(FakeLink, clock=lambda: "12:00:00")
    assert snap_compare(app, terminal_size=size, run_before=play)
