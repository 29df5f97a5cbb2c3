import numpy as np
import pytest

from acquire.contract.colormaps import table
from process.viewer.rig_client.tile import Tile
from process.viewer.status_html import legend_html
from process.viewer.stream.colouring import (
    PROVISIONAL_RGB,
    ValueRange,
    ViewSettings,
    automatic_range,
    chosen_range,
    colours_of,
    fit_plane,
    legend_of,
    values_of,
)


def tile(xyz: np.ndarray, *, provisional: object = False, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Tile:
    count = len(xyz)
    return Tile(
        origin,
        xyz.astype(np.float32),
        np.full((count, 3), 90, np.uint8),
        np.broadcast_to(np.asarray(provisional), count),
        np.arange(count, dtype=np.float32),
        np.full(count, 0.5, np.float32),
    )


def slope(count: int = 900) -> np.ndarray:
    x, y = np.random.default_rng(3).uniform(-4, 4, (2, count))
    return np.stack([x, y, 0.1 * x - 0.05 * y + 2.0], axis=1)


def test_provisional_points_are_drawn_toward_the_colour_of_the_legend() -> None:
    settled, moving = colours_of(tile(np.zeros((2, 3)), provisional=[False, True]), "photograph", None, None)
    assert settled.tolist() == [90, 90, 90]
    off = [np.abs(shown.astype(int) - PROVISIONAL_RGB).sum() for shown in (settled, moving)]
    assert off[1] < off[0] / 2


def test_where_the_colour_tells_a_value_provisional_points_keep_their_hue_and_are_darker() -> None:
    shown = colours_of(tile(np.zeros((2, 3)), provisional=[False, True]), "height", ValueRange(-1.0, 1.0), None)
    assert shown[0].tolist() == table("viridis")[128].tolist()
    assert shown[1].astype(float) == pytest.approx(0.45 * shown[0], abs=1.5)


def test_height_counts_from_zero_wherever_a_tile_has_its_origin() -> None:
    assert values_of(tile(np.zeros((1, 3)), origin=(0.0, 0.0, 2.5)), "height", None).tolist() == [2.5]


def test_the_automatic_range_leaves_out_a_percent_at_each_end_and_is_round() -> None:
    values = np.append(np.linspace(0.0, 1.0, 1000), [900.0]).astype(np.float32)
    assert automatic_range(values, "height") == ValueRange(0.0, 1.0)


def test_the_range_of_a_deviation_is_the_same_on_both_sides() -> None:
    found = automatic_range(np.linspace(-3.0, 10.0, 500, dtype=np.float32), "deviation")
    assert found.low == -found.high


def test_a_typed_end_holds_and_one_below_the_other_does_not_break_the_colours() -> None:
    values = np.linspace(0.0, 1.0, 100, dtype=np.float32)
    assert chosen_range(ViewSettings("height", low=-2.0), values).low == -2.0
    broken = chosen_range(ViewSettings("height", low=5.0, high=1.0), values)
    assert broken.high > broken.low == 5.0


def test_a_tilted_plane_is_found_beside_a_step_and_what_is_left_is_the_step() -> None:
    points = slope()
    points[:60, 2] += 0.3
    plane = fit_plane([tile(points)])
    assert plane is not None
    assert plane.tilt_degrees == pytest.approx(np.degrees(np.arctan(np.hypot(0.1, 0.05))), abs=0.01)
    assert plane.rms_um < 1.0
    found = values_of(tile(points), "deviation", plane)
    assert found[60:] == pytest.approx(np.zeros(840), abs=1.0)
    assert found[:60] == pytest.approx(np.full(60, 300 * plane.normal[2]), abs=1.0)


def test_too_few_points_have_no_plane_and_their_deviation_is_no_value() -> None:
    few = tile(slope(5))
    assert fit_plane([few]) is None
    assert np.isnan(values_of(few, "deviation", None)).all()


def test_the_legend_says_what_is_clipped_and_which_form_was_removed() -> None:
    values = np.linspace(0.0, 100.0, 1001, dtype=np.float32)
    legend = legend_of("deviation", ValueRange(10.0, 80.0), values, fit_plane([tile(slope())]))
    assert (legend.below_percent, legend.above_percent) == (pytest.approx(10, abs=0.2), pytest.approx(20, abs=0.2))
    html = legend_html(legend)
    for words in ("µm", "10.0 % below", "removed: a plane tilted by", "RMS 0.0 µm"):
        assert words in html
    assert legend_html(None) == ""
