import pytest

from acquire.contract.faults import report
from acquire.contract.messaging.messages import ResultProgress, Status
from acquire.contract.units import NS_PER_S
from process.viewer.rig_client.feed import Peer, Snapshot
from process.viewer.status_html import SceneFacts, status_html
from process.viewer.status_text import allowed, heading, remarks, saved_line, scan_name

NOW_NS = 1000 * NS_PER_S
HERE = Peer(connected=True, heard_ns=NOW_NS, changed_ns=NOW_NS - 60 * NS_PER_S)
STATUS = Status(state="sweeping", scan_uid="a", scan_path="/d/20260102T030405Z-frog", expected=527, writer_alive=True)


def rig(**changes: object) -> Snapshot:
    fields = {"daemon": HERE, "worker": HERE, "status": STATUS, "cloud_scan_uid": "a"}
    return Snapshot(**(fields | changes))


def said(snapshot: Snapshot, one_of: int = 1) -> str:
    return " ".join(remark.text for remark in remarks(snapshot, NOW_NS, one_of))


def test_when_all_is_well_nothing_is_said_to_be_missing() -> None:
    assert said(rig()) == ""


def test_without_any_service_the_page_says_so_instead_of_being_blank() -> None:
    nothing = Snapshot()
    assert heading(nothing, NOW_NS).words == "not connected – retrying"
    assert "No rig daemon" in said(nothing)
    assert "No worker" in said(nothing)
    assert "not connected" in status_html(nothing, NOW_NS, SceneFacts())


def test_a_daemon_that_went_away_leaves_its_numbers_marked_as_old() -> None:
    gone = rig(daemon=Peer(connected=False, heard_ns=NOW_NS - 12 * NS_PER_S, changed_ns=NOW_NS - 12 * NS_PER_S))
    assert not heading(gone, NOW_NS).live
    assert "away for 12 s" in said(gone)
    assert "sw-old" in status_html(gone, NOW_NS, SceneFacts())


def test_a_daemon_that_is_there_but_silent_is_not_shown_as_live() -> None:
    frozen = rig(daemon=Peer(connected=True, heard_ns=NOW_NS - 7 * NS_PER_S))
    assert heading(frozen, NOW_NS).words == "no status from the rig for 7 s"
    assert not heading(frozen, NOW_NS).live


def test_the_reason_of_a_hold_stands_in_the_heading() -> None:
    held = rig(status=Status(state="holding", hold_reason="no credit"))
    assert heading(held, NOW_NS).words == "holding: no credit"


def test_a_missing_worker_writer_or_scan_is_named() -> None:
    assert "No worker" in said(rig(worker=Peer()))
    assert "writer is away" in said(rig(status=Status(state="holding", scan_path="/x", scan_uid="a")))
    assert "No scan yet" in said(rig(status=Status(state="idle"), cloud_scan_uid=""))


def test_a_worker_that_hangs_in_mid_sweep_is_named_with_its_lag() -> None:
    status = Status(state="sweeping", scan_path="/x", scan_uid="a", committed=90, writer_alive=True)
    progress = ResultProgress(version=1, folded_through=49, expected=527, points_settled=5)
    hung = rig(status=status, progress=progress, worker=Peer(connected=True, heard_ns=NOW_NS - 8 * NS_PER_S))
    assert "No message from the worker for 8 s; the cloud is 40 frames behind" in said(hung)


def test_what_the_worker_lacks_is_repeated_in_its_words() -> None:
    progress = ResultProgress(version=1, folded_through=3, expected=9, message="no calibration: maps only")
    assert "no calibration: maps only" in said(rig(progress=progress))


def test_the_cloud_of_an_earlier_scan_is_called_that() -> None:
    assert "scan before" in said(rig(cloud_scan_uid="b"))


def test_thinning_is_said() -> None:
    assert "1 of 4 points" in said(rig(), 4)


@pytest.mark.parametrize(
    ("fields", "line"),
    [
        ({"outcome": "running", "committed": 5}, ""),
        ({"outcome": "complete", "committed": 527}, "SAVED: 527 of 527 frames are safe"),
        ({"outcome": "complete", "committed": 526}, "ended, but not whole: 526 of 527 frames are safe"),
        ({"outcome": "complete", "committed": 527, "missing": 1}, "ended, but not whole: 527 of 527 frames are safe"),
        ({"outcome": "stopped", "committed": 412}, "stopped: 412 of 527 frames are safe"),
    ],
)
def test_saved_is_said_only_of_a_complete_scan_with_nothing_missing(fields: dict[str, object], line: str) -> None:
    assert saved_line(Status(state="idle", expected=527, **fields)) == line


def test_a_scan_is_called_by_its_name_without_the_stamp() -> None:
    assert scan_name(Status(state="idle", scan_path="/data/20260102T030405Z-frog-v1")) == "frog-v1"
    assert scan_name(Status(state="idle", scan_path="/data/my-scan")) == "my-scan"


def test_a_fault_shows_its_code_and_what_is_safe_and_what_to_do() -> None:
    status = Status(state="fault", faults=[report("F03", committed=412, expected=527)])
    html = status_html(rig(status=status), NOW_NS, SceneFacts())
    for text in ("F03", "the writer is lost", "412 of 527 frames are saved", "it is being restarted"):
        assert text in html


def test_words_from_outside_cannot_become_markup() -> None:
    evil = "<img src=x onerror=alert(1)>"
    status = Status(state=evil, scan_path=f"/d/{evil}", message=evil, hold_reason=evil)
    progress = ResultProgress(version=1, folded_through=0, expected=1, message=evil)
    assert "<img" not in status_html(rig(status=status, progress=progress), NOW_NS, SceneFacts())


def test_buttons_follow_the_state_and_stop_is_always_there() -> None:
    at_rest = allowed(Status(state="idle"), live=True)
    assert at_rest["jog"] and at_rest["home"] and not at_rest["pause"]
    assert allowed(Status(state="sweeping"), live=True)["pause"]
    assert allowed(Status(state="holding", hold_reason="paused"), live=True)["resume"]
    assert not allowed(Status(state="holding", hold_reason="no credit"), live=True)["resume"]
    assert not allowed(Status(state="idle"), live=False)["scan"]
    assert allowed(None, live=False)["stop"]
