"""The daemon between its devices: alarms outside of a scan, devices that refuse, folders that vanish."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from acquire.cameras.protocol import CameraFrame, CameraGone, CameraInfo, CameraLostError, CameraSettings
from acquire.contract.config.load import load_config
from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Command, FrameFormat
from acquire.contract.states import Outcome, State
from acquire.daemon.scan_runner import RunningScan
from acquire.daemon.service import Daemon
from acquire.rigs.base import Rig
from acquire.stages.protocol import Alarm, StageInfo, StageStatus, Triggered
from acquire.sweep.events import Tick, WriterReady
from tests.unit.rig_in_process import AdjustableClock

NOW_NS = 10**15


class Device:
    """Notes what is asked of it; the calls in ``refusing`` raise."""

    def __init__(self, kind: str) -> None:
        self.kind, self.calls, self.refusing, self.lost = kind, [], set(), set()

    def open(self, _sink):
        small = FrameFormat(width=16, height=16, bit_depth=8)
        return (
            StageInfo(kind="x", modes=("step", "fly")) if self.kind == "stage" else CameraInfo(kind="x", format=small)
        )

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def status(self) -> StageStatus:
        return StageStatus(0, True, "z", False, 0, False)

    def __getattr__(self, step: str):
        def call(*_args, **_kwargs) -> None:
            self.calls.append(step)
            if step in self.refusing:
                raise CommandRefusedError(f"{step} is refused")
            if step in self.lost:
                raise CameraLostError(f"{step} was not answered")

        return call


@pytest.fixture
def daemon(run_dir, tmp_path):
    config = load_config(environ={"SWEEPSCOPE_STORAGE__DATA_DIR": str(tmp_path / "scans")})
    made = Daemon(config, run_dir, Rig(Device("stage"), Device("camera")))
    made.open()
    yield made
    made.close()


def serve(daemon, name, /, **args):
    """One command, as the command lane hands it over."""
    return daemon.commands.serve(Command(request_id="1", name=name, args=args), NOW_NS)


@pytest.fixture
def running(daemon):
    """A scan that waits for its writer."""
    serve(daemon, "scan", name="test", purpose="raw")
    return daemon.scans.running


def test_after_an_alarm_outside_of_a_scan_the_rig_can_be_used_again_without_a_restart(daemon):
    serve(daemon, "goto", position_steps=10)
    daemon.take(Alarm("F13", "reset", 0, position_trusted=False), NOW_NS)
    assert daemon.board.state is State.FAULT and daemon.board.faults[0].code == "F13"
    with pytest.raises(CommandRefusedError, match="acknowledge"):
        serve(daemon, "home")
    serve(daemon, "acknowledge")
    serve(daemon, "home")
    assert daemon.rig.stage.calls[-1] == "home" and daemon.board.state is State.HOMING


@pytest.mark.parametrize("also", [set(), {"disarm", "stop"}])
def test_a_device_that_refuses_stops_the_stage_and_ends_the_sweep(daemon, running, also):
    daemon.rig.camera.refusing = {"snap"} | also
    daemon.rig.stage.refusing = also
    running.handle(WriterReady(reserved=True, came_back=False), NOW_NS)
    assert "stop" in daemon.rig.stage.calls
    assert running.sweep.outcome is Outcome.INTERRUPTED
    assert [fault.code for fault in daemon.board.faults] == ["F12"]


def test_a_camera_that_does_not_answer_is_waited_for_and_neither_ends_the_sweep_nor_the_daemon(daemon, running):
    daemon.rig.camera.lost = {"snap"}
    running.handle(WriterReady(reserved=True, came_back=False), NOW_NS)
    assert running.sweep.outcome is Outcome.RUNNING and running.sweep.away
    assert [fault.code for fault in daemon.board.faults] == ["F18"]


class Lane:
    """Takes frames as the frame sender does, and sends nothing."""

    def __init__(self) -> None:
        self.offered = []

    def begin(self, _start) -> None: ...

    def send(self, *_args) -> bool:
        return True

    def offer(self, image, _pixels) -> None:
        self.offered.append((image.role, image.frame_index))


def test_a_frame_is_sent_although_the_stage_refused_to_stop_for_the_lost_one_before_it(daemon):
    serve(daemon, "scan", name="test", purpose="raw", mode="fly")
    ignore, lane, rig = lambda _what: None, Lane(), Rig(Device("stage"), Device("camera"))
    rig.stage.refusing = {"stop"}
    prepared = daemon.scans.running.prepared
    scan = RunningScan(prepared, rig, lane, lane, on_fault=ignore, on_message=ignore, on_view=ignore)
    plan, frame = prepared.settings.plan, np.zeros((16, 16), np.uint8)
    scan.handle(WriterReady(reserved=True, came_back=False), NOW_NS)
    scan.handle(CameraFrame(frame, 1, NOW_NS), NOW_NS)
    now_ns = NOW_NS + 10**12
    scan.handle(Tick(), now_ns)
    shots = [now_ns + k * 10**9 for k in range(3)]
    for k, at_ns in enumerate(shots):
        scan.handle(Triggered(k, k, plan.position_steps(k), at_mono_ns=at_ns), now_ns)
    for camera_frame_id, k in ((2, 0), (4, 2)):
        scan.handle(CameraFrame(frame, camera_frame_id, shots[k]), now_ns)
    assert lane.offered == [("ambient", 0), ("sweep", 0), ("sweep", 2)]
    assert scan.sweep.outcome is Outcome.INTERRUPTED and sorted(scan.sweep.window.unacked) == sorted(lane.offered)


def test_no_scan_begins_while_the_camera_is_away(daemon):
    daemon.take(CameraGone("pulled"), NOW_NS)
    with pytest.raises(CommandRefusedError, match="away"):
        serve(daemon, "scan", name="test", purpose="raw")
    daemon.take(CameraGone("", back=True), NOW_NS)
    assert serve(daemon, "scan", name="test", purpose="raw")["expected"]


def test_a_scan_whose_folder_vanished_ends_and_the_next_one_begins(start_rig):
    clock = AdjustableClock()
    rig = start_rig(clock=clock)
    clock.freeze()  # the writer, which there is none of, is waited for
    folder = Path(rig.ask("scan", purpose="raw")["path"])

    def gone() -> bool:
        shutil.rmtree(folder, ignore_errors=True)  # the ground truth may be written meanwhile
        return not folder.exists()

    rig.until_true(gone, "the folder vanishes")
    clock.thaw()
    status = rig.until(lambda now: now["state"] == "idle", "the scan is over")
    assert "F05" in {fault["code"] for fault in status["faults"]}, "beside F02, where the machine is busy"
    assert rig.ask("scan", purpose="raw")["expected"] == status["expected"]


def test_a_disk_that_fails_under_a_request_is_an_answer_and_not_the_end(start_rig, monkeypatch):
    def fails(*_args):
        raise OSError(5, "Input/output error")

    rig = start_rig()
    monkeypatch.setattr(shutil, "disk_usage", fails)
    with pytest.raises(CommandRefusedError, match="scan failed: .*Input/output error"):
        rig.ask("scan", name="test", purpose="raw")
    assert rig.status()["state"] == "idle"
