"""The picture: levels against noise, what is repainted, clipping, and its rate on a slow link."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from textual.app import App

from acquire.contract.messaging.messages import Picture
from tui.console.link.rig_view import PictureView
from tui.console.pictures.picture_rate import DEAF_S, STALLED_S, PictureRate
from tui.console.pictures.raster import FULL, PictureDetail, Raster, half_cells_for, reduce_to
from tui.console.widgets.picture import LivePicture


def noisy(seed: int, level: float = 100.0, sigma: float = 8.0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(level, sigma, (192, 256))
    return np.clip(noise, 0, 255).astype(np.uint8)


def view_of(pixels: np.ndarray, position_steps: int = 0) -> PictureView:
    header = Picture(shape=list(pixels.shape), source_shape=[768, 1024], position_steps=position_steps)
    return PictureView(header, pixels)


def test_the_picture_keeps_its_shape_in_cells_that_are_twice_as_high_as_wide():
    assert half_cells_for(768, 1024, 24, 80) == (48, 64)
    assert half_cells_for(768, 1024, 40, 40) == (30, 40)
    assert half_cells_for(768, 1024, 0, 40) == (0, 0)


def test_a_still_noisy_scene_repaints_nothing():
    raster = Raster()
    raster.update(noisy(0, level=110), 40, 60, FULL, 0)
    for seed in range(1, 20):
        assert len(raster.update(noisy(seed, level=110), 40, 60, FULL, 0)) == 0


def test_a_change_repaints_only_its_rows():
    raster = Raster()
    raster.update(noisy(0), 40, 60, FULL, 0)
    changed = noisy(0)
    changed[96:106, 50:80] = 240
    rows = raster.update(changed, 40, 60, FULL, 0)
    assert set(rows) <= set(range(9, 12)) and len(rows)


def test_a_scene_that_came_to_rest_between_two_levels_is_corrected_by_the_average():
    raster = Raster()
    raster.update(noisy(0, level=100), 40, 60, FULL, 0)
    for seed in range(1, 40):
        raster.update(noisy(seed, level=100 + 25), 40, 60, FULL, 0)
    assert abs(float(raster.levels.mean()) * 17.0 - 125) < 9


def test_a_clipped_pixel_marks_its_cell_although_the_mean_is_far_from_clipping():
    pixels = np.full((192, 256), 50, np.uint8)
    pixels[100, 128] = 255
    means, clipped = reduce_to(pixels, 24, 32)
    assert means.max() < 80 and clipped.sum() == 1 and clipped[12, 16]


def test_a_picture_finer_than_the_camera_repeats_its_pixels():
    means, _ = reduce_to(np.array([[0, 200]], np.uint8), 2, 4)
    assert means.tolist() == [[0, 0, 200, 200], [0, 0, 200, 200]]


def test_coarser_detail_uses_fewer_levels_in_blocks():
    raster = Raster()
    raster.update(noisy(3, sigma=60), 40, 60, PictureDetail(6, 4), 0)
    assert raster.levels.max() <= 5
    assert (raster.levels[0:4, 0:4] == raster.levels[0, 0]).all()


@pytest.mark.parametrize(("mode", "sign"), [("half", "▀"), ("mono", "X")])
def test_the_widget_draws_half_blocks_or_characters_and_marks_clipping(mode, sign):
    class Shown(App):
        def compose(self):
            yield LivePicture(mode)

    async def play():
        async with Shown().run_test(size=(40, 16)) as pilot:
            live = pilot.app.query_one(LivePicture)
            pixels = noisy(1)
            pixels[60:130, 60:200] = 255
            live.show(view_of(pixels), "")
            await pilot.pause()
            strip = live.render_line(8)
            assert sign in strip.text and strip.cell_length == 40
            if mode == "half":
                colours = {segment.style.color.triplet for segment in strip if segment.text.startswith("▀")}
                assert any(c.red > 200 and c.green < 100 for c in colours)

    asyncio.run(asyncio.wait_for(play(), 60))


def test_the_widget_shows_words_where_there_is_no_picture():
    class Shown(App):
        def compose(self):
            yield LivePicture()

    async def play():
        async with Shown().run_test(size=(40, 16)) as pilot:
            live = pilot.app.query_one(LivePicture)
            live.show(None, "no picture yet\nv starts the preview")
            await pilot.pause()
            text = "".join(live.render_line(y).text for y in range(16))
            assert "no picture yet" in text and "v starts the preview" in text

    asyncio.run(asyncio.wait_for(play(), 60))


# ---- the rate ----


def test_the_next_picture_waits_until_the_terminal_has_answered():
    rate = told(PictureRate())
    rate.asked(0.0, 10_000)
    assert not rate.may_send(5.0 / rate.wanted_hz, 0)
    rate.answered(0.3)
    assert rate.may_send(10.0, 0)


def test_no_picture_goes_while_our_own_queue_holds_something():
    rate = told(PictureRate())
    assert rate.may_send(0.0, 0) and not rate.may_send(0.0, 1)


def told(rate: PictureRate) -> PictureRate:
    """A rate that knows the link's own delay, 20 ms."""
    rate.asked(-1.0, 0, picture=False)
    rate.answered(-0.98)
    return rate


def play_link(rate_bytes_per_s: float, seconds: float, round_trip_s: float = 0.02) -> tuple[PictureRate, list[float]]:
    """Pictures over a link that carries so much; how long each held it."""
    rate, held = told(PictureRate()), []
    now_s = 0.0
    while now_s < seconds:
        if rate.may_send(now_s, 0):
            nbytes = 60_000 // rate.detail.block**2 * rate.detail.levels // 16
            rate.asked(now_s, nbytes)
            held.append(nbytes / rate_bytes_per_s)
            now_s += round_trip_s + held[-1]
            rate.answered(now_s)
        now_s += 0.01
    return rate, held


def test_on_a_slow_link_pictures_become_coarser_until_none_holds_it_for_more_than_a_fifth_of_a_second():
    rate, held = play_link(100_000, 20.0)
    assert held[0] > 0.2 and all(seconds <= 0.2 for seconds in held[5:])
    assert rate.rate_bytes_per_s == pytest.approx(100_000, rel=0.3)
    assert "kB/s, picture" in rate.words(20.0)


def test_on_a_fast_link_pictures_come_as_often_as_wanted_and_in_full():
    rate, held = play_link(20_000_000, 10.0)
    assert rate.detail == FULL
    assert len(held) == pytest.approx(10.0 * rate.wanted_hz, rel=0.15)


def test_a_link_that_became_fast_again_gets_finer_pictures():
    rate, _ = play_link(50_000, 10.0)
    assert rate.detail != FULL
    now_s = 100.0
    for _ in range(60):
        now_s += 1.0
        rate.asked(now_s, 5_000)
        rate.answered(now_s + 0.02)
    assert rate.detail == FULL


def test_a_terminal_that_never_answers_gets_pictures_all_the_same():
    rate = PictureRate()
    assert rate.wants_bare(0.0)
    rate.asked(0.0, 0, picture=False)
    assert not rate.may_send(1.0, 0)
    assert rate.may_send(DEAF_S + 0.1, 0) and rate.deaf


def test_a_terminal_that_stopped_answering_is_called_stalled_and_is_not_once_it_answers():
    rate = PictureRate()
    rate.asked(0.0, 1000)
    rate.answered(0.01)
    rate.asked(1.0, 1000)
    assert rate.stalled(1.0 + STALLED_S + 0.1, 0.0)
    rate.answered(3.0)
    assert not rate.stalled(3.0, 0.0)
