"""Estimates made while a sweep still runs: whatever was done ahead, the result is that of the whole scan at once."""

from __future__ import annotations

import math
from contextlib import closing

import numpy as np
import pytest

from acquire.contract.messaging.messages import FrameFormat, Image, Start
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.states import Outcome
from acquire.writer.scan_file import create_scan
from process.crossings.maps import full_scale
from process.edge_fit.early_estimates import EarlyEstimates
from process.edge_fit.noise_model import assumed_noise
from process.edge_fit.pixel_columns import columns_of_stack
from process.edge_fit.refine import refine, starts
from process.edge_fit.weighting import FrameSequence, WeightingFinder
from process.fold.fold import Fold, to_grey
from process.results.final_maps import new_fold
from process.results.fold_cursor import FoldCursor
from process.results.scan_frames import ScanFrames
from process.results.settings import ReconstructOptions, recorded_in, settle
from process.worker.early_fits import EarlyFits
from tests.fakes.processes.sweep_source import edge_frames

FRAMES, SHAPE = 320, (24, 32)
NOISE = 2.0


def a_sweep(seed=1, edge="rising"):
    """Edges of many widths all over the sweep; some pixels flash later, lie dark again, or brighten a second time."""
    rng = np.random.default_rng(seed)
    pixels = SHAPE[0] * SHAPE[1]
    crossing, width = rng.uniform(20, FRAMES - 5, pixels), rng.choice([0.3, 1.0, 3.0, 6.0], pixels)
    z = (np.arange(FRAMES)[:, None] - crossing) / width
    levels = 20 + rng.uniform(60, 150, pixels) * 0.5 * np.vectorize(math.erfc)(-z / math.sqrt(2))
    kind, later = rng.integers(0, 6, pixels), (crossing + rng.uniform(30, 120, pixels)).astype(int)
    for pixel in np.flatnonzero(kind < 3):
        if kind[pixel] == 0:
            levels[later[pixel] :, pixel] += 70
        elif kind[pixel] == 1:
            levels[later[pixel] :, pixel] = 20
        else:
            levels[later[pixel] : later[pixel] + 3, pixel] += 90
    levels += rng.normal(0, NOISE, levels.shape)
    frames = np.clip(np.rint(levels), 0, 255).astype(np.uint8).reshape(FRAMES, *SHAPE)
    return 255 - frames if edge == "falling" else frames


def fold_of(frames, edge, until, fold=None):
    fold = fold or Fold(SHAPE, bit_depth=8, edge=edge, frames_expected=FRAMES)
    for index in range(fold.folded_through + 1, until):
        fold.add(index, frames[index])
    maps = fold.result(contrast=30, median=0, method="probit", noise_counts=NOISE, read_columns=None)
    return fold, maps, FrameSequence(columns_of_stack(frames), fold.present, edge, 8)


def worked_ahead(frames, edge, steps, *, local=True):
    early, fold = EarlyEstimates(SHAPE, assumed_noise(NOISE), local=local), None
    for until in steps:
        fold, maps, sequence = fold_of(frames, edge, until, fold)
        early.weighting_finder.advance(sequence, 3)
        if early.weighting_finder.weighting is not None:
            early.propose(maps, starts(maps, fold.present), until)
            while early.busy:
                early.work(sequence)
    return early


@pytest.mark.parametrize("edge", ["rising", "falling"])
@pytest.mark.parametrize("method", ["auto", "fit"])
def test_what_was_estimated_early_is_what_the_whole_scan_says(edge, method):
    frames = a_sweep(edge=edge)
    early = worked_ahead(frames, edge, range(40, FRAMES, 25), local=method == "auto")
    assert early.kept > 0.4 * SHAPE[0] * SHAPE[1]
    _, maps, sequence = fold_of(frames, edge, FRAMES)
    plain = refine(maps, method, sequence, NOISE).maps
    ahead = refine(maps, method, sequence, NOISE, early).maps
    for name in ("crossing", "sigma", "quality"):
        assert np.array_equal(getattr(plain, name), getattr(ahead, name), equal_nan=name != "quality"), name
    assert plain.counts == ahead.counts


def test_a_brighter_light_that_moves_the_crossing_makes_an_early_estimate_void():
    frames = a_sweep()
    early = worked_ahead(frames, "rising", [200])
    _, before, _ = fold_of(frames, "rising", 200)
    brighter = frames.copy()
    brighter[290:] = np.where(frames[290:] < 128, frames[290:] + 127, 255)
    _, maps, _ = fold_of(brighter, "rising", FRAMES)
    start = starts(maps, np.arange(FRAMES))
    moved = np.flatnonzero((start > 280) & (starts(before, np.arange(200)) >= 0))
    extent = maps.maximum.ravel()[moved].astype(float) - maps.minimum.ravel()[moved]
    assert len(moved) > 20 and not early.known(moved, start[moved], extent).outcome.any()


def test_the_table_of_early_estimates_is_bounded(monkeypatch):
    monkeypatch.setattr("process.edge_fit.early_estimates.TABLE_BYTES", 10_000)
    frames = a_sweep()
    early = worked_ahead(frames, "rising", range(40, FRAMES, 25))
    assert 0 < early.kept <= 10_000 // 100
    _, maps, sequence = fold_of(frames, "rising", FRAMES)
    plain, ahead = refine(maps, "auto", sequence, NOISE), refine(maps, "auto", sequence, NOISE, early)
    assert np.array_equal(plain.maps.crossing, ahead.maps.crossing, equal_nan=True)


def test_the_weighting_is_known_early_and_does_not_depend_on_when_frames_are_read():
    frames = a_sweep()
    _, _, whole = fold_of(frames, "rising", FRAMES)
    at_once, in_steps = WeightingFinder(SHAPE, assumed_noise(9.0)), WeightingFinder(SHAPE, assumed_noise(9.0))
    at_once.advance(whole, 100)
    for until in range(10, FRAMES, 7):
        in_steps.advance(FrameSequence(whole.columns, whole.present[:until], "rising", 8), 1)
    assert at_once.weighting is not None and at_once.weighting == in_steps.weighting
    assert at_once.weighting.noise.sigma_at(60) == pytest.approx(NOISE, rel=0.15)


@pytest.fixture
def colour_scan(tmp_path):
    frames = edge_frames(40, 96, 72, colour=True)
    form = FrameFormat(width=96, height=72, bit_depth=8, pixel_format="rgb")
    start = Start(scan_uid="u1", path=str(tmp_path / "scan"), format=form, plan=SweepPlan(0, 117, 3, 3.175))
    with closing(create_scan(tmp_path / "scan", start)) as scan:
        for k, frame in enumerate(frames):
            described = {"shape": list(form.shape), "dtype": form.dtype, "bit_depth": 8, "pixel_format": "rgb"}
            scan.write_frame(Image(scan_uid="u1", frame_index=k, crc32=frame_crc32(frame), **described), frame)
        scan.seal(Outcome.COMPLETE, "")
    return tmp_path / "scan"


def test_single_pixels_of_a_file_are_those_of_its_whole_frames(colour_scan):
    with ScanFrames(colour_scan) as frames:
        present = np.array([3, 4, 9, 30])
        pixels = np.array([0, 95, 96 * 40 + 7, 96 * 72 - 1])
        first, end = np.array([0, 1, 0, 2]), np.array([4, 4, 2, 3])
        found = frames.columns_of(present)(pixels, first, end)
        crc32 = frames.field("crc32")
        whole = np.stack([to_grey(frames.pixels(k, int(crc32[k])), 8).ravel()[pixels] for k in present])
        for i in range(len(pixels)):
            assert np.array_equal(found[i, : end[i] - first[i]], whole[first[i] : end[i], i])


def test_frames_read_one_over_the_other_are_those_read_alone(colour_scan):
    with ScanFrames(colour_scan) as frames:
        room = np.empty((72, 96), np.uint8)
        for k, crc32 in enumerate(frames.field("crc32")[:5]):
            again = frames.pixels(k, int(crc32), room)
            assert np.array_equal(again, frames.pixels(k, int(crc32)))
        assert frames.pixels(0, int(frames.field("crc32")[1]), room) is None and frames.damaged == {0}


def test_early_fits_stop_where_the_file_was_cut_short(colour_scan, tmp_path, caplog):
    cut = tmp_path / "scan.h5"
    cut.write_bytes((colour_scan / "scan.h5").read_bytes())
    with ScanFrames(cut) as frames:
        settings = settle(recorded_in(frames.layout), ReconstructOptions(method="auto"))
        cursor = FoldCursor(lambda: new_fold(settings, frames.layout.format, frames.count), frames.count, 0)
        cursor.fill(frames, limit=40)
        maps = cursor.fold.result(contrast=30, median=0, noise_counts=2.0, read_columns=None)
        early = EarlyFits(settings, frames.layout.format)
        early.propose(maps, cursor.fold.present, frames)
        assert early.busy
        with cut.open("r+b") as file:
            file.truncate(cut.stat().st_size // 2)
        early.work()
        assert not early.busy and early.estimates is None and "cut short" in caplog.text


def test_the_complement_of_a_falling_edge_is_told_from_the_full_scale():
    assert FrameSequence(columns_of_stack(a_sweep()), np.arange(3), "falling", 12).full == full_scale(12)
