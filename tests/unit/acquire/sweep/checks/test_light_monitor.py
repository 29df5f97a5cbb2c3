"""The lamp, the clocks and the scripted camera: what happens is noticed, what does not is not."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.cameras.scripted_faults import ScriptedFaults, parse_script
from acquire.contract.config.load import load_config
from acquire.contract.errors import ConfigError
from acquire.contract.units import NS_PER_S
from acquire.daemon.clock_watch import ClockWatch
from acquire.simulation import Renderer, build_scene
from acquire.sweep.checks.light_monitor import LightMonitor

COUNT = 132


@pytest.fixture(scope="module")
def render():
    rig = load_config(environ={}).rig
    renderer = Renderer(build_scene(rig.simulation, width=128, height=96, um_per_microstep=3.175))
    return lambda k, **light: renderer.render(12 * k, exposure_ms=30, gain=6, brightness=0, **light)


@pytest.mark.parametrize("order", [1, -1])
def test_a_sweep_in_steady_light_raises_no_alarm(render, order):
    watch = LightMonitor(255)
    assert [watch.update(k, render(index)) for k, index in enumerate(range(COUNT)[::order])] == [None] * COUNT


@pytest.mark.parametrize(
    ("light", "words"), [({"lamp": 0.85}, "less"), ({"lamp": 0.0}, "fails"), ({"room": 5}, "light")]
)
def test_a_change_of_the_light_is_noticed_within_five_frames_and_dated(render, light, words):
    watch = LightMonitor(255)
    found = {k: watch.update(k, render(k, **(light if k >= 70 else {}))) for k in range(55, 75)}
    noticed = min(k for k, seen in found.items() if seen)
    assert noticed <= 74 and found[noticed][0] == 70 and words in found[noticed][1]


def test_light_that_was_accepted_is_not_complained_of_again(render):
    watch = LightMonitor(255)
    for k in range(60, 80):
        if watch.update(k, render(k, lamp=0.7 if k >= 70 else 1.0)):
            break
    watch.forget()
    assert not any(watch.update(k, render(k, lamp=0.7)) for k in range(k + 1, k + 15))


def test_a_gap_in_the_frames_is_not_taken_for_the_light(render):
    watch = LightMonitor(255)
    for k in range(60, 70):
        watch.update(k, render(k))
    assert watch.update(120, render(120)) is None


def test_a_frame_that_is_taken_again_does_not_hide_a_change_of_the_light(render):
    """The lamp dims while the sweep goes back for frame 69."""
    watch, found = LightMonitor(255), None
    for k in [*range(60, 69), 70, 69, 71, 72]:
        found = found or watch.update(k, render(k, lamp=1.0 if k in range(60, 71) else 0.7))
    assert found is not None and found[0] == 71


def test_frames_that_are_left_out_do_not_hide_a_change_of_the_light(render):
    watch, found = LightMonitor(255), None
    for k in [*range(60, 70), 74, 75, 76]:
        found = found or watch.update(k, render(k, lamp=1.0 if k < 70 else 0.7))
    assert found is not None and found[0] == 74


@pytest.mark.parametrize("lost", [65, 90, 110])
def test_a_frame_that_is_taken_again_in_steady_light_raises_no_alarm(render, lost):
    watch = LightMonitor(255)
    order = [*range(lost - 10, lost), lost + 1, lost + 2, lost, *range(lost + 3, lost + 12)]
    assert [watch.update(k, render(k)) for k in order] == [None] * len(order)


def test_a_frozen_process_and_a_clock_that_jumps_are_told_apart():
    watch = ClockWatch()
    assert watch.update(0, 5) == []
    assert watch.update(NS_PER_S // 2, 5) == []
    assert watch.update(6 * NS_PER_S, 5) == [("F02", 5.5)]
    assert watch.update(6 * NS_PER_S, 5 - 3600 * NS_PER_S) == [("F22", -3600.0)]


def deliveries(script: str, count: int) -> list[tuple[int, tuple[int, ...]] | str]:
    faults = ScriptedFaults(parse_script(script))
    found: list[tuple[int, tuple[int, ...]] | str] = []
    for k in range(count):
        faults.begin()
        for event in faults.deliver(CameraFrame(np.full((3, 4), k, np.uint8), k, 0)):
            found.append("gone" if isinstance(event, CameraGone) else (event.camera_frame_id, event.pixels.shape))
    return found


@pytest.mark.parametrize(
    ("script", "ids"),
    [("", [0, 1, 2]), ("lose:1", [0, 2]), ("skip:1", [0, 1]), ("extra:1", [0, 1, 2, 3]), ("double:1", [0, 1, 1, 2]),
     ("stray:1", [0, 0, 1, 2]), ("late:0", [1, 0, 2]), ("restart:1", [0, "gone", "gone", 0])],
)  # fmt: skip
def test_the_script_does_to_the_ids_what_it_says(script, ids):
    assert [item if isinstance(item, str) else item[0] for item in deliveries(script, 3)] == ids


def test_a_script_that_cannot_be_meant_is_refused():
    with pytest.raises(ConfigError, match="explode"):
        parse_script("lose:1,explode:3")
