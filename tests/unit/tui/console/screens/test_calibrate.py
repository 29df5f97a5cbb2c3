"""The calibrate screen: guidance from a child, views, sweeps, verdicts with their reasons."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from acquire.contract.messaging.messages import Picture
from acquire.contract.states import State
from tests.fakes.fake_daemon import IDLE, SWEEPING
from tests.fakes.scans.small_scans import make_scan
from tests.unit.tui.console.played_console import play
from tui.console.calibration.board_watch import BoardWatch
from tui.console.calibration.light_setup import LightSetup
from tui.console.calibration.results import camera_result, plane_result
from tui.console.calibration.rules import CalibrationSituation, why_not
from tui.console.calibration.session import BoardPattern, CalibrationSession, parse_board
from tui.console.link.messages import CommandAnswered, PictureArrived, StatusArrived
from tui.console.link.rig_view import PictureView
from tui.console.screens import scan_list
from tui.console.widgets.board_picture import BoardPicture
from tui.console.widgets.calibrate_panes import GuidePane
from tui.console.widgets.rows import RowList

PREVIEW = msgspec.structs.replace(IDLE, state=State.PREVIEW, activity="preview")
FACTS = {
    "views": [{"name": "view-01.png", "found": True, "words": "flat (1 degrees)", "tilt_deg": 1.0}],
    "coverage": [[0, 1, 1, 0], [0, 1, 1, 0], [0, 1, 1, 0]],
    "advice": ["tilt it by 10 to 20 degrees: right side higher", "move it: corner top left is empty"],
    "ready": False,
    "stage_view": "view-01.png",
    "live": {"found": True, "corners": [[0.25, 0.25], [0.5, 0.5]], "words": "flat (1 degrees): as in view-01"},
}
QUALITY = {
    "rms_px": 0.07,
    "coverage": 0.8,
    "views": [
        {"name": "view-01.png", "used": True, "reason": "", "rms_px": 0.05},
        {"name": "view-02.png", "used": False, "reason": "blurred", "rms_px": None},
    ],
    "notes": ["nearly telecentric"],
}
CAMERA = {"K": [[5800.0, 0, 256], [0, 5800.0, 192], [0, 0, 1]], "T": [0, 0, 77.0], "quality": QUALITY}


def picture(level: int = 90) -> PictureArrived:
    pixels = np.full((48, 64), level, np.uint8)
    header = Picture(shape=[48, 64], source_shape=[384, 512])
    return PictureArrived(PictureView.of(header, pixels.tobytes()))


def with_views(folder: Path, count: int) -> CalibrationSession:
    session = CalibrationSession(folder)
    session.save_board(BoardPattern())
    for _ in range(count):
        session.next_view().write_bytes(b"png")
    return session


def test_the_child_that_looks_for_the_board_runs_while_the_screen_is_in_view(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect(PREVIEW)
        arguments, subject = console.started[0]
        assert subject == "board" and arguments[:2] == ["calibrate", "watch"]
        assert "--squares" in arguments and "16x13" in arguments and "--json" in arguments

    play(script, screen="calibrate", data_dir=tmp_path)


def test_it_is_not_looked_for_without_a_rig_nor_during_a_sweep(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.pilot.pause()
        assert console.started == [] and "not connected" in console.painted
        await console.connect(SWEEPING)
        assert console.started == []

    play(script, screen="calibrate", data_dir=tmp_path)


def test_a_child_that_cannot_look_is_not_started_again_at_once_and_says_why(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect(PREVIEW)
        await console.end_job(None, exit_status=1, words="no rig daemon answers")
        await console.connect(PREVIEW)
        assert len(console.started) == 1
        assert "no rig daemon answers" in console.shown(GuidePane)

    play(script, screen="calibrate", data_dir=tmp_path)


def test_corners_are_marked_in_the_picture_and_the_advice_stands_beside_it(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect(PREVIEW)
        await console.hear(picture())
        await console.report(FACTS)
        guide = console.shown(GuidePane)
        for words in ("1. tilt it by 10 to 20", "2. move it: corner top left", "view-01 flat", "as in view-01"):
            assert words in guide
        live = console.screen.query_one(BoardPicture)
        marks = sum(live.render_line(y).text.count("•") for y in range(live.size.height))
        assert marks == 2

    play(script, screen="calibrate", size=(160, 50), data_dir=tmp_path)


def test_enough_views_are_called_enough(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect(PREVIEW)
        await console.report({**FACTS, "advice": [], "ready": True})
        assert "enough views: g calibrates" in console.shown(GuidePane)

    play(script, screen="calibrate", data_dir=tmp_path)


def test_a_capture_goes_into_the_session_under_the_next_number_and_its_fate_is_told(tmp_path):
    session = with_views(tmp_path, 2)

    async def script(console):
        console.watch_jobs()
        await console.connect(PREVIEW)
        await console.press("c")
        name, args = console.link.sent[-1]
        assert (name, args) == ("capture", {"path": str(session.folder / "view-03.png")})
        request_id = f"request-{len(console.link.sent)}"
        await console.hear(CommandAnswered("capture", False, "a scan is running", 1, request_id=request_id))
        assert "view-03.png: a scan is running" in console.log

    play(script, screen="calibrate", data_dir=tmp_path)


def test_the_last_view_can_be_put_aside(tmp_path):
    session = with_views(tmp_path, 2)

    async def script(console):
        console.watch_jobs()
        await console.press("u")
        assert [path.name for path in session.views] == ["view-01.png"]
        await console.press("u", "u")
        assert "there is no view" in console.log

    play(script, screen="calibrate", data_dir=tmp_path)


def test_the_camera_is_calibrated_with_the_flat_view_and_the_result_says_passed_with_residuals(tmp_path):
    session = with_views(tmp_path, 3)

    async def script(console):
        console.watch_jobs()
        await console.connect(PREVIEW)
        await console.report(FACTS)
        await console.press("g")
        arguments = console.started[-1][0]
        assert arguments[:2] == ["calibrate", "camera"] and arguments[2:5] == [str(path) for path in session.views]
        assert arguments[arguments.index("--stage") + 1] == "view-01.png"
        await console.end_job({"out": str(session.result), "camera": CAMERA})
        guide = console.shown(GuidePane)
        for words in ("PASSED", "0.0700 px", "view-01  0.0500 px", "view-02  left out: blurred", "nearly telecentric"):
            assert words in guide
        await console.press("v")
        assert "PASSED" not in console.shown(GuidePane)

    play(script, screen="calibrate", size=(160, 50), data_dir=tmp_path)


def test_a_calibration_that_fails_says_the_routines_reason(tmp_path):
    with_views(tmp_path, 3)

    async def script(console):
        console.watch_jobs()
        await console.connect(PREVIEW)
        await console.press("g")
        await console.end_job(None, exit_status=1, words="all views are parallel")
        assert "FAILED: all views are parallel" in console.shown(GuidePane).replace("\n", " ")
        assert console.app.state.log.lines[-1].level == "error"

    play(script, screen="calibrate", data_dir=tmp_path)


def test_sweeps_over_the_board_are_taken_chosen_and_fitted(tmp_path, monkeypatch):
    monkeypatch.setattr(scan_list, "POLL_S", 0.1)
    session = with_views(tmp_path, 3)
    session.result.write_text('{"camera": {}}')
    for name in ("a", "b"):
        make_scan(tmp_path / name, purpose="calibration", started_utc=f"2026-01-0{ord(name) - 95}T00:00:00Z")
    make_scan(tmp_path / "object", purpose="object")

    async def script(console):
        console.watch_jobs()
        await console.connect()
        await console.press("m")
        await console.until(lambda: "b  SAVED" in console.shown(RowList), "the sweeps")
        assert "object" not in console.shown(RowList)
        await console.press("w")
        name, args = console.link.sent[-1]
        assert name == "scan" and args["purpose"] == "calibration" and args["name"] == "board-3"
        await console.press("enter", "g")
        arguments = console.started[-1][0]
        assert arguments[:2] == ["calibrate", "plane"] and str(tmp_path / "a") in arguments
        assert str(tmp_path / "b") not in arguments, "it was taken out"
        surface = {
            "name": "20260101T000000Z-a",
            "mean_um": 3.2,
            "rms_um": 4.0,
            "ok": False,
            "cause": "it lies 3 um off",
        }
        await console.end_job({"out": "x.json", "light_plane": {"quality": {"surfaces": [surface]}}})
        assert "FAILED: 20260101T000000Z-a: it lies 3 um off" in console.shown(GuidePane).replace("\n", " ")

    play(script, screen="calibrate", size=(160, 50), data_dir=tmp_path)


def test_a_sweep_that_cannot_pass_says_so_before_the_plane_is_fitted(tmp_path, monkeypatch):
    monkeypatch.setattr(scan_list, "POLL_S", 0.1)
    folder = make_scan(tmp_path / "a", purpose="calibration")
    (folder / "report.json").write_text('{"counts": {"over_contrast": 200, "quality_saturated": 178}}')

    async def script(console):
        await console.connect()
        await console.press("m")
        await console.until(
            lambda: "SAVED, 89 % SATURATED: e, then sweep again" in console.shown(RowList), "the warning"
        )

    play(script, screen="calibrate", size=(160, 50), data_dir=tmp_path)


def test_for_a_sweep_the_exposure_is_searched_when_the_light_has_come_over_the_board(tmp_path):
    async def script(console):
        await console.connect()
        await console.press("m", "e")
        assert console.sent[-2:] == [("lamp", {"on": True}), ("goto", {"position_steps": 1578})]
        await console.hear(StatusArrived(msgspec.structs.replace(IDLE, state=State.MOVING, position_steps=700)))
        assert console.sent[-1][0] == "goto", "it is searched while the stage moves"
        await console.hear(StatusArrived(msgspec.structs.replace(IDLE, position_steps=1578)))
        assert console.sent[-1] == ("expose", {})
        await console.hear(StatusArrived(msgspec.structs.replace(IDLE, position_steps=1578)))
        assert [name for name, _ in console.sent].count("expose") == 1

    play(script, screen="calibrate", data_dir=tmp_path)


def test_nothing_is_begun_while_the_simulated_board_is_laid(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect(msgspec.structs.replace(IDLE, activity="specimen"))
        await console.press("c", "P", "e")
        assert console.sent == [] and "specimen is running; wait" in console.log

    play(script, screen="calibrate", data_dir=tmp_path)


def test_for_a_view_the_exposure_is_searched_where_the_stage_is(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect()
        await console.press("e")
        assert [name for name, _ in console.sent] == ["expose"]

    play(script, screen="calibrate", data_dir=tmp_path)


def test_a_light_that_was_stopped_on_its_way_searches_no_exposure():
    light, far = LightSetup(), msgspec.structs.replace(IDLE, lamp_on=True)
    moving = msgspec.structs.replace(far, state=State.MOVING, position_steps=500)
    there = msgspec.structs.replace(far, position_steps=1578)
    assert light.begin(1578, far, 0.0) == [("goto", {"position_steps": 1578})]
    assert light.take_status(far, 0.1, stopped=False) == [], "the move has not begun"
    assert light.take_status(moving, 0.2, stopped=False) == []
    assert light.take_status(msgspec.structs.replace(far, position_steps=600), 0.3, stopped=False) == []
    assert light.take_status(there, 0.4, stopped=False) == [], "somebody else moved it there"
    light.begin(1578, far, 1.0)
    assert light.take_status(moving, 1.1, stopped=True) == [] == light.take_status(there, 1.2, stopped=False)
    light.begin(1578, far, 2.0)
    assert light.take_status(far, 1000.0, stopped=False) == [] == light.take_status(there, 1000.1, stopped=False)
    light.begin(1578, far, 3.0)
    assert light.take_status(there, 1000.0, stopped=False) == [], "it is there long after anybody waited"


def test_a_light_on_its_way_searches_no_exposure_once_the_screen_was_left(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect(msgspec.structs.replace(IDLE, lamp_on=True))
        await console.press("m", "e")
        assert console.sent == [("goto", {"position_steps": 1578})]
        await console.press("6", "3")
        await console.hear(StatusArrived(msgspec.structs.replace(IDLE, lamp_on=True, position_steps=1578)))
        assert [name for name, _ in console.sent] == ["goto"]

    play(script, screen="calibrate", data_dir=tmp_path)


def test_a_child_that_cannot_be_started_is_not_tried_again_at_once():
    class NoJobs:
        tried = 0

        def start(self, *_args, **_more):
            self.tried += 1

    jobs = NoJobs()
    watch = BoardWatch(jobs, lambda: None)
    for _ in range(3):
        watch.follow(["watch"], wanted=True)
    assert jobs.tried == 1


def test_the_simulated_board_takes_one_pose_after_the_other_and_real_rigs_have_no_such_key(tmp_path):
    async def script(console):
        console.watch_jobs()
        await console.connect()
        await console.press("P", "P")
        poses = [args for name, args in console.link.sent if name == "specimen"]
        assert poses[0]["tilt_x_deg"] == poses[0]["tilt_y_deg"] == 0.0 and poses[1] != poses[0]
        await console.connect(msgspec.structs.replace(IDLE, camera_kind="genicam"))
        await console.press("P")
        assert "only on the simulated rig" in console.log

    play(script, screen="calibrate", data_dir=tmp_path)


def test_a_session_is_resumed_and_a_new_one_leaves_it_as_it_was(tmp_path):
    first = with_views(tmp_path, 2)
    first.save_board(BoardPattern(columns=20, rows=10, square_mm=0.5))
    again = CalibrationSession(tmp_path)
    assert (again.folder, again.board.columns, len(again.views)) == (first.folder, 20, 2)
    again.begin_anew()
    assert again.views == [] and len(first.views) == 2


def test_boards_are_read_as_people_write_them_and_nonsense_is_refused():
    board = parse_board({"squares": "13X16", "square_mm": "0,3", "kind": "chessboard"})
    assert (board.columns, board.rows, board.square_mm) == (16, 13, 0.3)
    for squares, size, kind in (("16", "0.3", "chessboard"), ("16x13", "-1", "chessboard"), ("16x13", "1", "cubes")):
        with pytest.raises(ValueError, match="give squares as 16x13"):
            parse_board({"squares": squares, "square_mm": size, "kind": kind})


def test_verdicts_name_the_limit_that_was_missed():
    bad = camera_result({"quality": {**QUALITY, "rms_px": 0.9, "coverage": 0.2}}, {})
    assert not bad.passed and "0.9000 px" in bad.headline and any("cover only 20 %" in line for line in bad.lines)
    assert not camera_result({}, {}).passed
    before = {"K": [[5000.0]], "T": [0, 0, 70.0]}
    assert any("focal length +16.00 %" in line for line in camera_result(CAMERA, before).lines)
    assert plane_result({"quality": {"surfaces": [{"name": "a", "ok": True}], "normal_sd_deg": 0.001}}).passed


def test_rules_say_the_first_thing_that_hinders():
    free = CalibrationSituation(False, False, True, 3, 0, 0, False, False, False)
    assert why_not("fit", free) == "" and why_not("cancel", free) == "nothing is running"
    assert why_not("fit", replace(free, views=2)).startswith("at least three")
    assert why_not("anew", free) == ""
    for action in ("fit", "anew"):
        assert why_not(action, replace(free, working=True)) == "a calibration is running: x cancels"
    assert why_not("capture", replace(free, sweep_runs=True)) == "a sweep is running"
    assert why_not("fit", replace(free, plane_step=True)) == "calibrate the camera first: m goes there"
