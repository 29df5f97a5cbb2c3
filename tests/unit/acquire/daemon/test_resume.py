"""Resuming a scan is refused before anything moves where the rig is set differently, and the scan is released."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from acquire.cameras.protocol import CameraInfo, CameraLostError, CameraSettings
from acquire.contract.config.load import LoadedConfig, load_config
from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Command, FrameFormat
from acquire.contract.process.run_dir import FileLock
from acquire.contract.scan_data.dataset_names import OWNER_LOCK_NAME
from acquire.contract.states import Outcome
from acquire.daemon.resume import prepare_resume, unfinished_scan
from acquire.daemon.service import Daemon
from acquire.rigs.base import Rig
from acquire.stages.protocol import StageInfo, StageStatus
from acquire.writer.scan_file import create_scan
from tests.fakes.scans.frames import image_of, pixels_of, start_of

SMALL = FrameFormat(width=16, height=16, bit_depth=8)
COUNT = 8


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Interrupted after 5 of 8 frames; taken on the fly over 0..21 microsteps."""
    start = start_of(tmp_path / "a", COUNT, SMALL)
    start = msgspec.structs.replace(start, plan=msgspec.structs.replace(start.plan, mode="fly"))
    made = create_scan(tmp_path / "a", start)
    for k in range(5):
        pixels = pixels_of(k, COUNT, SMALL)
        made.write_frame(image_of(k, pixels, start), pixels)
    made.mark_outcome(Outcome.INTERRUPTED, "test")
    made.close()
    return tmp_path / "a"


def config(**changes: object) -> LoadedConfig:
    settings = {"camera.width": 16, "camera.height": 16} | {name.replace("__", "."): v for name, v in changes.items()}
    return load_config(overrides=settings, environ={})


def assert_released(scan: Path) -> None:
    FileLock(scan / OWNER_LOCK_NAME, "this scan").release()


def test_a_scan_is_gone_on_with_where_the_rig_is_set_as_it_was(scan):
    prepared, camera = prepare_resume(scan, config(), SMALL)
    assert prepared.settings.resume is not None and prepared.settings.resume.last_frame == 4
    assert camera.exposure_ms == prepared.start.plan.exposure_ms
    prepared.lock.release()


def test_the_newest_scan_is_unfinished_where_it_was_interrupted_and_nobody_works_on_it(scan, tmp_path):
    found = unfinished_scan(tmp_path)
    assert found is not None and (found.folder, found.committed, found.plan.count) == (scan, 5, COUNT)
    lock = FileLock(scan / OWNER_LOCK_NAME, "this scan")
    assert unfinished_scan(tmp_path) is None
    lock.release()
    with closing(create_scan(tmp_path / "b", start_of(tmp_path / "b", COUNT, SMALL))) as newer:
        newer.seal(Outcome.ABORTED)
    os.utime(newer.path, ns=(2**62, 2**62))
    assert unfinished_scan(tmp_path) is None


@pytest.mark.parametrize("spoil", [lambda path: path.write_bytes(b"HDF"), lambda path: os.truncate(path, 5000)])
def test_a_folder_that_cannot_be_read_keeps_no_daemon_from_starting(scan, tmp_path, spoil):
    spoil(scan / "scan.partial.h5")
    assert unfinished_scan(tmp_path) is None and unfinished_scan(tmp_path / "nowhere") is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stage__travel_max_steps": 15}, "position 21 is outside the stage's travel 0..15"),
        ({"stage__um_per_microstep": 3.0}, "3.175 um per microstep, the stage is set to 3:"),
        ({"limits__window_bytes": 1_000_000}, "window"),
    ],
)
def test_a_stage_or_a_memory_that_is_set_differently_is_refused_and_the_scan_is_released(
    scan, changes, words, monkeypatch
):
    if "limits__window_bytes" in changes:
        monkeypatch.setattr("acquire.daemon.scan_setup.slots_for", lambda *_args: 0)
    with pytest.raises(CommandRefusedError, match=words):
        prepare_resume(scan, config(**changes), SMALL)
    assert_released(scan)


class Device:
    """A stage or a camera that does nothing."""

    modes, lost = ("step", "fly"), False

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def open(self, _sink):
        return StageInfo(kind="x", modes=self.modes) if self.kind == "stage" else CameraInfo(kind="x", format=SMALL)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        if self.lost:
            raise CameraLostError("the camera does not answer")
        return settings

    def status(self) -> StageStatus:
        return StageStatus(0, True, "z", False, 0, False)

    def __getattr__(self, _step: str):
        return lambda *_args, **_kwargs: None


@pytest.fixture
def daemon(run_dir, tmp_path):
    made = Daemon(config(storage__data_dir=str(tmp_path)), run_dir, Rig(Device("stage"), Device("camera")))
    made.open()
    yield made
    made.close()


def resume(daemon, scan):
    command = Command(request_id="1", name="resume_scan", args={"path": str(scan)})
    return daemon.commands.serve(command, daemon.clock.now_ns())


def test_a_scan_on_the_fly_is_not_gone_on_with_by_a_stage_that_must_stand_still(daemon, scan):
    daemon.rig.stage_info = msgspec.structs.replace(daemon.rig.stage_info, modes=("step",))
    with pytest.raises(CommandRefusedError, match="not in fly mode"):
        resume(daemon, scan)
    assert_released(scan)


def test_a_camera_that_does_not_answer_leaves_the_scan_to_be_resumed_another_time(daemon, scan):
    daemon.rig.camera.lost = True
    with pytest.raises(CameraLostError):
        resume(daemon, scan)
    assert_released(scan)
    daemon.rig.camera.lost = False
    assert resume(daemon, scan)["expected"] == COUNT
