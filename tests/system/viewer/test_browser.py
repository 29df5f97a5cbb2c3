"""The page in a real browser: what an operator sees and clicks, and what a foreign page achieves."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from acquire.contract.faults import report
from tests.fakes.fake_results import PLAN, SCAN_UID, FakeRig, hill_tiles
from tests.fakes.processes.viewer_process import ViewerProcess
from tests.waiting import WALL_CLOCK_S, wait_for

ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--disable-component-update",
    "--disable-sync",
]
PICTURE = np.s_[190:610, 0:560]
"""Rows and columns of the screenshot that show the scene alone: no panel, no notices."""
SWEEPING = {
    "state": "sweeping",
    "position_trusted": True,
    "scan_uid": SCAN_UID,
    "scan_path": "/data/20260102T030405Z-frog",
    "plan": PLAN,
    "outcome": "running",
    "expected": PLAN.count,
    "committed": 260,
    "rate_hz": 14.9,
    "eta_s": 18.0,
    "writer_alive": True,
}

pytestmark = [pytest.mark.shares_processes, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ViewerProcess, Path]]:
    run = tmp_path_factory.mktemp("run")
    run.chmod(0o700)
    with ViewerProcess(run) as viewer:
        yield viewer, run


@pytest.fixture(scope="module")
def page(browser: Any, viewer: tuple[ViewerProcess, Path]) -> Iterator[Any]:
    page = browser.new_page(viewport={"width": 900, "height": 620})
    page.set_default_timeout(WALL_CLOCK_S * 1000)
    page.goto(viewer[0].url)
    page.wait_for_selector(".sw-state")
    yield page
    page.close()


def pixels(page: Any) -> tuple[int, int]:
    """Pixels of the scene in the colours of settled and of provisional points."""
    encoded = np.frombuffer(page.screenshot(), np.uint8)
    blue, green, red = np.moveaxis(cv2.imdecode(encoded, cv2.IMREAD_COLOR)[PICTURE].astype(int), 2, 0)
    settled = (red > 90) & (abs(red - green) < 25) & (abs(red - blue) < 25)
    provisional = (red > 150) & (red - blue > 60)
    return int(settled.sum()), int(provisional.sum())


def violet(page: Any) -> int:
    """Pixels of the scene in the colours of low ground."""
    encoded = np.frombuffer(page.screenshot(), np.uint8)
    blue, green, red = np.moveaxis(cv2.imdecode(encoded, cv2.IMREAD_COLOR)[PICTURE].astype(int), 2, 0)
    return int(((blue > green + 20) & (blue > 90) & (red > 40) & (red < 100)).sum())


def until_violet(page: Any) -> None:
    wait_for(
        lambda: violet(page) >= 2_500,
        "2500 pixels in the colours of low ground",
        pause=lambda: page.wait_for_timeout(200),
        why=lambda: violet(page),
    )


def open_tab(page: Any, name: str) -> None:
    page.get_by_role("tab", name=name).click()


def until_drawn(page: Any, settled_over: int, provisional_at_least: int = 0) -> tuple[int, int]:
    def enough() -> tuple[int, int] | None:
        seen = pixels(page)
        return seen if seen[0] > settled_over and seen[1] >= provisional_at_least else None

    found = wait_for(
        enough,
        f"{settled_over} settled and {provisional_at_least} provisional pixels",
        pause=lambda: page.wait_for_timeout(100),
        why=lambda: pixels(page),
    )
    assert found is not None
    return found


def test_the_cloud_grows_in_the_browser_and_provisional_points_look_provisional(
    page: Any, viewer: tuple[ViewerProcess, Path]
) -> None:
    assert "No rig daemon" in page.inner_text("body")
    with FakeRig(viewer[1]) as rig:
        rig.set_status(**SWEEPING)
        page.wait_for_selector('.sw[data-state="sweeping"][data-live="true"]')
        assert pixels(page)[0] < 500, "an empty scene shows nothing in the colours of points"
        rig.publish_tiles(hill_tiles(provisional_from=0.3)[:24], folded_through=258)
        page.wait_for_selector('.sw[data-folded-through="258"]')
        first, provisional = until_drawn(page, 2_500, 2_500)
        text = page.inner_text("body")
        for words in ("frog", "260 of 527", "259 of 527", "0:00:18 h:m:s", "14.9 frames/s"):
            assert words in text
        rig.publish_tiles(hill_tiles(), folded_through=526)
        grown, left = until_drawn(page, first * 5 // 4)
        assert grown > first
        assert left < provisional / 10, "settled points have lost the colour of provisional ones"


def test_a_click_on_start_reaches_the_daemon_and_its_words_and_faults_come_back(
    page: Any, viewer: tuple[ViewerProcess, Path]
) -> None:
    with FakeRig(viewer[1], refuse="<b>home the stage first</b>") as rig:
        rig.set_status(state="idle", position_trusted=True, faults=[report("F13", committed=412, expected=527)])
        page.wait_for_selector('.sw[data-state="idle"][data-live="true"]')
        page.locator('input[value="scan"]').fill("my frog")
        page.get_by_text("Start", exact=True).click()
        page.get_by_text("scan was refused: <b>home the stage first</b>").wait_for()
        assert [(command.name, command.args) for command in rig.commands] == [("scan", {"name": "my frog"})]
        text = page.inner_text("body")
        for words in ("F13", "Safe: 412 of 527 frames are saved", "To do: home, then resume"):
            assert words in text


def test_another_colour_changes_the_picture_and_survives_a_reload_and_a_second_browser_sees_it(
    browser: Any, page: Any, viewer: tuple[ViewerProcess, Path]
) -> None:
    with FakeRig(viewer[1]) as rig:
        rig.set_status(**SWEEPING)
        rig.publish_tiles(hill_tiles(), folded_through=526)
        page.wait_for_selector('.sw[data-folded-through="526"]')
        until_drawn(page, 10_000)
        assert violet(page) < 500
        open_tab(page, "View")
        page.locator('input[aria-haspopup="listbox"]:visible').first.click()
        page.get_by_role("option", name="Height").click()
        page.get_by_text("Height over z = 0").wait_for()
        until_violet(page)
        page.reload()
        until_violet(page)
        assert rig.commands == [], "to look is not to move"
        second = browser.new_page(viewport={"width": 420, "height": 300})
        second.set_default_timeout(WALL_CLOCK_S * 1000)
        second.goto(viewer[0].url)
        second.get_by_role("tab", name="View").click()
        second.get_by_text("Height over z = 0").wait_for()
        second.close()


def test_two_clicks_on_the_cloud_make_a_distance_and_a_click_beside_it_does_not(
    page: Any, viewer: tuple[ViewerProcess, Path]
) -> None:
    with FakeRig(viewer[1]) as rig:
        rig.set_status(**SWEEPING)
        rig.publish_tiles(hill_tiles(), folded_through=526)
        page.wait_for_selector('.sw[data-cloud-through="526"]')
        until_violet(page)
        open_tab(page, "Measure")
        page.locator('input[type="checkbox"]:visible').first.check()
        page.get_by_text("Click the first point.").wait_for()
        page.mouse.click(560, 600)
        page.get_by_text("No data here").first.wait_for()
        page.mouse.click(260, 330)
        page.get_by_text("Click the second point.").wait_for()
        page.get_by_text("quality: not known while it is live").wait_for()
        page.mouse.click(310, 370)
        page.get_by_text("horizontal").wait_for()
        page.get_by_text("Section 0").wait_for()
        page.get_by_text("Delete all").click()
        page.get_by_text("horizontal").wait_for(state="detached")


def test_a_browser_without_control_is_told_who_holds_it_and_its_stop_works_all_the_same(
    page: Any, viewer: tuple[ViewerProcess, Path]
) -> None:
    with FakeRig(viewer[1]) as rig:
        rig.set_status(state="idle", position_trusted=True, control="anna on pts/3")
        page.wait_for_selector('.sw[data-state="idle"][data-live="true"]')
        open_tab(page, "Rig")
        page.get_by_text("Start", exact=True).click()
        page.get_by_text("anna on pts/3 holds control; this browser only looks").first.wait_for()
        page.get_by_text("Stop", exact=True).click()
        assert rig.commanded.wait(WALL_CLOCK_S)
        assert [command.name for command in rig.commands] == ["stop"]
        assert rig.commands[0].client.startswith("browser ")


def test_a_foreign_page_in_the_same_browser_cannot_open_the_websocket(
    browser: Any, viewer: tuple[ViewerProcess, Path]
) -> None:
    knock = """url => new Promise(done => {
        const socket = new WebSocket(url, "viser-v1.1.1");
        socket.onopen = () => { socket.close(); done("open"); };
        socket.onerror = () => done("refused");
    })"""
    target = f"ws://127.0.0.1:{viewer[0].port}"
    context = browser.new_context()
    evil = http.server.HTTPServer(("127.0.0.1", 0), _Blank)
    thread = threading.Thread(target=evil.serve_forever)
    thread.start()
    try:
        own = context.new_page()
        own.goto(viewer[0].url)
        assert own.evaluate(knock, target) == "open"
        foreign = context.new_page()
        # the same site, so the browser does send the cookie: it is the Origin that must be refused
        foreign.goto(f"http://127.0.0.1:{evil.server_port}/")
        assert foreign.evaluate(knock, target) == "refused"
    finally:
        evil.shutdown()
        thread.join(5)
        evil.server_close()
        context.close()


class _Blank(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"<!doctype html>evil")

    def log_message(self, *_: object) -> None:
        """No noise."""
