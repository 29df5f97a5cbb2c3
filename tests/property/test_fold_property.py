"""The one-pass fold against the two-pass definition, bit for bit, on random sequences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from process.crossings.quality import Quality
from process.fold.fold import Fold
from tests.reference.two_pass import greys_of, two_pass

MAPS = ("minimum", "maximum", "mask", "crossing", "sigma", "colour", "last_maximum")
KINDS = ("noise", "steps", "edge", "ramp", "constant", "saturated", "fall", "pulses")


def signal(kind: str, n: int, shape: tuple[int, int], full: int, rng: np.random.Generator) -> np.ndarray:
    """[n, h, w] float, not yet rounded."""
    k = np.arange(n)[:, None, None]
    at = rng.uniform(-0.2, 1.2, shape) * n
    width = rng.uniform(0.2, max(1.0, n / 3), shape)
    height, base = rng.uniform(0, 1, shape) * full, rng.uniform(0, 0.3, shape) * full
    edge = 1 / (1 + np.exp(-np.clip((k - at) / width, -50, 50)))
    noise = rng.normal(0, rng.choice([0, 0.3, 3]) * (full + 1) / 256, (n, *shape))
    made = {
        "noise": rng.uniform(0, full, (n, *shape)),
        "steps": rng.integers(0, 4, (n, *shape)) * full / 3,
        "edge": base + height * edge + noise,
        "ramp": base + height * k / n,
        "constant": np.broadcast_to(base, (n, *shape)),
        "saturated": base + 2 * height * edge + noise,
        "fall": base + height * (1 - edge) + noise,
        "pulses": base + height * (np.cos((k - at) / width) + 1) / 2 + noise,
    }
    return made[kind]


@st.composite
def sweeps(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    bit_depth = draw(st.sampled_from([8, 10, 12, 16]))
    shape = draw(st.sampled_from([(1, 1), (1, 7), (5, 4), (9, 8)]))
    n = draw(st.sampled_from([1, 2, 3, 4, 5, 6, 9, 23, 60]))
    full = 2**bit_depth - 1
    rgb = draw(st.booleans())
    values = np.stack([signal(draw(st.sampled_from(KINDS)), n, shape, full, rng) for _ in range(1 + 2 * rgb)], -1)
    if draw(st.booleans()):
        mixed = [signal(kind, n, shape, full, rng) for kind in rng.choice(KINDS, 3)]
        chosen = rng.integers(0, 3, shape)
        values[...] = np.choose(chosen, mixed)[..., None]
    values = np.clip(np.rint(values), 0, full).astype(np.uint8 if bit_depth == 8 else np.uint16)
    frames = list(values if rgb else values[..., 0])
    step = draw(st.integers(1, 3))
    indices = sorted(rng.choice(step * n, n, replace=False).tolist())
    return bit_depth, indices, frames


def fold_of(shape, bit_depth, edge, indices, frames, log_room=16):
    fold = Fold(shape, bit_depth=bit_depth, edge=edge, frames_expected=indices[-1] + 1, log_room=log_room)
    for index, frame in zip(indices, frames, strict=True):
        fold.add(index, frame)
    return fold


def columns_of(indices, frames):
    flat = greys_of(frames).reshape(len(frames), -1)
    return lambda pixels: (np.array(indices), flat[:, pixels])


def assert_same(maps, reference):
    for name in MAPS:
        got, expected = getattr(maps, name), getattr(reference, name)
        assert got.dtype == expected.dtype, name
        assert got.shape == expected.shape, name
        np.testing.assert_array_equal(got, expected, err_msg=name)
    np.testing.assert_array_equal(maps.quality & ~np.uint16(Quality.FROM_FILE), reference.quality)


@pytest.mark.parametrize("edge", ["rising", "falling"])
@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(sweep=sweeps(), contrast=st.sampled_from([0, 1, 20, 70, 255]), median=st.sampled_from([0, 3, 5]))
def test_one_pass_equals_two_passes(edge, sweep, contrast, median):
    bit_depth, indices, frames = sweep
    chosen = {"contrast": contrast, "median": median, "noise_counts": 2.0}
    fold = fold_of(frames[0].shape[:2], bit_depth, edge, indices, frames)
    maps = fold.result(**chosen, read_columns=columns_of(indices, frames))
    assert_same(maps, two_pass(indices, frames, bit_depth=bit_depth, edge=edge, **chosen))
    assert maps.counts["unresolved"] == 0


@pytest.mark.parametrize("edge", ["rising", "falling"])
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(sweep=sweeps(), looks=st.lists(st.integers(0, 59), max_size=5))
def test_a_result_in_mid_sweep_is_that_of_the_frames_so_far_and_disturbs_nothing(edge, sweep, looks):
    bit_depth, indices, frames = sweep
    chosen = {"contrast": 20, "median": 0, "noise_counts": 2.0}
    fold = Fold(frames[0].shape[:2], bit_depth=bit_depth, edge=edge, frames_expected=indices[-1] + 1)
    for k, (index, frame) in enumerate(zip(indices, frames, strict=True)):
        fold.add(index, frame)
        if k in looks or k == len(frames) - 1:
            seen = slice(0, k + 1)
            maps = fold.result(**chosen, read_columns=columns_of(indices[seen], frames[seen]))
            expected = two_pass(indices[seen], frames[seen], bit_depth=bit_depth, edge=edge, **chosen)
            assert_same(maps, expected)


TILES = (64, 64)
"""Two whole tiles: enough for the log of a tile to fill up."""


@pytest.mark.parametrize("edge", ["rising", "falling"])
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=3),
    bit_depth=st.sampled_from([8, 12]),
    log_room=st.sampled_from([2, 3, 4, 8]),
)
def test_a_log_that_overflows_stays_exact_with_the_file_at_hand(edge, seed, kinds, bit_depth, log_room):
    rng = np.random.default_rng(seed)
    n, full = 60, 2**bit_depth - 1
    parts = [signal(kind, n, TILES, full, rng) for kind in kinds]
    values = np.choose(rng.integers(0, len(parts), TILES), parts)
    frames = list(np.clip(np.rint(values), 0, full).astype(np.uint8 if bit_depth == 8 else np.uint16))
    indices = list(range(n))
    chosen = {"contrast": 5, "median": 0, "noise_counts": 2.0}
    fold = fold_of(TILES, bit_depth, edge, indices, frames, log_room)
    maps = fold.result(**chosen, read_columns=columns_of(indices, frames))
    reference = two_pass(indices, frames, bit_depth=bit_depth, edge=edge, **chosen)
    assert_same(maps, reference)
    blind = fold.result(**chosen, read_columns=None)
    known = ~np.isnan(blind.crossing)
    np.testing.assert_array_equal(blind.crossing[known], reference.crossing[known])
    assert blind.counts["unresolved"] == blind.counts["flagged"] == maps.counts["flagged"]
    assert blind.counts["crossings"] + blind.counts["unresolved"] == maps.counts["crossings"]
