import numpy as np
import pytest

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.messages import ResultTiles, TileHeader
from acquire.contract.messaging.point_record import POINT
from process.viewer.rig_client.tile import BoundingBox, Tile, bounding_box_of, merged, parse_tiles, power_of_two


def message(*headers: TileHeader) -> ResultTiles:
    return ResultTiles(version=1, folded_through=0, snapshot=False, tiles=list(headers))


def tile_of(xyz: np.ndarray, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Tile:
    count = len(xyz)
    zeros = np.zeros(count, np.float32)
    return Tile(origin, xyz.astype(np.float32), np.full((count, 3), 100, np.uint8), np.zeros(count, bool), zeros, zeros)


def test_a_tenth_of_a_micron_survives_far_from_the_origin() -> None:
    points = np.zeros(2, POINT)
    points["x"] = [0.0, 0.0001]
    tiles, _ = parse_tiles(message(TileHeader(3, 2, 0, (812.5, 40.0, 2.0))), points.tobytes())
    assert np.diff(tiles[3].xyz[:, 0]) == pytest.approx(0.0001, rel=1e-6)
    assert tiles[3].xyz.dtype == np.float32


def test_points_that_are_not_finite_are_left_out_and_counted() -> None:
    points = np.zeros(3, POINT)
    points["z"][1] = np.nan
    tiles, left_out = parse_tiles(message(TileHeader(0, 3, 0, (0.0, 0.0, 0.0))), points.tobytes())
    assert (tiles[0].count, left_out) == (2, 1)


def test_a_tile_with_an_origin_that_is_not_finite_is_left_out_whole() -> None:
    tiles, left_out = parse_tiles(message(TileHeader(0, 2, 0, (float("inf"), 0.0, 0.0))), np.zeros(2, POINT).tobytes())
    assert (tiles[0].count, left_out) == (0, 2)


def test_a_payload_of_another_length_than_announced_is_refused() -> None:
    with pytest.raises(ProtocolError, match="were announced"):
        parse_tiles(message(TileHeader(0, 2, 0, (0.0, 0.0, 0.0))), np.zeros(1, POINT).tobytes())


def test_a_box_keeps_what_is_inside_wherever_the_tile_has_its_origin() -> None:
    tile = tile_of(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), (100.0, 0.0, 0.0))
    kept = tile.inside(BoundingBox((100.5, -1.0, -1.0), (102.0, 1.0, 1.0)))
    assert kept.points_mm()[:, 0].tolist() == [101.0, 102.0]


@pytest.mark.parametrize(("points", "expected"), [(0, 1), (1000, 1), (1001, 2), (2001, 4), (9000, 16)])
def test_thinning_keeps_the_budget_with_the_smallest_power_of_two(points: int, expected: int) -> None:
    assert power_of_two(points, 1000) == expected


def test_thinning_is_even_and_not_in_step_with_image_rows() -> None:
    side = 64
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    tile = tile_of(np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1))
    kept = tile.thinned(4).xyz
    assert len(kept) == pytest.approx(side * side / 4, rel=0.01)
    cells = np.histogram2d(kept[:, 0], kept[:, 1], bins=8)[0]
    assert cells.min() > 0.5 * cells.mean()
    assert np.bincount(kept[:, 0].astype(int), minlength=side).min() > 4, "a column of the image has vanished"


def test_what_a_strong_thinning_keeps_a_weaker_one_keeps_too() -> None:
    tile = tile_of(np.arange(3000, dtype=float).reshape(1000, 3))
    strong, weak = tile.thinned(8).xyz[:, 0], tile.thinned(2).xyz[:, 0]
    assert set(strong) <= set(weak)


def test_a_stray_point_does_not_move_the_bounds() -> None:
    xyz = np.random.default_rng(1).uniform(-1, 1, (2000, 3))
    xyz[77] = (500.0, 0.0, 0.0)
    box = bounding_box_of([tile_of(xyz)])
    assert box is not None
    assert box.high[0] < 1.0


def test_no_points_have_no_bounds() -> None:
    assert bounding_box_of([tile_of(np.zeros((0, 3)))]) is None


def test_merged_tiles_keep_every_point_where_it_was() -> None:
    one, two = tile_of(np.ones((2, 3)), (10.0, 0.0, 0.0)), tile_of(np.ones((1, 3)), (0.0, 20.0, 0.0))
    joined = merged([one, two], (1.0, 1.0, 1.0))
    assert (joined.xyz + np.asarray(joined.origin_mm)).tolist() == [[11, 1, 1], [11, 1, 1], [1, 21, 1]]
