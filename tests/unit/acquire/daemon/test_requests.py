"""Commands: what is understood, and what is refused with a way out."""

from __future__ import annotations

import pytest

from acquire.contract.errors import CalibrationError, CommandRefusedError
from acquire.daemon.requests import (
    CameraRequest,
    GotoRequest,
    JogRequest,
    NoArguments,
    PreviewRequest,
    ScanRequest,
    parse_request,
)

REQUESTS = {
    "scan": ScanRequest,
    "jog": JogRequest,
    "goto": GotoRequest,
    "camera": CameraRequest,
    "preview": PreviewRequest,
    "pause": NoArguments,
}


def parse(name, args):
    return parse_request(name, REQUESTS[name], args)


def test_arguments_become_typed_structs():
    assert parse("jog", {"steps": -10}) == JogRequest(-10)
    assert parse("scan", {"name": "stapes", "first_steps": 3}) == ScanRequest("stapes", 3)


def test_an_unknown_command_is_refused_with_the_nearest_one(start_rig):
    with pytest.raises(CommandRefusedError, match="there is no command 'resum'; did you mean 'resume'"):
        start_rig().ask("resum")


@pytest.mark.parametrize(
    ("name", "args"),
    [
        ("scan", {"nmae": "x"}),
        ("scan", {"name": ""}),
        ("scan", {"steps_per_frame": 0}),
        ("jog", {}),
        ("jog", {"steps": 10**9}),
        ("goto", {"position_steps": "far"}),
        ("pause", {"now": True}),
    ],
)
def test_arguments_that_do_not_fit_are_refused_by_name(name, args):
    with pytest.raises(CommandRefusedError, match=name):
        parse(name, args)


@pytest.fixture
def prepare(tmp_path):
    """Prepare a scan on a rig that knows no calibration of its own."""
    from acquire.contract.config.load import load_config
    from acquire.contract.messaging.messages import FrameFormat
    from acquire.daemon.scan_setup import prepare_scan
    from tests.unit.rig_in_process import known_rig

    def call(request=ScanRequest(), **overrides):  # noqa: B008 - a frozen struct
        config = load_config(overrides={"storage.data_dir": str(tmp_path)} | overrides, environ={})
        frame_format = FrameFormat(width=64, height=48, bit_depth=8)
        return prepare_scan(request, config, known_rig(frame_format, exposure_ms=10))

    return call


def test_an_object_without_a_calibration_is_refused_with_a_way_out(prepare, tmp_path):
    with pytest.raises(CalibrationError, match=r"reconstruct\.calibration.*'raw'"):
        prepare()
    assert list(tmp_path.iterdir()) == []


def test_a_raw_scan_needs_no_calibration(prepare):
    prepared = prepare(ScanRequest(purpose="raw"))
    assert prepared.folder.is_dir() and prepared.start.calibration_json == ""
    prepared.lock.release()


def test_a_calibration_that_is_not_there_is_named_before_anything_is_made(prepare, tmp_path):
    with pytest.raises(CalibrationError, match=r"away\.json"):
        prepare(**{"reconstruct.calibration": "/away.json"})
    assert list(tmp_path.iterdir()) == []


def test_a_data_dir_that_cannot_be_written_is_refused_with_a_way_out(prepare):
    with pytest.raises(CommandRefusedError, match=r"/proc/none.*storage\.data_dir"):
        prepare(ScanRequest(purpose="raw"), **{"storage.data_dir": "/proc/none"})


def test_a_disk_that_is_too_small_is_refused_with_needed_and_free(prepare, monkeypatch):
    import shutil
    from collections import namedtuple

    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _place: usage(10, 9, 1000))
    with pytest.raises(CommandRefusedError, match=r"needs 1\.6 MB.*1\.0 kB free.*0:0.*storage\.data_dir"):
        prepare(ScanRequest(purpose="raw"))


def test_a_window_that_holds_no_two_frames_is_refused():
    from acquire.contract.config.load import load_config
    from acquire.contract.messaging.messages import FrameFormat
    from acquire.daemon.scan_setup import window_slots

    config = load_config(overrides={"limits.window_bytes": 1_000_000}, environ={})
    with pytest.raises(CommandRefusedError, match="window_bytes"):
        window_slots(config, FrameFormat(width=1024, height=768, bit_depth=8))


@pytest.mark.parametrize(
    ("name", "args", "words"),
    [
        ("camera", {"gain": 99}, "camera: gain must be a number <= 48.0"),
        ("jog", {"steps": 1.5}, "jog: steps must be a whole number"),
        ("preview", {"on": 3}, "preview: on must be true or false"),
        ("jog", {}, "jog: Object missing required field `steps`"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_in_words_for_people(name, args, words):
    with pytest.raises(CommandRefusedError) as refused:
        parse(name, args)
    assert str(refused.value) == words
