"""A rig whose devices are not there: the daemon ends with one sentence, at once, and no traceback."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.fakes.serial_device import SerialDevice, grbl
from tests.needs import need_genicam
from tests.system.console.test_cli import assert_one_line, sweepscope

REPLAY = {"SWEEPSCOPE_CAMERA__KIND": "replay"}


def daemon(run_dir: Path, **environ: str) -> subprocess.CompletedProcess[str]:
    return sweepscope("daemon", run_dir=run_dir, **environ)


@pytest.fixture
def pictures(tmp_path: Path) -> str:
    import cv2
    import numpy as np

    cv2.imwrite(str(tmp_path / "frame_0001.png"), np.zeros((48, 64), np.uint8))
    return str(tmp_path)


@pytest.mark.parametrize(
    ("port", "words"),
    [("/dev/ttyNOT", "no serial port /dev/ttyNOT"), ("", "stage.port"), ("/dev/null", "no serial port")],
)
def test_a_missing_port_is_one_sentence(run_dir, pictures, port, words):
    stage = {"SWEEPSCOPE_STAGE__KIND": "uno", "SWEEPSCOPE_STAGE__PORT": port}
    done = daemon(run_dir, **REPLAY, **stage, SWEEPSCOPE_CAMERA__DEVICE=pictures)
    assert done.returncode == 1
    assert_one_line(done, words)


def test_up_ends_at_once_with_the_reason(run_dir, pictures):
    stage = {"SWEEPSCOPE_STAGE__KIND": "uno", "SWEEPSCOPE_STAGE__PORT": "/dev/ttyNOT", "SWEEPSCOPE_VIEWER__PORT": "0"}
    done = sweepscope("up", run_dir=run_dir, **REPLAY, **stage, SWEEPSCOPE_CAMERA__DEVICE=pictures)
    assert done.returncode == 1
    assert done.stderr.count("no serial port /dev/ttyNOT") == 1 and "Traceback" not in done.stderr
    assert "daemon cannot be kept running" in done.stderr


def test_up_in_a_directory_that_is_too_long_ends_at_once(tmp_path):
    done = sweepscope("up", run_dir=tmp_path / ("x" * 110))
    assert done.returncode == 1
    assert_one_line(done, "longer than the 107", "SWEEPSCOPE_RUN")


@pytest.mark.parametrize("command", ["status", "stop", "daemon", "writer", "worker", "viewer", "estimate"])
def test_all_commands_refuse_it_alike(tmp_path, command):
    done = sweepscope(command, run_dir=tmp_path / ("x" * 110))
    assert done.returncode == 1
    assert_one_line(done, "longer than the 107")


def test_another_firmware_is_one_sentence(run_dir, pictures):
    with SerialDevice(grbl) as device:
        stage = {"SWEEPSCOPE_STAGE__KIND": "uno", "SWEEPSCOPE_STAGE__PORT": device.port}
        done = daemon(run_dir, **REPLAY, **stage, SWEEPSCOPE_CAMERA__DEVICE=pictures)
    assert done.returncode == 1
    assert_one_line(done, "GRBL 1.1h", "nothing has moved")


@pytest.mark.parametrize("device", ["", "/nonexistent/pictures"])
def test_a_replay_without_pictures_is_one_sentence(run_dir, device):
    done = daemon(run_dir, **REPLAY, SWEEPSCOPE_CAMERA__DEVICE=device)
    assert done.returncode == 1
    assert_one_line(done)


def test_a_webcam_that_is_not_there_is_told_at_the_end(run_dir):
    done = daemon(run_dir, SWEEPSCOPE_CAMERA__KIND="uvc", SWEEPSCOPE_CAMERA__DEVICE="/dev/video99")
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "/dev/video99" in done.stderr.splitlines()[-1]  # OpenCV has its own lines above


@pytest.mark.parametrize("producer", ["", "/nonexistent/maker.cti"])
def test_a_missing_producer_is_one_sentence(run_dir, producer):
    need_genicam()
    camera = {"SWEEPSCOPE_CAMERA__KIND": "genicam", "SWEEPSCOPE_CAMERA__PRODUCER": producer}
    done = daemon(run_dir, **camera, SWEEPSCOPE_STAGE__KIND="uno", GENICAM_GENTL64_PATH="")
    assert done.returncode == 1
    assert_one_line(done, "camera.producer")
