"""Crossings from the whole edge: near the physical limit, honest about it, and never silently wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from process.crossings.quality import Quality
from process.edge_fit import refine as refining
from process.edge_fit.filters import filtered
from process.edge_fit.noise_model import NoiseModel, assumed_noise, model_from
from process.edge_fit.pixel_columns import columns_of_stack
from process.edge_fit.refine import measure_noise, refine, starts
from process.edge_fit.weighting import FrameSequence
from process.fold.fold import Fold
from tests.bench.cramer_rao import crossing_bound
from tests.bench.estimates import FLAGGED, bench_estimates, estimated, made_edges, true_crossing

NOISE = 2.0


def edges(crossing, width=4.0, contrast=120.0, frames=160, pixels=512, seed=3):
    """Levels [frames, 8, pixels / 8] of erf edges, before rounding."""
    z = (np.arange(frames) - crossing) / width
    clean = 20 + contrast * 0.5 * np.array([math.erfc(-x / math.sqrt(2)) for x in z])
    noise = np.random.default_rng(seed).normal(0, NOISE, (frames, pixels))
    return (clean[:, None] + noise).reshape(frames, 8, -1)


def stored(levels):
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def share_with(maps, bits):
    return float(((maps.quality & int(bits)) != 0).mean())


def folded(frames, edge="rising", indices=None):
    fold = Fold(frames.shape[1:], bit_depth=8, edge=edge, frames_expected=1000)
    for index, frame in zip(indices if indices is not None else range(len(frames)), frames, strict=True):
        fold.add(int(index), frame)
    maps = fold.result(contrast=40, median=0, method="probit", noise_counts=NOISE, read_columns=None)
    return maps, FrameSequence(columns_of_stack(frames), fold.present, edge, 8)


def test_the_bound_is_the_closed_form_where_the_edge_is_wide():
    expected = math.sqrt(4 + 1 / 12) / 100 * math.sqrt(2 * math.sqrt(math.pi) * 3)
    assert crossing_bound(3.0, 100.0, 2.0, [0.0, 0.4]) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("width", [1.5, 4.0, 8.0])
def test_auto_stays_within_a_fifth_of_the_bound_and_its_sigma_is_honest(width):
    (case,) = bench_estimates(6_400, [width], [(75.0, 5.0)], ["auto"])
    assert case.times_bound <= 1.2
    assert case.unflagged >= 0.99
    assert 0.64 <= case.within_68 <= 0.72 and 0.92 <= case.within_95 <= 0.97


def test_linear_wastes_what_auto_does_not():
    linear, auto = bench_estimates(3_200, [4.0], [(100.0, 2.0)], ["linear", "auto"])
    assert linear.times_bound > 2 * auto.times_bound


def test_auto_has_no_bias_at_any_phase():
    (case,) = bench_estimates(6_400, [2.0], [(200.0, 2.0)], ["auto"])
    assert case.worst_bias < 1


@pytest.mark.parametrize("beyond", [0.5, 1.0, 1.5, 2.0])
def test_a_sweep_that_ends_within_the_edge_is_flagged(beyond):
    frames = stored(edges(100.0))[: round(100 + 4 * beyond)]
    maps = estimated(frames, "auto", 40, NOISE)
    known = np.isfinite(maps.crossing)
    assert ((maps.quality[known] & (Quality.PLATEAU_NOT_REACHED | Quality.FILTERED)) != 0).mean() > 0.995


@pytest.mark.parametrize("before", [0.5, 1.0, 1.5, 2.0])
def test_a_sweep_that_starts_within_the_edge_is_flagged(before):
    frames = stored(edges(100.0))[round(100 - 4 * before) :]
    maps = estimated(frames, "auto", 40, NOISE)
    assert share_with(maps, Quality.NO_DARK_LEVEL | Quality.LIT_AT_START | Quality.FILTERED) > 0.995


def test_a_plateau_at_full_scale_is_flagged():
    maps = estimated(stored(edges(80.0, contrast=260.0)), "auto", 40, NOISE)
    assert share_with(maps, Quality.SATURATED) == 1


def test_a_clipped_plateau_does_not_move_the_crossing():
    frames = stored(edges(80.3, contrast=290.0))
    clipped, two = estimated(frames, "auto", 40, NOISE), estimated(frames, "probit", 40, NOISE)
    assert abs(two.crossing - 80.3).mean() > 0.8, "half of what was stored is not half of the light"
    assert abs(clipped.crossing.mean() - 80.3) < 0.1
    assert 0.6 < np.mean(abs(clipped.crossing - 80.3) < clipped.sigma) < 0.8


def test_a_falling_edge_is_clipped_where_the_light_still_is():
    frames = stored(330 - edges(80.3, contrast=290.0))
    maps, sequence = folded(frames, "falling")
    assert abs(refine(maps, "auto", sequence, NOISE).maps.crossing.mean() - 80.3) < 0.1


def test_sigma_is_honest_where_the_noise_is_a_sixth_of_the_contrast():
    (case,) = bench_estimates(6_400, [3.0], [(30.0, 5.0)], ["auto"])
    assert 0.64 <= case.within_68 <= 0.72


CUT, WHOLE = 100.0, 160


@pytest.mark.parametrize(
    ("begin", "end", "contrast"),
    [(0, 99, 120), (0, 102, 120), (0, 106, 120), (99, WHOLE, 120), (101, WHOLE, 120), (94, WHOLE, 120), (0, 104, 300)],
)
def test_a_cut_or_clipped_edge_is_never_silently_wrong(begin, end, contrast):
    maps = estimated(stored(edges(CUT, contrast=contrast))[begin:end], "auto", 40, NOISE)
    silent = np.isfinite(maps.crossing) & ((maps.quality & FLAGGED) == 0)
    wrong = silent & (abs(maps.crossing + begin - CUT) > 5 * maps.sigma)
    assert wrong.mean() < 0.005


def test_light_that_comes_twice_is_flagged():
    levels = edges(60.0)
    levels[90:] -= edges(100.0, seed=4)[90:] - 20
    levels += edges(130.0, seed=5) - 20
    assert share_with(estimated(stored(levels), "auto", 40, NOISE), Quality.SEVERAL) > 0.99


def test_an_edge_in_two_steps_is_flagged():
    levels = edges(60.0, contrast=90.0) + edges(120.0, contrast=60.0, seed=6) - 20
    assert share_with(estimated(stored(levels), "auto", 40, NOISE), Quality.SEVERAL) > 0.99


def test_clean_edges_are_not_flagged():
    maps = estimated(stored(edges(80.3)), "auto", 40, NOISE)
    assert not maps.quality.any()


def test_the_result_does_not_depend_on_how_the_image_is_cut(monkeypatch):
    maps, sequence = folded(made_edges(3.0, 100.0, 2.0, 2_048))
    one = refine(maps, "auto", sequence, NOISE)
    monkeypatch.setattr(refining, "BLOCK_PIXELS", 100)
    monkeypatch.setattr(refining, "THREADS", 1)
    other = refine(maps, "auto", sequence, NOISE)
    assert np.array_equal(one.maps.crossing, other.maps.crossing)
    assert np.array_equal(one.maps.sigma, other.maps.sigma)


def test_a_falling_edge_is_the_rising_one_of_the_complement():
    frames = made_edges(3.0, 100.0, 2.0, 1_024)
    rising = refine(*_with_method(folded(frames)), NOISE).maps
    falling = refine(*_with_method(folded(255 - frames, "falling")), NOISE).maps
    assert np.allclose(rising.crossing, falling.crossing, atol=1e-9)


def _with_method(given):
    maps, sequence = given
    return maps, "auto", sequence


def test_missing_frames_leave_the_crossing_where_it_is():
    frames = made_edges(4.0, 150.0, 1.0, 1_024)
    kept = np.delete(np.arange(len(frames)), [98, 101, 102, 107])
    maps, sequence = folded(frames[kept], indices=kept)
    error = refine(maps, "auto", sequence, 1.0).maps.crossing.ravel() - true_crossing(1_024)
    assert abs(error.mean()) < 0.01 and error.std() < 0.06


def test_fit_has_no_crossing_where_no_edge_can_be_fitted_and_auto_keeps_one():
    rng = np.random.default_rng(1)
    frames = rng.integers(0, 255, (120, 8, 64)).astype(np.uint8)
    fitted = estimated(frames, "fit", 40, NOISE)
    kept = estimated(frames, "auto", 40, NOISE)
    unfitted = np.isnan(fitted.crossing) & np.isfinite(kept.crossing)
    assert unfitted.mean() > 0.05
    assert (kept.quality[unfitted] & Quality.FILTERED | kept.quality[unfitted] & Quality.SEVERAL).astype(bool).any()


def test_the_noise_is_measured_from_the_frames_themselves():
    rng = np.random.default_rng(5)
    levels = edges(80.0, contrast=150.0) - edges(80.0, contrast=0.0) + 20
    frames = stored(levels + rng.normal(0, 1, levels.shape) * np.sqrt(1.0 + 0.05 * levels))
    maps, sequence = folded(frames)
    noise = measure_noise(starts(maps, sequence.present), sequence, maps.mask.shape, assumed_noise(9.0))
    assert noise.measured
    assert noise.sigma_at(20.0) == pytest.approx(math.sqrt(2.0 + 1 / 12), rel=0.1)
    assert noise.sigma_at(170.0) == pytest.approx(math.sqrt(9.5 + 1 / 12), rel=0.1)


def test_a_scan_too_sparse_to_measure_takes_the_configured_noise():
    assert model_from(np.ones((3, 2)), 255, assumed_noise(3.0)) == NoiseModel(9.0 + 1 / 12, 0.0, measured=False)


def test_an_outlier_among_agreeing_neighbours_is_filtered_and_counted():
    maps = estimated(stored(edges(80.0)), "auto", 40, NOISE)
    crossing = maps.crossing.copy()
    crossing[4, 30] += 30
    found = filtered(replace(maps, crossing=crossing))
    assert np.argwhere(found.quality & Quality.FILTERED).tolist() == [[4, 30]]
    assert found.counts["filtered_isolated"] == 1 and found.counts["filtered"] == 1


def test_a_step_of_depth_is_not_filtered():
    maps = estimated(stored(edges(80.0)), "auto", 40, NOISE)
    crossing = maps.crossing.copy()
    crossing[:, 30:] += 40
    assert filtered(replace(maps, crossing=crossing)).counts["filtered"] == 0


def test_an_edge_in_several_steps_is_filtered_where_it_is_far_less_certain_than_the_others():
    maps = estimated(stored(edges(80.0)), "auto", 40, NOISE)
    sigma, quality = maps.sigma.copy(), maps.quality.copy()
    sigma[2, 3:5], quality[2, 3] = 0.7, Quality.SEVERAL
    found = filtered(replace(maps, sigma=sigma, quality=quality))
    assert np.argwhere(found.quality & Quality.FILTERED).tolist() == [[2, 3]]


def test_a_crossing_far_less_certain_than_the_others_is_filtered():
    maps = estimated(stored(edges(80.0)), "auto", 40, NOISE)
    sigma = maps.sigma.copy()
    sigma[2, 3] = 5.0
    found = filtered(replace(maps, sigma=sigma))
    assert np.argwhere(found.quality & Quality.FILTERED).tolist() == [[2, 3]]
    assert found.counts["filtered_sigma"] == 1
