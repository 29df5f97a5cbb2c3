"""The digital twin takes the same pictures as the pure simulation, and its pins agree with what is counted."""

from __future__ import annotations

import json
import queue
import subprocess
import sys

import numpy as np
import pytest

from acquire.cameras.protocol import CameraSettings
from acquire.contract.config.model import CameraConfig, RigConfig, StageConfig
from acquire.contract.config.simulation import SimulationConfig
from acquire.rigs.build import build_rig
from acquire.rigs.simulated import SimulatedRig
from acquire.rigs.twin import TwinRig
from acquire.stages.protocol import Moved, Segment, SegmentDone, Triggered
from tests.waiting import next_of, run, wait_for

SEGMENT = Segment(30, 6, 8, dwell_ms=4.0, run_up_steps=20)


def config(stage):
    return RigConfig(
        stage=stage,
        camera=CameraConfig(width=64, height=48, exposure_ms=4.0),
        simulation=SimulationConfig(seed=3, time_scale=0.25),
    )


class Taker:
    """Takes the frames of a segment as the daemon would, without its lanes."""

    def __init__(self, rig):
        self.rig = rig
        self.frames = queue.Queue()
        self.events = queue.Queue()
        rig.camera.open(self.frames.put)
        rig.camera.configure(CameraSettings(4.0, 6.0, 0.0))
        rig.stage.open(self.events.put)

    def wait(self, kind):
        seen = []

        def came():
            self.rig.stage.keep_alive()
            try:
                seen.append(self.events.get(timeout=0.02))
            except queue.Empty:
                return False
            return isinstance(seen[-1], kind)

        wait_for(came, kind.__name__, why=lambda: seen)
        return seen

    def take(self, segment, lost=0):
        self.rig.set_lamp(on=True)
        self.rig.camera.arm()
        self.rig.stage.begin_segment(segment, segment.count - 1)
        shots = [event for event in self.wait(SegmentDone) if isinstance(event, Triggered)]
        return shots, [next_of(self.frames).pixels for _ in range(segment.count - lost)]

    def close(self):
        self.rig.stage.close()
        self.rig.camera.close()


@pytest.fixture
def twin(firmware):
    taker = Taker(build_rig(config(StageConfig(kind="uno", port="emulator", acceleration_steps_per_s2=100_000))))
    assert isinstance(taker.rig, TwinRig)
    taker.rig.stage.home()
    taker.wait(Moved)
    yield taker
    taker.close()


@pytest.fixture
def pure():
    taker = Taker(SimulatedRig(config(StageConfig())))
    yield taker
    taker.close()


def test_the_twin_takes_the_same_pictures_as_the_simulation(twin, pure):
    twin_shots, twin_frames = twin.take(SEGMENT)
    pure_shots, pure_frames = pure.take(SEGMENT)
    assert [shot.position_steps for shot in twin_shots] == [shot.position_steps for shot in pure_shots]
    assert len(twin_frames) == len(pure_frames) == SEGMENT.count
    assert all(np.array_equal(a, b) for a, b in zip(twin_frames, pure_frames, strict=True))


def test_the_pins_agree_with_what_is_counted_at_every_frame(twin, tmp_path):
    twin.rig.stage.pairs.record_to(tmp_path / "pins")
    shots, _ = twin.take(SEGMENT)
    pairs = [json.loads(line) for line in (tmp_path / "pins").read_text().splitlines()]
    assert [pair["true_steps"] for pair in pairs] == [shot.position_steps for shot in shots]
    assert all(pair["true_steps"] == pair["counted_steps"] for pair in pairs)
    offsets = [pair["true_cycles"] - pair["counted_cycles"] for pair in pairs]
    assert max(offsets) - min(offsets) <= 16  # one clock, one offset; edges are seen between two instructions
    assert twin.rig.stage.pairs.differences == 0


def test_a_stage_that_slips_shows_in_the_pictures_and_in_the_record(twin):
    twin.rig.stage._emulator.knob("slip 9")
    twin.take(SEGMENT)
    assert twin.rig.stage.pairs.differences == SEGMENT.count


def test_an_edge_that_is_lost_exposes_nothing(twin):
    twin.rig.stage._emulator.knob("drop 3")
    shots, frames = twin.take(SEGMENT, lost=1)
    assert len(shots) == SEGMENT.count and len(frames) == SEGMENT.count - 1
    assert twin.frames.empty()


@pytest.mark.slow
def test_the_demonstration_on_the_twin_gives_the_same_cloud(firmware, tmp_path):
    clouds = []
    for flag in ([], ["--twin"]):
        data = tmp_path / f"data{len(clouds)}"
        command = [sys.executable, "-m", "tui.cli", "demo", *flag, "--size", "160x120", "--frames", "24"]
        command += ["--seed", "5", "--time-scale", "0.5", "--data-dir", str(data)]
        done = run(command, stdin=subprocess.DEVNULL)
        (folder,) = (path for path in data.iterdir() if (path / "scan.h5").exists())
        assert "SAVED: 24 of 24" in done.stdout, done.stdout + done.stderr
        clouds.append((folder / "cloud.ply").read_bytes())
        pins = folder / "twin.jsonl"
        assert pins.exists() == bool(flag)
    assert clouds[0] == clouds[1] and len(clouds[0]) > 1000
