"""Tiles of the live cloud: only what changed is sent, and it adds up to the whole."""

from __future__ import annotations

import numpy as np

from acquire.contract.messaging.point_record import POINT
from process.cloud.cloud import PointCloud
from process.worker.live_tiles import MAX_TILES, LiveTiles, TileGrid

WIDTH, HEIGHT = 200, 130


def cloud_of(pixels: list[int], crossing: float = 5.0) -> PointCloud:
    n = len(pixels)
    at = np.array(sorted(pixels), np.intp)
    points = np.stack([at % WIDTH * 0.007 - 40.0, at // WIDTH * 0.007 + 90.0, np.full(n, 0.25)], axis=1)
    return PointCloud(
        points_mm=points,
        rgb=np.full((n, 3), 9, np.uint8),
        sigma_um=np.full(n, 0.5, np.float32),
        crossing=np.full(n, crossing),
        quality=np.zeros(n, np.uint16),
        pixels=at,
    )


def none(cloud: PointCloud) -> np.ndarray:
    return np.zeros(len(cloud), bool)


def test_the_grid_covers_every_pixel_with_a_bounded_number_of_tiles():
    for width, height in ((1024, 768), (5472, 3648), (16, 16), (65, 64)):
        grid = TileGrid(width, height)
        tiles = grid.of(np.arange(width * height))
        assert grid.count <= MAX_TILES and tiles.max() == grid.count - 1
        assert len(np.unique(tiles)) == grid.count


def test_the_first_update_sends_every_tile_that_has_points():
    tiles = LiveTiles(WIDTH, HEIGHT)
    cloud = cloud_of([0, 1, 199, 129 * WIDTH])
    headers, payload = tiles.update(cloud, none(cloud))
    assert [(h.tile, h.count) for h in headers] == [(0, 2), (3, 1), (8, 1)]
    assert len(payload) == 4 * POINT.itemsize


def test_coordinates_about_the_tiles_origin_keep_steps_well_below_a_tenth_of_a_micrometre():
    tiles = LiveTiles(WIDTH, HEIGHT)
    cloud = cloud_of(list(range(64)))
    (header,), payload = tiles.update(cloud, none(cloud))
    points = np.frombuffer(payload, POINT)
    found = np.stack([points[axis] for axis in "xyz"], axis=1) + np.array(header.origin_mm)
    assert np.abs(found - cloud.points_mm).max() < 1e-7


def test_nothing_is_sent_while_nothing_changes():
    tiles = LiveTiles(WIDTH, HEIGHT)
    cloud = cloud_of([0, 1, 199])
    tiles.update(cloud, none(cloud))
    assert tiles.update(cloud_of([0, 1, 199], crossing=5.001), none(cloud)) == ([], b"")


def test_a_moved_crossing_a_new_point_and_a_settled_point_send_their_own_tile_only():
    tiles = LiveTiles(WIDTH, HEIGHT)
    pixels = [0, 100, 199]
    cloud = cloud_of(pixels)
    provisional = np.array([True, False, False])
    tiles.update(cloud, provisional)
    cloud.crossing[1] += 1.0
    assert [h.tile for h in tiles.update(cloud, provisional)[0]] == [1]
    assert [h.tile for h in tiles.update(cloud, none(cloud))[0]] == [0]
    more = cloud_of([0, 100, 198, 199])
    more.crossing[1] += 1.0
    assert [h.tile for h in tiles.update(more, none(more))[0]] == [3]


def test_points_that_vanish_leave_an_empty_tile_behind():
    tiles = LiveTiles(WIDTH, HEIGHT)
    cloud = cloud_of([0, 199])
    tiles.update(cloud, none(cloud))
    fewer = cloud_of([0])
    headers, payload = tiles.update(fewer, none(fewer))
    assert [(h.tile, h.count) for h in headers] == [(3, 0)] and payload == b""
    assert [h.tile for h in tiles.snapshot()[0]] == [0]


def test_a_pixel_that_takes_the_place_of_another_is_noticed():
    tiles = LiveTiles(WIDTH, HEIGHT)
    first, second = cloud_of([5]), cloud_of([6])
    tiles.update(first, none(first))
    assert [(h.tile, h.count) for h in tiles.update(second, none(second))[0]] == [(0, 1)]


def test_a_snapshot_holds_what_was_sent_in_all_updates():
    tiles = LiveTiles(WIDTH, HEIGHT)
    for pixels in ([0], [0, 199], [0, 199, 129 * WIDTH]):
        cloud = cloud_of(pixels)
        tiles.update(cloud, none(cloud))
    headers, payload = tiles.snapshot()
    assert [h.tile for h in headers] == [0, 3, 8]
    assert len(payload) == 3 * POINT.itemsize


def test_an_empty_cloud_is_no_trouble():
    tiles = LiveTiles(WIDTH, HEIGHT)
    assert tiles.update(cloud_of([]), np.zeros(0, bool)) == ([], b"")
