"""How the console looks. After a wanted change: pytest --snapshot-update on this file, and look at the pictures."""

from __future__ import annotations

import msgspec
import pytest

from acquire.contract.messaging.messages import FaultReport, Picture, Proposal
from acquire.contract.states import Outcome, State
from tests.fakes.fake_daemon import IDLE, PROGRESS, SWEEPING, wandering_disc
from tests.fakes.fake_link import FakeLink
from tui.console.app import ConsoleApp
from tui.console.link.messages import LinkChanged, PageKnown, PictureArrived, ProgressArrived, StatusArrived, Updates
from tui.console.link.rig_view import PictureView

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


PREVIEW = msgspec.structs.replace(
    IDLE, state=State.PREVIEW, activity="preview", lamp_on=True, lamp_warm_s=12.0, position_steps=1236,
    position_um=1236 * 3.175, camera={"exposure_ms": 30.0, "gain": 6.0, "brightness_percent": 0.0},
    proposal=Proposal(
        first_steps=120, last_steps=1410, exposure_ms=27.5, frames=431, seconds=30.0, nbytes=10**8, free_bytes=10**11,
        warnings=["lit in the first look"],
    ),
)  # fmt: skip
PICTURE = PictureView(
    Picture(
        shape=[192, 256], source_shape=[768, 1024], frame_index=412, position_steps=1236, exposure_ms=30.0,
        full_scale_share=0.013, low=9.0, high=255.0,
    ),
    wandering_disc(15),
)  # fmt: skip


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize(
    "states",
    [[IDLE, PREVIEW], [IDLE, SWEEPING], [IDLE, SWEEPING, HOLDING], [IDLE, SWEEPING, SAVED]],
    ids=["preview", "sweeping", "holding", "saved"],
)
def test_the_rig_screen_looks_as_it_did(snap_compare, states, size):
    async def play(pilot):
        first = [LinkChanged(True, "/run/sweepscope"), PageKnown(URL)]
        last = [ProgressArrived(PROGRESS), PictureArrived(PICTURE)]
        for updates in (first, *([StatusArrived(status)] for status in states), last):
            pilot.app.post_message(Updates(updates, lambda: None))
            await pilot.pause()

    app = ConsoleApp(FakeLink, clock=lambda: "12:00:00", now_s=lambda: 1000.0)
    assert snap_compare(app, terminal_size=size, run_before=play)
