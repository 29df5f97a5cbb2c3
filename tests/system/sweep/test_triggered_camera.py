# ruff: noqa: E402 - the driver cannot be imported where the library is missing
"""A GenICam camera with a TRIGGER wire, stood in for by a fake: its driver, and whole sweeps through it."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from tests.needs import need_genicam

need_genicam(module=True)

from acquire.cameras import genicam
from acquire.cameras.free_running import FreeRunningCamera
from acquire.cameras.genicam import GenicamCamera, GenicamDevice
from acquire.cameras.protocol import CameraFrame, CameraGone, CameraLostError, CameraSettings
from acquire.contract.config.model import CameraConfig, RigConfig, StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.contract.scan_data.reader import ScanReader
from acquire.rigs.base import Rig
from acquire.stages.protocol import StageEvent, StageInfo, StageSink, Triggered
from acquire.stages.simulated import SimulatedStage
from tests.fakes.triggered_genicam import CLOCK_AHEAD_NS, FIRST_ID, LINE, SERIAL, TriggeredCamera
from tests.system.appliance import Appliance
from tests.unit.rig_in_process import RigInProcess
from tests.waiting import next_of

WIDTH, HEIGHT = 64, 48
CONFIG = CameraConfig(kind="genicam", device=SERIAL, producer=__file__, trigger=LINE, width=WIDTH, height=HEIGHT)
S = 1_000_000_000


def picture(position_steps: float) -> np.ndarray:
    """Another one at each place, though in the same light."""
    pixels = np.random.default_rng(1).integers(0, 200, (HEIGHT, WIDTH), np.uint8)
    pixels[0, :8] = np.frombuffer(np.float64(position_steps).tobytes(), np.uint8)
    return pixels


@pytest.fixture
def device(monkeypatch) -> TriggeredCamera:
    made = TriggeredCamera(picture, WIDTH, HEIGHT)
    monkeypatch.setattr(genicam, "Harvester", made.harvester)
    monkeypatch.setattr(genicam, "_QUIET_S", 0.2)
    monkeypatch.setattr("acquire.cameras.reader_thread.AGAIN_S", 0.05)
    return made


# ---- the driver ----


@pytest.fixture
def driver(device):
    camera, events = GenicamCamera(CONFIG), queue.Queue()
    camera.open(events.put)
    camera.configure(CameraSettings(7.0, 3.0, 0.0))
    yield camera, events
    camera.close()


def frames(events: queue.Queue[Any], count: int) -> list[CameraFrame]:
    return [next_of(events) for _ in range(count)]


def test_once_armed_each_pulse_of_the_wire_gives_its_own_picture_and_ids_that_count(device, driver):
    camera, events = driver
    device.pulse(1, S)
    RigInProcess.until_true(device.filled.empty, "the frame is read")
    fetches = device.fetches
    RigInProcess.until_true(lambda: device.fetches > fetches, "the next one is waited for")
    camera.arm()
    for k in (2, 3):
        device.pulse(k, k * S)
    found = frames(events, 2)
    assert [frame.camera_frame_id for frame in found] == [FIRST_ID + 1, FIRST_ID + 2]
    assert np.array_equal(found[0].pixels, picture(2)) and np.array_equal(found[1].pixels, picture(3))


def test_its_own_clock_is_told_once_it_was_seen_to_run_like_the_hosts(device, driver):
    camera, events = driver
    camera.arm()
    began_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    device.pulse(0, began_ns)
    assert frames(events, 1)[0].camera_ns == 0
    while (now_ns := time.clock_gettime_ns(time.CLOCK_MONOTONIC)) < began_ns + 0.3 * S:
        time.sleep(0.01)
    device.pulse(1, now_ns)
    assert frames(events, 1)[0].camera_ns == now_ns + CLOCK_AHEAD_NS


def test_a_snap_is_one_picture_by_software_and_the_wire_is_heard_again_afterwards(device, driver):
    camera, events = driver
    device.where = lambda: 77.0
    camera.snap()
    assert np.array_equal(frames(events, 1)[0].pixels, picture(77))
    camera.arm()
    device.pulse(5, S)
    assert np.array_equal(frames(events, 1)[0].pixels, picture(5))


@pytest.mark.parametrize(("how", "ids"), [("lost", [0, 2]), ("incomplete", [0, 2]), ("unseen", [0, 1])])
def test_a_frame_that_is_lost_or_spoilt_leaves_a_gap_in_the_ids_and_a_pulse_that_is_not_seen_leaves_none(
    device, driver, how, ids
):
    camera, events = driver
    camera.arm()
    getattr(device, how).add(1)
    for k in range(3):
        device.pulse(k, k * S)
    found = frames(events, 2)
    assert [frame.camera_frame_id - FIRST_ID for frame in found] == ids
    assert np.array_equal(found[1].pixels, picture(2))


@pytest.mark.parametrize("silent", [False, True])
def test_a_cable_that_is_pulled_is_told_in_words_and_the_camera_is_set_up_as_it_was_when_it_is_back(
    device, driver, silent
):
    camera, events = driver
    camera.arm()
    device.vanish(silent=silent)
    gone = next_of(events)
    assert isinstance(gone, CameraGone) and not gone.back and "no device" in gone.detail and "x.cpp" not in gone.detail
    with pytest.raises(CameraLostError, match="the camera"):
        camera.snap()
    with pytest.raises(CameraLostError, match="the camera"):
        camera.configure(CameraSettings(1.0, 0.0, 0.0))
    device.come_back()
    assert next_of(events) == CameraGone("", back=True)
    assert device.nodes["ExposureTime"].value == 7000.0 and device.opened == 2
    fetches = device.fetches
    RigInProcess.until_true(lambda: device.fetches > fetches + 2, "it is read again")
    assert events.empty(), "a command that was refused while it was away tells of it once more"
    device.pulse(9, S)
    assert np.array_equal(frames(events, 1)[0].pixels, picture(9))


@pytest.mark.parametrize(("silent", "listed"), [(False, False), (False, True), (True, False)])
def test_a_camera_that_runs_freely_is_told_as_gone_looked_for_and_serves_shots_when_it_is_back(
    device, monkeypatch, silent, listed
):
    monkeypatch.setattr(genicam, "_GRAB_S", 0.3)
    camera, events = FreeRunningCamera(GenicamDevice(replace(CONFIG, trigger="host"))), queue.Queue()
    camera.open(events.put)
    try:
        camera.configure(CameraSettings(7.0, 3.0, 0.0))
        device.still_listed = listed
        device.vanish(silent=silent)
        gone = next_of(events)
        assert isinstance(gone, CameraGone) and not gone.back and gone.detail
        looked = device.looked
        RigInProcess.until_true(lambda: device.looked > looked + 1, "it is looked for more than once")
        device.come_back()
        assert next_of(events) == CameraGone("", back=True)
        camera.snap()
        assert np.array_equal(frames(events, 1)[0].pixels, picture(0))
        assert device.nodes["ExposureTime"].value == 7000.0
    finally:
        camera.close()


# ---- whole sweeps ----


FAST = {
    "camera.kind": "genicam", "camera.device": SERIAL, "camera.producer": __file__, "camera.trigger": LINE,
    "camera.width": WIDTH, "camera.height": HEIGHT, "camera.exposure_ms": 1.0, "camera.frame_timeout_ms": 300.0,
    "simulation.time_scale": 1.0, "sweep.max_rate_hz": 200.0, "stage.settle_ms": 0.0,
    "sweep.last_steps": 1188, "stage.acceleration_steps_per_s2": 1e6, "stage.max_rate_steps_per_s": 20_000.0,
    "limits.writer_start_s": 60.0, "limits.stop_s": 5.0, "camera.away_s": 1.0,
}  # fmt: skip
"""100 frames, one every 5 ms."""


@pytest.fixture(scope="module")
def writer() -> Iterator[Appliance]:
    """One for all sweeps: it outlives the daemons."""
    with TemporaryDirectory(prefix="ss-") as run, TemporaryDirectory(prefix="ss-data-") as data:
        appliance = Appliance(Path(run), Path(data))
        appliance.start("writer")
        yield appliance
        appliance.close()


class SlowlyTold(SimulatedStage):
    """The simulated stage; its word of a trigger may come after the pulse, as one that is asked for does."""

    def __init__(self, config: StageConfig, device: TriggeredCamera) -> None:
        super().__init__(config, lambda *_shot: None)
        self._device = device

    def open(self, sink: StageSink) -> StageInfo:
        def tell(event: StageEvent) -> None:
            late_s = self._device.words_late_s
            if not late_s:
                sink(event)
            if isinstance(event, Triggered):
                middle_um = event.position_um
                place = event.position_steps if middle_um is None else middle_um / self._config.um_per_microstep
                self._device.pulse(place, event.at_mono_ns)
            if late_s:
                time.sleep(late_s)
                sink(event)

        return super().open(tell)


@pytest.fixture
def rig(device, writer):
    def make(config: RigConfig) -> Rig:
        stage = SlowlyTold(config.stage, device)
        device.where = lambda: stage.status().position_steps
        return Rig(stage, GenicamCamera(config.camera))

    with RigInProcess(writer.run_dir, writer.data_dir, FAST, make) as made:
        made.until(lambda s: s["writer_alive"], "the writer is there")
        yield made


def ended(rig: RigInProcess) -> dict[str, Any]:
    return rig.until(lambda s: s["state"] == "idle" and s["outcome"] not in ("", "running"), "the sweep ends")


def assert_as_the_device_produced(folder: Path, device: TriggeredCamera) -> int:
    """Each frame that is there is what the camera exposed at the pulse that the file names; returns how many."""
    with ScanReader(folder) as reader:
        present = np.flatnonzero(reader.present())
        triggers, positions = reader.field("trigger_id"), reader.field("position_steps")
        for k in map(int, present):
            assert positions[k] == 12 * k
            assert np.array_equal(reader.frame(k), device.produced[int(triggers[k])]), f"frame {k} is another one"
        return len(present)


@pytest.mark.parametrize("mode", ["step", "fly"])
def test_a_sweep_in_which_frames_are_lost_spoilt_or_not_even_exposed_is_saved_as_the_camera_saw_it(rig, device, mode):
    device.unseen, device.lost, device.incomplete = {0, 20, 61, 62}, {30, 31}, {50}
    scan = rig.ask("scan", name="test", purpose="raw", mode=mode)
    status = ended(rig)
    assert assert_as_the_device_produced(Path(scan["path"]), device) == 100
    assert "SAVED" in status["message"] and status["counters"]["lost"] >= 7


@pytest.mark.parametrize("mode", ["step", "fly"])
def test_frames_that_overtake_the_word_of_their_triggers_are_waited_with(rig, device, mode):
    device.words_late_s = 0.02
    device.unseen = {4}
    scan = rig.ask("scan", name="test", purpose="raw", mode=mode, last_steps=240)
    status = ended(rig)
    assert assert_as_the_device_produced(Path(scan["path"]), device) == 21 and "SAVED" in status["message"]


def test_on_the_fly_a_camera_without_a_clock_is_fired_one_frame_at_a_time(rig, device):
    device._has_clock = False
    device.unseen = {0, 5}
    scan = rig.ask("scan", name="test", purpose="raw", mode="fly", last_steps=120)
    ended(rig)
    assert assert_as_the_device_produced(Path(scan["path"]), device) == 11


def test_a_camera_that_goes_away_is_waited_for_and_the_sweep_goes_on_when_it_is_back(rig, device):
    scan = rig.ask("scan", name="test", purpose="raw")
    rig.until(lambda s: s["committed"] > 10, "it sweeps")
    device.vanish()
    held = rig.until(lambda s: s["hold_reason"] == "camera away", "it holds")
    assert held["faults"][0]["code"] == "F18" and "no device" in held["faults"][0]["happened"]
    device.come_back()
    status = ended(rig)
    assert assert_as_the_device_produced(Path(scan["path"]), device) == 100 and "SAVED" in status["message"]


def test_a_camera_that_stays_away_leaves_the_scan_interrupted_and_a_new_one_is_refused(rig, device):
    scan = rig.ask("scan", name="test", purpose="raw")
    rig.until(lambda s: s["committed"] > 10, "it sweeps")
    device.vanish(silent=True)
    status = ended(rig)
    there = assert_as_the_device_produced(Path(scan["path"]), device)
    assert status["outcome"] == "interrupted" and 10 < there < 100 and status["missing"] == 100 - there
    with ScanReader(Path(scan["path"])) as reader:
        assert "F18" in str(reader.scalar("reason"))
    with pytest.raises(CommandRefusedError, match="camera is away"):
        rig.ask("scan", name="again", purpose="raw")
