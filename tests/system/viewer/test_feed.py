"""What the page hears and sends over real sockets, with a scripted rig at the other end."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from acquire.contract.messaging.messages import Picture, ResultTiles, Status
from process.viewer.rig_client.commands import CommandThread
from process.viewer.rig_client.feed import FeedThread, Snapshot
from tests.fakes.fake_results import SCAN_UID, FakeRig, hill_tiles
from tests.waiting import WALL_CLOCK_S, wait_for

TILES = hill_tiles(4, 3, 8)


@pytest.fixture
def wake() -> threading.Event:
    return threading.Event()


@pytest.fixture
def feed(run_dir: Path, wake: threading.Event) -> Iterator[FeedThread]:
    feed = FeedThread(run_dir, wake)
    feed.start()
    yield feed
    feed.close()


def until(feed: FeedThread, wake: threading.Event, wanted: Callable[[Snapshot], bool]) -> Snapshot:
    def pause() -> None:
        wake.wait(0.1)
        wake.clear()

    wait_for(lambda: wanted(feed.snapshot()), "the wanted state", pause=pause, why=feed.snapshot)
    return feed.snapshot()


def through(frame_index: int) -> Callable[[Snapshot], bool]:
    return lambda now: now.progress is not None and now.progress.folded_through == frame_index


def test_the_newest_status_and_all_changed_tiles_arrive(feed: FeedThread, wake: threading.Event, run_dir: Path) -> None:
    with FakeRig(run_dir) as rig:
        rig.set_status(state="sweeping", committed=12)
        assert rig.subscribed.wait(WALL_CLOCK_S)
        rig.publish_tiles(TILES[:5], folded_through=7)
        rig.publish_tiles(TILES[5:6], folded_through=8)
        now = until(feed, wake, lambda now: through(8)(now) and now.status is not None)
        assert now.status is not None
        assert (now.status.committed, now.cloud_scan_uid, now.cloud_folded_through) == (12, SCAN_UID, 8)
        assert set(feed.take_tiles().tiles) == {header.tile for header, _ in TILES[:6]}
        assert feed.take_tiles().tiles == {}


def test_services_may_come_late_go_and_come_back(feed: FeedThread, wake: threading.Event, run_dir: Path) -> None:
    for _ in range(2):
        with FakeRig(run_dir):
            until(feed, wake, lambda now: now.daemon.connected and now.worker.connected and now.status is not None)
        gone = until(feed, wake, lambda now: not now.daemon.connected and not now.worker.connected)
        assert gone.status is not None, "the last word is kept, to be shown as old"


@pytest.mark.parametrize("_", range(5))
def test_services_that_were_there_before_are_seen_at_once_even_if_silent(
    _: int, run_dir: Path, wake: threading.Event
) -> None:
    with FakeRig(run_dir):
        feed = FeedThread(run_dir, wake)
        feed.start()
        try:
            until(feed, wake, lambda now: now.daemon.connected and now.worker.connected)
        finally:
            feed.close()


def test_whoever_comes_late_gets_everything(run_dir: Path, wake: threading.Event) -> None:
    with FakeRig(run_dir) as rig:
        rig.publish_tiles(TILES, folded_through=20)
        feed = FeedThread(run_dir, wake)
        feed.start()
        until(feed, wake, through(20))
        news = feed.take_tiles()
        feed.close()
    assert news.reset
    assert len(news.tiles) == len(TILES)


def test_a_gap_is_counted_and_answered_by_asking_for_everything(
    feed: FeedThread, wake: threading.Event, run_dir: Path
) -> None:
    with FakeRig(run_dir) as rig:
        assert rig.subscribed.wait(WALL_CLOCK_S)
        rig.publish_tiles(TILES[:6], folded_through=1)
        until(feed, wake, through(1))
        sent_before = rig.snapshots_sent
        feed.take_tiles()
        rig.publish_tiles(TILES[6:7], folded_through=2, skip_seq=3)
        until(feed, wake, lambda now: now.gaps == 3 and rig.snapshots_sent > sent_before)
        tiles: dict[int, object] = {}

        def all_there() -> bool:
            tiles.update(feed.take_tiles().tiles)
            return len(tiles) == 7

        wait_for(all_there, "seven tiles", why=tiles.keys)


def test_another_scan_forgets_the_cloud_of_the_one_before(
    feed: FeedThread, wake: threading.Event, run_dir: Path
) -> None:
    with FakeRig(run_dir) as rig:
        assert rig.subscribed.wait(WALL_CLOCK_S)
        rig.publish_tiles(TILES[:6], folded_through=500)
        until(feed, wake, through(500))
        feed.take_tiles()
        rig.publish_tiles(TILES[:1], folded_through=0, scan_uid="scan-2")
        until(feed, wake, through(0))
        news = feed.take_tiles()
        assert news.reset
        assert len(news.tiles) == 1


def test_a_message_that_cannot_be_read_is_counted_and_the_next_one_is_taken(
    feed: FeedThread, wake: threading.Event, run_dir: Path
) -> None:
    with FakeRig(run_dir) as rig:
        assert rig.subscribed.wait(WALL_CLOCK_S)
        header, _ = TILES[0]
        rig.publish(
            ResultTiles(scan_uid=SCAN_UID, version=1, folded_through=0, snapshot=False, tiles=[header]), b"short"
        )
        rig.publish_tiles(TILES[:1], folded_through=3)
        assert until(feed, wake, through(3)).messages_dropped == 1


@pytest.fixture
def commands(run_dir: Path) -> Iterator[CommandThread]:
    line = CommandThread(run_dir, timeout_s=0.5)
    line.start()
    yield line
    line.close()


def note_of(line: CommandThread, wanted: str) -> str:
    wait_for(lambda: wanted in line.note.text, wanted, why=lambda: line.note)
    return line.note.text


def test_clicks_reach_the_daemon_in_their_order(commands: CommandThread, run_dir: Path) -> None:
    with FakeRig(run_dir) as rig:
        commands.submit("pause")
        note_of(commands, "pause: done")
        for name in ("resume", "stop"):
            commands.submit(name)
        note_of(commands, "stop: done")
        assert [command.name for command in rig.commands] == ["pause", "resume", "stop"]
        assert len({command.request_id for command in rig.commands}) == 3


def test_a_refusal_is_shown_in_the_daemons_words(commands: CommandThread, run_dir: Path) -> None:
    with FakeRig(run_dir, refuse="a sweep is running"):
        commands.submit("scan", {"name": "frog"})
        note_of(commands, "scan was refused: a sweep is running")
        assert not commands.note.ok


def test_a_click_without_a_daemon_is_not_kept_for_one_that_comes_later(commands: CommandThread, run_dir: Path) -> None:
    commands.submit("scan", {"name": "frog"})
    note_of(commands, "scan was not sent: no rig daemon")
    with FakeRig(run_dir) as rig:
        commands.submit("status")
        note_of(commands, "status: done")
        assert [command.name for command in rig.commands] == ["status"]


def test_an_answer_that_does_not_come_is_said_after_the_time_out(commands: CommandThread, run_dir: Path) -> None:
    with FakeRig(run_dir, silent_commands=True):
        commands.submit("pause")
        note_of(commands, "pause: no answer within 0.5 s")


def test_a_second_click_while_the_first_is_on_its_way_is_not_sent_but_a_second_stop_is(
    commands: CommandThread, run_dir: Path
) -> None:
    with FakeRig(run_dir, silent_commands=True) as rig:
        for name in ("scan", "scan", "stop", "stop"):
            commands.submit(name)
        note_of(commands, "no answer")
        assert [command.name for command in rig.commands] == ["scan", "stop", "stop"]


def test_beats_of_a_held_jog_are_all_sent_in_the_name_of_their_browser_and_nothing_is_said_of_them(
    commands: CommandThread, run_dir: Path
) -> None:
    with FakeRig(run_dir) as rig:
        commands.submit("status")
        note_of(commands, "status: done")
        for direction in (1, -1):
            commands.submit("jog_hold", {"direction": direction}, client="browser 1")
        wait_for(lambda: len(rig.commands) == 3, "both beats", why=lambda: rig.commands)
        sent = [(command.name, command.args["direction"], command.client) for command in rig.commands[1:]]
        assert sent == [("jog_hold", 1, "browser 1"), ("jog_hold", -1, "browser 1")]
        assert commands.note.text == "status: done"


def test_a_refused_beat_is_said(commands: CommandThread, run_dir: Path) -> None:
    with FakeRig(run_dir, refuse="anna holds control"):
        commands.submit("jog_hold", {"direction": 1})
        note_of(commands, "jog_hold was refused: anna holds control")


def test_camera_pictures_come_only_while_somebody_looks(feed: FeedThread, wake: threading.Event, run_dir: Path) -> None:
    with FakeRig(run_dir) as rig:
        feed.watch(True)
        assert rig.watched.wait(WALL_CLOCK_S)
        rig.publish_picture(np.arange(12, dtype=np.uint8).reshape(3, 4), frame_index=8)
        now = until(feed, wake, lambda now: now.picture is not None)
        assert now.picture is not None
        assert now.picture.frame_index == 8
        pixels = feed.take_pixels()
        assert pixels is not None
        assert pixels[2].tolist() == [8, 9, 10, 11]
        assert feed.take_pixels() is None
        feed.watch(False)
        assert rig.unwatched.wait(WALL_CLOCK_S)


def test_a_picture_with_fewer_pixels_than_it_says_is_dropped(
    feed: FeedThread, wake: threading.Event, run_dir: Path
) -> None:
    with FakeRig(run_dir) as rig:
        feed.watch(True)
        assert rig.watched.wait(WALL_CLOCK_S)
        rig.publish(Picture(shape=[3, 4], source_shape=[3, 4]), b"short")
        assert until(feed, wake, lambda now: now.messages_dropped > 0).picture is None


def test_a_status_is_taken_even_if_it_is_the_only_thing_there(
    feed: FeedThread, wake: threading.Event, run_dir: Path
) -> None:
    with FakeRig(run_dir, status=Status(state="homing"), worker=False):
        now = until(feed, wake, lambda now: now.status is not None)
        assert now.status is not None
        assert now.status.state == "homing"
        assert not now.worker.connected
