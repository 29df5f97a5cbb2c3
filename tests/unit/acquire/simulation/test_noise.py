"""The noise of the simulated camera: right in size, without pattern, and a function of its counters alone."""

import numpy as np
import pytest

from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation import Renderer, build_scene
from acquire.simulation.noise import counter_bits, frame_key, normal_table

SETTINGS = {"exposure_ms": 30.0, "gain": 6.0, "brightness": 50.0}
PLAIN = {"object": "flat", "albedo_contrast": 0.0, "relief": 0.0, "seed": 7}


def dark_frames(positions, attempts=None, size=(256, 192), **config):
    """Frames without lamp, noise alone around half of full scale, float64 [n, h, w(, 3)]."""
    scene = build_scene(SimulationConfig(**PLAIN | config), width=size[0], height=size[1], um_per_microstep=3.175)
    renderer = Renderer(scene)
    attempts = attempts or [0] * len(positions)
    return np.array(
        [
            renderer.render(position, lamp=0.0, room=0.0, attempt=attempt, **SETTINGS)
            for position, attempt in zip(positions, attempts, strict=True)
        ],
        dtype=np.float64,
    )


def correlation(a, b):
    return np.corrcoef(a.ravel(), b.ravel())[0, 1]


@pytest.fixture(scope="module")
def frames():
    return dark_frames([0, 1, 3], read_noise_counts=4.0)


def test_the_table_is_normal_to_four_sigma():
    table = normal_table()
    assert abs(table.mean()) < 1e-6
    assert table.var() == pytest.approx(1.0, abs=1e-5)
    assert (table.astype(float) ** 4).mean() == pytest.approx(3.0, abs=0.02)
    assert table.max() == pytest.approx(4.0, abs=0.2)


def test_bits_of_neighbouring_counters_and_keys_are_each_set_half_of_the_time():
    words = [int(counter_bits(frame_key(1, key), counter)) for key in range(20) for counter in range(200)]
    shares = [np.mean([(word >> bit) & 1 for word in words]) for bit in range(64)]
    assert np.abs(np.array(shares) - 0.5).max() < 0.05


def test_dark_noise_has_the_configured_mean_and_standard_deviation(frames):
    assert frames.mean() == pytest.approx(127.5, abs=0.03)
    assert frames.std() == pytest.approx(np.sqrt(4.0**2 + 1 / 12), rel=0.01)


def test_noise_of_neighbours_rows_frames_and_channels_does_not_correlate(frames):
    limit = 5 / np.sqrt(frames[0, ..., 0].size)
    pairs = [
        (frames[:, :, 1:], frames[:, :, :-1]),
        (frames[:, 1:], frames[:, :-1]),
        (frames[0], frames[1]),
        (frames[0], frames[2]),
        (frames[..., 0], frames[..., 1]),
        (frames[..., 1], frames[..., 2]),
        (frames[0, :, 1:], frames[1, :, :-1]),
    ]
    assert max(abs(correlation(a, b)) for a, b in pairs) < limit


def test_shot_noise_grows_with_the_signal_as_electrons_do():
    config = SimulationConfig(**PLAIN, colour=False, bit_depth=12, ambient=0.5, full_well_electrons=10_000.0)
    renderer = Renderer(build_scene(config, width=256, height=192, um_per_microstep=3.175))
    for room in (0.3, 1.0):
        a, b = (
            renderer.render(p, lamp=0.0, room=room, exposure_ms=30.0, gain=6.0, brightness=10.0).astype(float)
            for p in (0, 1)
        )
        levels = 4095 / 255
        signal = (a.mean() - 0.1 * 4095) / levels
        expected = 0.8**2 + signal * 255 / 10_000 * 10 ** (6 / 20)
        assert (a - b).var() / 2 / levels**2 == pytest.approx(expected, rel=0.03)


def test_a_frame_is_the_same_whatever_was_taken_before():
    forward, backward = dark_frames([0, 3, 6], size=(32, 24)), dark_frames([6, 3, 0], size=(32, 24))
    np.testing.assert_array_equal(forward, backward[::-1])


def test_a_retaken_frame_is_the_same_frame():
    first, again = dark_frames([3, 3], attempts=[0, 2], size=(32, 24))
    np.testing.assert_array_equal(first, again)


def test_retake_noise_changes_the_noise_of_another_attempt_only():
    first, again, same = dark_frames([3, 3, 3], attempts=[0, 1, 0], size=(32, 24), retake_noise=True)
    assert (first != again).any()
    np.testing.assert_array_equal(first, same)


def test_another_seed_gives_other_noise():
    assert (dark_frames([3], size=(32, 24), seed=1) != dark_frames([3], size=(32, 24), seed=2)).any()


def test_rounding_of_a_position_does_not_change_its_noise():
    assert frame_key(1, 0.1 + 0.2) == frame_key(1, 0.3)
