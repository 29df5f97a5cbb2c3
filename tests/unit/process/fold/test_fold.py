"""The fold at its edges: what it refuses, what each quality bit means, colours, missing frames, flagged pixels."""

from __future__ import annotations

import tracemalloc
from math import erf, sqrt

import cv2
import numpy as np
import pytest

from acquire.contract.errors import ScanFileError
from process.crossings.quality import Quality
from process.fold.fold import Fold, to_grey
from tests.reference.two_pass import two_pass

CHOSEN = {"contrast": 20, "median": 0, "noise_counts": 2.0}


def folded(sequence, *, edge="rising", bit_depth=8, indices=None, **options) -> Fold:
    """A fold of one pixel's values, one frame each."""
    dtype = np.uint8 if bit_depth == 8 else np.uint16
    indices = range(len(sequence)) if indices is None else indices
    fold = Fold((1, 1), bit_depth=bit_depth, edge=edge, frames_expected=1000, **options)
    for index, value in zip(indices, sequence, strict=True):
        fold.add(index, np.array([[value]], dtype))
    return fold


def pixel(sequence, **options):
    """Crossing, sigma and quality of one pixel."""
    maps = folded(sequence, **options).result(**CHOSEN, read_columns=None)
    return maps.crossing[0, 0], maps.sigma[0, 0], Quality(int(maps.quality[0, 0]))


CLEAN = [10] * 20 + [110] * 20


def test_a_clean_step_crosses_half_way_between_its_two_frames():
    crossing, sigma, quality = pixel(CLEAN)
    assert crossing == 19.5
    assert sigma == np.float32(2.0 * np.sqrt(0.5) / 100)
    assert quality == Quality(0)


def test_a_falling_step_crosses_where_it_falls():
    crossing, _, quality = pixel(CLEAN[::-1], edge="falling")
    assert (crossing, quality) == (19.5, Quality(0))


def test_a_value_equal_to_half_brightness_is_already_across():
    assert pixel([0] * 9 + [50] + [100] * 9)[0] == 9.0


@pytest.mark.parametrize(
    ("sequence", "expected"),
    [
        ([110] * 20 + [10] * 20, Quality.LIT_AT_START),
        ([10] * 38 + [60, 110], Quality.PLATEAU_NOT_REACHED),
        ([10, 110] + [110] * 38, Quality.NO_DARK_LEVEL),
        ([130] * 20 + [230] * 20, Quality.NO_DARK_LEVEL),
        ([10] * 20 + [255] * 20, Quality.SATURATED),
        ([10] * 10 + [110] * 10 + [10] * 10 + [111] * 10, Quality.SEVERAL),
        ([10] * 10 + [110] * 10 + [10] * 10 + [90] * 10, Quality.SEVERAL),
        ([10] * 20 + [110] * 10 + [40] * 10, Quality(0)),
    ],
)
def test_each_quality_bit_has_its_sequence(sequence, expected):
    assert pixel(sequence)[2] == expected


def test_a_crossing_across_a_missing_frame_is_interpolated_over_the_gap_and_marked():
    indices = [k for k in range(41) if k != 20]
    crossing, sigma, quality = pixel(CLEAN, indices=indices)
    assert crossing == 20.0
    assert sigma == np.float32(2.0 * np.sqrt(0.5) / 100 * 2)
    assert quality == Quality.MISSING_NEIGHBOUR


def test_no_quality_bit_is_set_outside_the_mask():
    maps = folded([250, 255]).result(**CHOSEN, read_columns=None)
    assert maps.quality[0, 0] == 0
    assert maps.counts["saturated"] == 0


def test_contrast_and_noise_are_in_counts_of_8_bit_at_any_depth():
    deep = folded([value * 16 for value in CLEAN], bit_depth=12).result(**CHOSEN, read_columns=None)
    shallow = folded(CLEAN).result(**CHOSEN, read_columns=None)
    assert deep.mask[0, 0] == shallow.mask[0, 0] == 1
    assert deep.sigma[0, 0] == shallow.sigma[0, 0]
    assert folded([160, 479], bit_depth=12).result(**CHOSEN, read_columns=None).mask[0, 0] == 0


@pytest.mark.parametrize("edge", ["rising", "falling"])
def test_the_colour_is_that_of_the_first_brightest_frame(edge):
    fold = Fold((1, 1), bit_depth=8, edge=edge, frames_expected=4)
    for index, rgb in enumerate([(10, 10, 10), (200, 100, 50), (50, 50, 50), (200, 100, 50)]):
        fold.add(index, np.array([[rgb]], np.uint8))
    assert fold.result(**CHOSEN, read_columns=None).colour[0, 0].tolist() == [200, 100, 50]


def put_there(fold, frame):
    np.copyto(fold.room(), frame)
    return fold.room()


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_whole_tiles_and_a_remainder_fold_alike_copied_kept_or_put_there(bit_depth):
    rng = np.random.default_rng(3)
    dtype = np.uint8 if bit_depth == 8 else np.uint16
    frames = list(rng.integers(0, 2**bit_depth, (11, 47, 51)).astype(dtype))
    for frame in frames[::2]:
        frame.setflags(write=False)
    reference = two_pass(list(range(11)), frames, bit_depth=bit_depth, edge="falling", **CHOSEN)
    for way in ("copied", "kept", "put there"):
        fold = Fold((47, 51), bit_depth=bit_depth, edge="falling", frames_expected=11)
        for index, frame in enumerate(frames):
            fold.add(index, put_there(fold, frame) if way == "put there" else frame, keep=way == "kept" and index != 5)
        maps = fold.result(**CHOSEN, read_columns=None)
        np.testing.assert_array_equal(maps.crossing, reference.crossing)
        np.testing.assert_array_equal(maps.quality, reference.quality)


def test_a_copied_frame_may_be_overwritten_at_once():
    buffer = np.zeros((1, 1), np.uint8)
    fold = Fold((1, 1), bit_depth=8, edge="rising", frames_expected=40)
    for index, value in enumerate(CLEAN):
        buffer[:] = value
        fold.add(index, buffer)
    assert fold.result(**CHOSEN, read_columns=None).crossing[0, 0] == 19.5


def test_frames_of_any_memory_layout_fold_alike():
    rng = np.random.default_rng(4)
    frames = rng.integers(0, 256, (6, 20, 30, 3)).astype(np.uint8)
    plain = Fold((20, 30), bit_depth=8, edge="rising", frames_expected=6)
    odd = Fold((20, 30), bit_depth=8, edge="rising", frames_expected=6)
    for index, frame in enumerate(frames):
        plain.add(index, frame, keep=True)
        odd.add(index, np.asfortranarray(frame), keep=True)
    one, other = (fold.result(**CHOSEN, read_columns=None) for fold in (plain, odd))
    np.testing.assert_array_equal(one.crossing, other.crossing)
    np.testing.assert_array_equal(one.colour, other.colour)


@pytest.mark.parametrize(
    ("index", "frame"),
    [
        (4, np.zeros((2, 3), np.uint8)),
        (3, np.zeros((2, 3), np.uint8)),
        (10, np.zeros((2, 3), np.uint8)),
        (5, np.zeros((3, 2), np.uint8)),
        (5, np.zeros((2, 3), np.uint16)),
        (5, np.zeros((2, 3, 3), np.uint8)),
        (5, np.zeros((2, 3, 1), np.uint8)),
        (5, np.zeros(6, np.uint8)),
    ],
    ids=["again", "backwards", "unexpected", "shape", "type", "colour", "channels", "flat"],
)
def test_a_frame_that_does_not_fit_is_refused_and_folds_nothing(index, frame):
    fold = Fold((2, 3), bit_depth=8, edge="rising", frames_expected=10)
    fold.add(4, np.full((2, 3), 7, np.uint8))
    with pytest.raises(ValueError, match="frame"):
        fold.add(index, frame)
    assert fold.present.tolist() == [4]
    assert fold.folded_through == 4
    assert fold.result(**CHOSEN, read_columns=None).maximum.max() == 7


@pytest.mark.parametrize(
    "wrong",
    [
        {"edge": "sideways"},
        {"bit_depth": 7},
        {"bit_depth": 17},
        {"frames_expected": 0},
        {"frames_expected": 65537},
        {"log_room": 1},
        {"shape": (0, 4)},
    ],
    ids=str,
)
def test_a_fold_that_cannot_be_is_refused_before_it_starts(wrong):
    good = {"shape": (1, 1), "bit_depth": 8, "edge": "rising", "frames_expected": 4}
    with pytest.raises(ValueError, match="not"):
        Fold(**{**good, **wrong})


@pytest.mark.parametrize("wrong", [{"median": 4}, {"median": -1}, {"contrast": -1}, {"method": "guess"}], ids=str)
def test_a_choice_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match="not"):
        folded(CLEAN).result(**{**CHOSEN, **wrong}, read_columns=None)


def test_there_is_no_result_before_the_first_frame():
    with pytest.raises(ValueError, match="nothing"):
        Fold((1, 1), bit_depth=8, edge="rising", frames_expected=4).result(**CHOSEN, read_columns=None)


@pytest.mark.parametrize("edge", ["rising", "falling"])
def test_a_value_above_the_full_scale_of_the_depth_is_found(edge):
    with pytest.raises(ValueError, match="4095"):
        folded([7, 4096, 9], bit_depth=12, edge=edge).result(**CHOSEN, read_columns=None)


def test_grey_of_any_colour_of_8_bit_is_that_of_opencv():
    levels = np.minimum(np.arange(257), 255)
    colours = np.empty((257, 257, 3), np.uint8)  # whole blocks of pixels and one more
    colours[..., 0], colours[..., 1] = levels[:, None], levels
    for blue in range(256):
        colours[..., 2] = blue
        assert np.array_equal(to_grey(colours, 8), cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY)), blue


def test_grey_of_a_grey_frame_is_the_frame_itself():
    frame = np.zeros((2, 2), np.uint16)
    assert to_grey(frame, 12) is frame


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_the_memory_asked_for_beforehand_covers_what_the_fold_and_a_result_take(bit_depth):
    dtype = np.uint8 if bit_depth == 8 else np.uint16

    def taken(shape) -> int:
        """Most bytes that a colour fold of five frames and its result hold at a time."""
        frames = np.random.default_rng(1).integers(0, 2**bit_depth, (5, *shape, 3)).astype(dtype)
        tracemalloc.start()
        fold = Fold(shape, bit_depth=bit_depth, edge="rising", frames_expected=len(frames))
        for index, frame in enumerate(frames):
            fold.add(index, frame)
        maps = fold.result(**CHOSEN, read_columns=None)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert maps.counts["over_contrast"] > 0
        return peak

    taken((2, 2))  # the kernels are compiled now
    shape = (300, 400)
    needed = Fold.bytes_needed(shape, bit_depth)
    assert 0.7 * needed < taken(shape) <= needed


def test_a_sweep_may_have_as_many_frames_as_a_16_bit_number_counts():
    fold = Fold((1, 1), bit_depth=8, edge="rising", frames_expected=65536)
    dark, lit = np.full((1, 1), 10, np.uint8), np.full((1, 1), 110, np.uint8)
    for index in range(65536):
        fold.add(index, lit if index > 65500 else dark, keep=True)
    maps = fold.result(**CHOSEN, read_columns=None)
    assert (maps.crossing[0, 0], maps.last_maximum[0, 0]) == (65500.5, 65501)


# --- pixels that the bounded log no longer knows

RAMPS = (64, 32)
"""Exactly one tile, every pixel of it a slow ramp: more new maxima than the log has room for."""


def ramps() -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    slope = rng.uniform(2, 6, RAMPS)
    return [np.clip(np.rint(5 + slope * k), 0, 250).astype(np.uint8) for k in range(60)]


def ramp_fold(log_room=4) -> Fold:
    fold = Fold(RAMPS, bit_depth=8, edge="rising", frames_expected=60, log_room=log_room)
    for index, frame in enumerate(ramps()):
        fold.add(index, frame)
    return fold


def columns(frames):
    flat = np.stack(frames).reshape(len(frames), -1)
    return lambda pixels: (np.arange(len(frames)), flat[:, pixels])


def test_flagged_pixels_stay_empty_and_are_counted_without_the_file():
    maps = ramp_fold().result(**CHOSEN, read_columns=None)
    assert maps.counts["unresolved"] == maps.counts["flagged"] > 0
    assert maps.counts["crossings"] == maps.counts["over_contrast"] - maps.counts["flagged"]
    assert maps.counts["from_file"] == 0


def test_flagged_pixels_are_resolved_from_the_file_and_say_so():
    maps = ramp_fold().result(**CHOSEN, read_columns=columns(ramps()))
    reference = two_pass(list(range(60)), ramps(), bit_depth=8, edge="rising", **CHOSEN)
    np.testing.assert_array_equal(maps.crossing, reference.crossing)
    assert maps.counts["from_file"] == maps.counts["flagged"] > 0
    assert maps.counts["unresolved"] == 0


def test_what_is_flagged_does_not_depend_on_results_in_mid_sweep():
    looked = Fold(RAMPS, bit_depth=8, edge="rising", frames_expected=60, log_room=4)
    for index, frame in enumerate(ramps()):
        looked.add(index, frame)
        looked.result(**CHOSEN, read_columns=None)
    one, other = (fold.result(**CHOSEN, read_columns=columns(ramps())) for fold in (looked, ramp_fold()))
    np.testing.assert_array_equal(one.quality, other.quality)


def test_a_file_that_lacks_a_folded_frame_is_refused():
    with pytest.raises(ScanFileError, match="lacks"):
        ramp_fold().result(**CHOSEN, read_columns=columns(ramps()[:-1]))


def test_a_file_with_other_values_than_were_folded_is_refused():
    other = [np.minimum(frame, 100) for frame in ramps()]
    with pytest.raises(ScanFileError, match="differ"):
        ramp_fold().result(**CHOSEN, read_columns=columns(other))


GRID = np.linspace(-6, 6, 4001)
EDGE = np.array([0.5 + 0.5 * erf(x / sqrt(2)) for x in GRID])


@pytest.mark.parametrize("bit_depth", [8, 12])
@pytest.mark.parametrize("width", [1, 3, 6, 10])
def test_hardly_any_pixel_of_erf_edges_is_flagged_at_any_contrast_chosen_afterwards(bit_depth, width):
    """A whole tile lit, noise of 1 to 5 counts of 8 bit: the fullest that a log gets."""
    shape, n, scale = (32, 64), 200, 2 ** (bit_depth - 8)
    rng = np.random.default_rng(width)
    at, noise = rng.uniform(0.1, 0.9, shape) * n, rng.uniform(1, 5, shape)
    height, base = rng.uniform(30, 230, shape), rng.uniform(0, 20, shape)
    fold = Fold(shape, bit_depth=bit_depth, edge="rising", frames_expected=n)
    for k in range(n):
        level = base + height * np.interp((k - at) / width, GRID, EDGE) + rng.normal(0, 1, shape) * noise
        levels = np.clip(np.rint(level * scale), 0, 2**bit_depth - 1)
        fold.add(k, levels.astype(np.uint8 if bit_depth == 8 else np.uint16))
    for contrast in (0, 10, 70, 120):
        counts = fold.result(contrast=contrast, median=0, noise_counts=2.0, read_columns=None).counts
        assert counts["flagged"] <= 0.005 * counts["over_contrast"]
        assert counts["crossings"] > 0
