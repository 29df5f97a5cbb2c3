"""The command line's client against a daemon that the test plays."""

from __future__ import annotations

import msgspec
import pytest

from acquire.contract.errors import CommandRefusedError, NoServiceError, SweepscopeError
from acquire.contract.process.run_dir import is_served
from acquire.contract.states import Outcome, State
from tests.fakes.fake_daemon import SWEEPING, FakeDaemon
from tests.waiting import WALL_CLOCK_S, Stopwatch, wait_for
from tui.client.follow import ProgressPrinter, exit_status_of, follow_scan, has_ended
from tui.client.rig_client import ProgressFeed, RigClient

ENDED = msgspec.structs.replace(SWEEPING, state=State.IDLE, outcome=Outcome.COMPLETE, committed=527)


def replace(status, **changes):
    return msgspec.structs.replace(status, **changes)


def test_a_request_returns_the_daemons_result(run_dir):
    with FakeDaemon(run_dir) as daemon, RigClient(run_dir) as client:
        result = client.request("scan", name="ear", last_steps=None).result
        assert result["scan_uid"] == "uid-ear"
        assert daemon.commands == [("scan", {"name": "ear"})]


def test_a_refusal_is_raised_in_the_daemons_words(run_dir):
    with FakeDaemon(run_dir) as daemon, RigClient(run_dir) as client:
        daemon.refuse["scan"] = "home it first"
        with pytest.raises(CommandRefusedError, match="home it first"):
            client.request("scan")


def test_a_request_without_a_reply_is_sent_twice_with_one_id_and_then_given_up(run_dir):
    with FakeDaemon(run_dir) as daemon, RigClient(run_dir, timeout_s=0.4) as client:
        daemon.deaf = True
        with pytest.raises(NoServiceError, match=r"pause.*not known"):
            client.request("pause")
        assert [name for name, _ in daemon.commands] == ["pause", "pause"]


def test_a_request_that_is_sent_again_is_as_old_as_it_was(run_dir):
    with FakeDaemon(run_dir) as daemon, RigClient(run_dir, timeout_s=0.4) as client:
        daemon.deaf = True
        with pytest.raises(NoServiceError):
            client.request("pause")
        daemon.asked("pause", count=2)
        first, second = daemon.sent_mono_ns
        assert first == second > 0


def test_nobody_there_is_told_at_once(run_dir):
    watch = Stopwatch()
    with pytest.raises(NoServiceError, match="sweepscope up"):
        RigClient(run_dir)
    assert watch.elapsed_s < 1.0


def test_a_socket_file_of_a_dead_daemon_is_not_a_daemon(run_dir):
    import socket

    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(run_dir / "command.sock"))
    assert (run_dir / "command.sock").is_socket()
    assert not is_served(run_dir)


def test_the_newest_status_wins(run_dir):
    with FakeDaemon(run_dir) as daemon, RigClient(run_dir) as client:
        client.status()
        daemon.show(position_steps=77)
        found = client.wait_for(lambda status: status.position_steps == 77, WALL_CLOCK_S)
        assert found is not None and found.position_steps == 77


def test_a_silent_daemon_is_told_as_no_service(run_dir):
    with FakeDaemon(run_dir) as daemon:
        daemon.silent = True
        with RigClient(run_dir, timeout_s=0.2) as client:
            while client.newest_status(0.2) is not None:
                pass  # what was sent before
            with pytest.raises(NoServiceError, match="no status"):
                client.status()


def test_what_cannot_be_read_is_passed_over(run_dir):
    with FakeDaemon(run_dir) as daemon, RigClient(run_dir) as client:
        daemon.rubbish = b"\xc1 rubbish"
        daemon.show(position_steps=77)
        assert client.wait_for(lambda status: status.position_steps == 77, 5.0) is not None


def test_following_a_scan_ends_with_its_outcome_and_hears_its_progress(run_dir):
    said: list[str] = []
    with FakeDaemon(run_dir, frames_per_tick=10, expected=60) as daemon, RigClient(run_dir) as client:
        scan_uid = client.request("scan", name="ear").result["scan_uid"]
        end = follow_scan(client, scan_uid, ProgressPrinter(said.append, every_s=0.0).take)
        assert end.outcome == Outcome.COMPLETE and end.committed == 60
        assert daemon.status.state == State.IDLE
    assert any("SWEEPING" in line for line in said)


def test_following_a_scan_ends_when_the_daemon_falls_silent(run_dir):
    with FakeDaemon(run_dir, frames_per_tick=0) as daemon, RigClient(run_dir) as client:
        scan_uid = client.request("scan").result["scan_uid"]
        client.wait_for(lambda status: status.scan_uid == scan_uid, 5.0)
        daemon.silent = True
        with pytest.raises(NoServiceError, match="committed frames are in the file"):
            follow_scan(client, scan_uid, lambda status: None, silence_s=0.3)


def test_following_a_scan_tells_that_the_daemon_was_started_again(run_dir):
    def restart(status):
        daemon.show(scan_uid="", outcome="", state=State.IDLE)

    with FakeDaemon(run_dir, frames_per_tick=0) as daemon, RigClient(run_dir) as client:
        scan_uid = client.request("scan").result["scan_uid"]
        with pytest.raises(SweepscopeError, match="started again"):
            follow_scan(client, scan_uid, restart)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, 0),
        ({"missing": 1}, 4),
        ({"outcome": Outcome.STOPPED, "committed": 10}, 4),
        ({"outcome": Outcome.ABORTED}, 4),
        ({"outcome": Outcome.INTERRUPTED}, 4),
        ({"outcome": Outcome.FAILED}, 1),
    ],
)
def test_the_exit_status_tells_complete_from_incomplete_from_failed(changes, expected):
    assert exit_status_of(replace(ENDED, **changes)) == expected


def test_a_scan_has_not_ended_while_the_rig_still_finishes_it():
    assert not has_ended(replace(ENDED, state=State.FINISHING), ENDED.scan_uid)
    assert not has_ended(replace(ENDED, outcome=Outcome.RUNNING), ENDED.scan_uid)
    assert not has_ended(ENDED, "another")
    assert has_ended(ENDED, ENDED.scan_uid)


def test_the_progress_feed_gives_the_newest_without_waiting(run_dir):
    from tests.fakes.fake_daemon import PROGRESS

    feed = ProgressFeed(run_dir)
    try:
        assert feed.newest() is None
        with FakeDaemon(run_dir) as daemon:
            daemon.progress = PROGRESS
            wait_for(feed.newest, "progress")
        found = feed.newest()
        assert found is not None and found.points_settled == PROGRESS.points_settled
        assert feed.end_of("uid-1") is None
    finally:
        feed.close()
