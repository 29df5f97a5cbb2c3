"""Real camera drivers: which picture a shot gets, what is refused, and how a camera that goes away is told."""

from __future__ import annotations

import queue
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from acquire.cameras.clock_check import CameraClock
from acquire.cameras.free_running import FreeRunningCamera
from acquire.cameras.protocol import CameraFrame, CameraGone, CameraSettings
from acquire.cameras.replay import ReplayCamera
from acquire.cameras.uvc import UvcSource
from acquire.contract.config.model import CameraConfig, RigConfig, StageConfig, SweepConfig
from acquire.contract.errors import ConfigError, ScanFileError, SweepscopeError
from acquire.contract.messaging.messages import FrameFormat
from acquire.rigs.base import HostFiredRig
from acquire.rigs.build import build_rig
from acquire.stages.protocol import Segment, SegmentDone
from tests.needs import need_genicam
from tests.waiting import WALL_CLOCK_S, next_of, wait_for

SETTINGS = CameraSettings(10.0, 0.0, 0.0)


def now_ns() -> int:
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


# ---- a camera that runs freely ----


class Source:
    """Pictures that the test hands over one by one; None ends them."""

    kind = "test"

    def __init__(self) -> None:
        self.pictures: queue.Queue[int | None] = queue.Queue()
        self.closed = False

    def open(self) -> FrameFormat:
        return FrameFormat(2, 2, 8)

    def close(self) -> None:
        self.closed = True

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self.settings = settings
        return settings

    def limits(self) -> dict[str, tuple[float, float]]:
        return {"gain": (0.0, 12.0)}

    def grab(self) -> np.ndarray:
        found = self.pictures.get(timeout=WALL_CLOCK_S)
        if found is None:
            raise SweepscopeError("the cable was pulled")
        return np.full((2, 2), found, np.uint8)


@pytest.fixture
def free():
    source = Source()
    camera, events = FreeRunningCamera(source), queue.Queue()
    info = camera.open(events.put)
    yield camera, source, events, info
    source.pictures.put(None)
    camera.close()


def through(source: Source, *values: int) -> None:
    """Hand pictures over and wait until the camera asks for the next one."""
    for value in values:
        source.pictures.put(value)
    wait_for(lambda: not source.pictures.qsize(), "the camera asks for the next one")


def test_a_shot_gets_the_first_picture_that_surely_began_after_it(free):
    camera, source, events, _ = free
    camera.configure(CameraSettings(0.01, 0.0, 0.0))
    camera.arm()
    through(source, 1, 2)
    camera.fire(now_ns(), 30)
    through(source, 3, 4, 5)
    frame = next_of(events)
    assert frame.pixels[0, 0] == 4, "picture 3 had begun before the shot"
    with pytest.raises(queue.Empty):
        events.get(timeout=0.05)


def test_a_long_exposure_may_have_begun_long_before_so_it_is_passed_over(free):
    camera, source, events, _ = free
    camera.configure(CameraSettings(60_000.0, 0.0, 0.0))
    camera.arm()
    camera.fire(now_ns(), 0)
    through(source, 1, 2, 3)
    with pytest.raises(queue.Empty):
        events.get(timeout=0.05)


def test_nothing_is_delivered_before_arming_but_what_was_snapped(free):
    camera, source, events, info = free
    camera.configure(CameraSettings(0.01, 0.0, 0.0))
    camera.fire(now_ns(), 0)
    through(source, 1, 2, 3)
    camera.snap()
    through(source, 4, 5, 6)
    assert isinstance(next_of(events), CameraFrame) and events.empty()
    assert not info.counts_frames and info.limits == {"gain": (0.0, 12.0)}


def test_a_source_that_ends_is_told_as_a_camera_that_is_gone(free):
    _, source, events, _ = free
    source.pictures.put(None)
    assert next_of(events) == CameraGone("the cable was pulled")


def test_a_source_that_is_there_again_is_opened_and_set_up_as_it_was_and_serves_shots(free, monkeypatch):
    monkeypatch.setattr("acquire.cameras.reader_thread.AGAIN_S", 0.01)
    camera, source, events, _ = free
    camera.configure(CameraSettings(0.01, 0.0, 0.0))
    camera.arm()
    source.settings = None
    source.pictures.put(None)
    assert not next_of(events).back
    assert next_of(events) == CameraGone("", back=True)
    assert source.settings == CameraSettings(0.01, 0.0, 0.0)
    camera.fire(now_ns(), 0)
    through(source, 1, 2, 3, 4)
    assert isinstance(next_of(events), CameraFrame)


def test_a_shot_that_waited_when_the_source_went_away_gets_no_picture_of_later(free, monkeypatch):
    monkeypatch.setattr("acquire.cameras.reader_thread.AGAIN_S", 0.01)
    camera, source, events, _ = free
    camera.configure(CameraSettings(0.01, 0.0, 0.0))
    camera.arm()
    camera.fire(now_ns(), 0)
    source.pictures.put(None)
    assert not next_of(events).back
    assert next_of(events) == CameraGone("", back=True)
    through(source, 1, 2, 3)
    camera.fire(now_ns(), 0)
    through(source, 4, 5, 6)
    assert next_of(events).pixels[0, 0] >= 4


# ---- webcams ----


class Capture:
    """OpenCV's capture as far as the driver uses it."""

    def __init__(self, *, opened: bool = True, shape: tuple[int, int] = (24, 32)) -> None:
        self.opened, self.shape, self.set_to, self.pictures = opened, shape, {}, 1000

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return self.opened

    def set(self, key: int, value: float) -> bool:
        self.set_to[key] = value
        return True

    def get(self, key: int) -> float:
        return self.set_to.get(key, 0.0)

    def read(self):
        self.pictures -= 1
        blue = np.zeros((*self.shape, 3), np.uint8)
        blue[..., 0] = 200
        return (True, blue) if self.pictures >= 0 else (False, None)

    def release(self) -> None:
        self.opened = False


WEBCAM = CameraConfig(kind="uvc", width=32, height=24)


def test_a_webcam_gives_rgb_and_takes_its_exposure_by_hand():
    capture = Capture()
    source = UvcSource(WEBCAM, lambda _device: capture)
    assert source.open() == FrameFormat(32, 24, 8, "rgb")
    assert source.configure(SETTINGS) == SETTINGS
    assert capture.set_to[cv2.CAP_PROP_EXPOSURE] == 100 and capture.set_to[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert source.grab()[0, 0].tolist() == [0, 0, 200]
    source.close()
    assert not capture.opened


@pytest.mark.parametrize(
    ("capture", "words"),
    [(Capture(opened=False), "no camera answers at /dev/video0"), (Capture(shape=(48, 64)), "64 x 48, not 32 x 24")],
)
def test_a_webcam_that_is_not_there_or_of_another_size_is_refused(capture, words):
    with pytest.raises(ConfigError, match=words):
        UvcSource(WEBCAM, lambda _device: capture).open()


def test_a_webcam_that_is_pulled_is_gone():
    capture = Capture()
    source = UvcSource(WEBCAM, lambda _device: capture)
    source.open()
    capture.pictures = 0
    with pytest.raises(SweepscopeError, match="gone"):
        source.grab()


# ---- a recording ----


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for k in range(5):
        cv2.imwrite(str(folder / f"frame{k}.png"), np.full((24, 32), 10 * k, np.uint8))
    return folder


def recording(device: Path | str) -> RigConfig:
    camera = CameraConfig(kind="replay", device=str(device), width=32, height=24)
    return RigConfig(camera=camera, sweep=SweepConfig(first_steps=30, last_steps=18, steps_per_frame=3))


def test_a_recording_answers_each_place_with_its_picture_and_the_nearest_beside_its_ends(pictures):
    camera, events = ReplayCamera(recording(pictures)), queue.Queue()
    assert camera.open(events.put).format == FrameFormat(32, 24, 8)
    camera.arm()
    for place in (30, 24, 18, 60, -60):
        camera.fire(now_ns(), place)
    assert [next_of(events).pixels[0, 0] for _ in range(5)] == [0, 20, 40, 0, 40]
    camera.close()


def test_a_sweep_over_a_recording_passes_each_shot_on_and_stands_still_for_it(pictures):
    rig = build_rig(replace(recording(pictures), stage=StageConfig()))
    stage_events, frames = queue.Queue(), queue.Queue()
    assert isinstance(rig, HostFiredRig)
    rig.camera.open(frames.put)
    assert rig.open_stage(stage_events.put).modes == ("step",)
    rig.camera.arm()
    rig.stage.begin_segment(Segment(30, -3, 5), 4)
    assert [next_of(frames).pixels[0, 0] for _ in range(5)] == [0, 10, 20, 30, 40]
    assert [next_of(stage_events) for _ in range(6)][-1] == SegmentDone(18)
    rig.stage.close()
    rig.camera.close()


def test_a_recording_must_be_named_and_readable(tmp_path):
    with pytest.raises(ConfigError, match="camera.device"):
        ReplayCamera(recording("")).open(lambda _event: None)
    with pytest.raises(ScanFileError, match="no-such"):
        ReplayCamera(recording(tmp_path / "no-such")).open(lambda _event: None)


def test_a_recording_with_a_missing_picture_is_refused_and_import_is_named(pictures):
    (pictures / "frame2.png").unlink()
    with pytest.raises(ScanFileError, match=r"frame2 is missing between frame1 and frame3.*sweepscope import") as error:
        ReplayCamera(recording(pictures)).open(lambda _event: None)
    assert "--as-is" not in str(error.value), "that is an option of import"


# ---- a camera's own clock ----


@pytest.mark.parametrize(("ns_per_count", "believed"), [(1, True), (8, False), (0, False)])
def test_a_clock_that_counts_otherwise_than_it_says_is_never_believed(ns_per_count, believed):
    clock, second = CameraClock(), 10**9
    told = [
        clock.believed(7 * second + k * second * ns_per_count // 4, 99 * second + k * second // 4) for k in range(5)
    ]
    assert told[0] == 0 and [value > 0 for value in told[1:]] == [believed] * 4


# ---- GenICam, with the simulated cameras of a real producer ----


@pytest.fixture
def red() -> CameraConfig:
    """The first simulated camera of the library's own producer."""
    need_genicam()
    import genicam

    producer = next(Path(genicam.__file__).parent.glob("*.cti"))
    return CameraConfig(kind="genicam", device="0", producer=str(producer), width=400, height=400, trigger="host")


def test_a_genicam_camera_delivers_whole_pictures_with_ids_that_count(red):
    from acquire.cameras.genicam import GenicamDevice

    device = GenicamDevice(red)
    assert device.open() == FrameFormat(400, 400, 8, "rgb")
    try:
        frames = [device.fetch(5.0) for _ in range(3)]
    finally:
        device.close()
    ids = [frame.camera_frame_id for frame in frames]
    assert ids == [ids[0], ids[0] + 1, ids[0] + 2] and device.counts_frames
    assert all(frame.pixels.shape == (400, 400, 3) and frame.pixels.any() for frame in frames)


def test_a_genicam_camera_that_runs_freely_serves_shots(red):
    rig = build_rig(RigConfig(camera=red))
    frames = queue.Queue()
    assert rig.camera.open(frames.put).kind == "genicam"
    rig.camera.arm()
    rig.camera.fire(now_ns(), 0)
    assert next_of(frames).pixels.shape == (400, 400, 3)
    rig.camera.close()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"device": "77"}, "no camera with serial number 77: there are 0, 1, 2"),
        ({"device": ""}, "must name one camera"),
        ({"producer": "/nowhere.cti"}, "is no file"),
        ({"width": 16_000}, "400 x 400, not 16000 x 400"),
        ({"trigger": "Line1"}, "no trigger input Line1"),
    ],
)
def test_a_genicam_camera_that_cannot_serve_is_refused_with_the_mend(red, change, words):
    from acquire.cameras.genicam import GenicamDevice

    config = replace(red, **change)
    with pytest.raises(ConfigError, match=words):
        GenicamDevice(config).open("" if config.trigger == "host" else config.trigger)


def test_without_a_producer_the_refusal_says_where_to_get_one(red, monkeypatch):
    from acquire.cameras.genicam import GenicamDevice

    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    with pytest.raises(ConfigError, match="install the camera maker's"):
        GenicamDevice(replace(red, producer="")).open()


@pytest.mark.parametrize("trigger", ["host", "Line1"])
def test_where_genicams_library_cannot_be_loaded_the_refusal_names_the_package(monkeypatch, trigger):
    monkeypatch.delitem(sys.modules, "acquire.cameras.genicam", raising=False)
    monkeypatch.delattr("acquire.cameras.genicam", raising=False)
    monkeypatch.setitem(sys.modules, "genicam.genapi", None)
    config = RigConfig(stage=StageConfig(kind="uno"), camera=CameraConfig(kind="genicam", trigger=trigger))
    with pytest.raises(ConfigError, match=r"package libpython3\.\d+: .*genicam"):
        build_rig(config)


# ---- devices that cannot work together ----


@pytest.mark.parametrize(
    ("stage", "camera", "words"),
    [
        (StageConfig(kind="legacy"), CameraConfig(), "sees no real stage"),
        (StageConfig(kind="legacy"), CameraConfig(kind="genicam"), "no TRIGGER wire"),
    ],
)
def test_devices_that_cannot_work_together_are_refused(stage, camera, words):
    with pytest.raises(ConfigError, match=words):
        build_rig(RigConfig(stage=stage, camera=camera))
