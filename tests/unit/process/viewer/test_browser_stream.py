"""What a browser ends up with over any connection: nodes and stream together, with a browser of plain arrays."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from process.viewer.rig_client.feed import TileChanges
from process.viewer.rig_client.tile import BoundingBox, Tile
from process.viewer.stream import point_nodes
from process.viewer.stream.browser_stream import LEAST_STEP_BYTES, STEP_NS, BrowserStream
from process.viewer.stream.colouring import ViewSettings
from process.viewer.stream.point_nodes import MAX_NODES, SMALL_NS, PointNodes


class Browser:
    """Remembers what was sent, as a browser would."""

    def __init__(self, rate_bytes_per_s: float = 1e9) -> None:
        self.rate_bytes_per_s = rate_bytes_per_s
        self.eye_mm: np.ndarray | None = None
        self.busy = False
        self.file_parts = 0
        self.nodes: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.sizes: dict[int, float] = {}
        self.log: list[tuple[str, int]] = []
        self.origin = (0.0, 0.0, 0.0)

    def idle(self) -> bool:
        return not self.busy

    def send_file_part(self) -> bool:
        if self.file_parts:
            self.file_parts -= 1
            self.log.append(("file", self.file_parts))
            return True
        return False

    def begin(self, origin_mm: tuple[float, float, float]) -> None:
        self.origin = origin_mm

    def put(self, node: int, points: np.ndarray, colours: np.ndarray, size_mm: float) -> None:
        assert (points.dtype, colours.dtype) == (np.float32, np.uint8)
        self.log.append(("put", node))
        self.nodes[node], self.sizes[node] = (points, colours), size_mm

    def paint(self, node: int, colours: np.ndarray) -> None:
        self.log.append(("paint", node))
        self.nodes[node] = (self.nodes[node][0], colours)

    def resize(self, node: int, size_mm: float) -> None:
        self.log.append(("resize", node))
        self.sizes[node] = size_mm

    def remove(self, node: int) -> None:
        del self.nodes[node]

    def all_points(self) -> np.ndarray:
        return np.concatenate([points.astype(float) + self.origin for points, _ in self.nodes.values()])


class Rig:
    """A cloud, and one stream for each browser, with a clock."""

    def __init__(self, *browsers: Browser, **look: Any) -> None:
        self.cloud = PointNodes(ViewSettings(**look))
        self.browsers = browsers or (Browser(),)
        self.streams = [BrowserStream(browser) for browser in self.browsers]
        self.now_ns = 0

    def step(self) -> list[int]:
        self.now_ns += STEP_NS
        self.cloud.settle(self.now_ns)
        return [stream.turn(self.cloud, self.now_ns) for stream in self.streams]

    def show(self, *, reset: bool = False, **tiles: Tile) -> None:
        self.cloud.take(TileChanges(reset, {int(name[1:]): points for name, points in tiles.items()}))
        for _ in range(200):
            if not any(self.step()):
                return
        raise AssertionError("it never ends")


def tile(count: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Tile:
    xyz = np.stack([np.arange(count) * 0.0001, np.zeros(count), np.zeros(count)], axis=1).astype(np.float32)
    zeros = np.zeros(count, np.float32)
    return Tile(origin, xyz, np.zeros((count, 3), np.uint8), np.zeros(count, bool), zeros, zeros)


def test_only_the_tile_that_changed_is_sent_and_under_the_same_number() -> None:
    rig = Rig()
    (browser,) = rig.browsers
    rig.show(t1=tile(5), t2=tile(5))
    before = len(browser.log)
    rig.show(t2=tile(7))
    assert browser.log[before:] == [("put", 2)]
    assert len(browser.all_points()) == 12


def test_a_snapshot_that_repeats_what_is_known_sends_nothing() -> None:
    rig = Rig()
    rig.show(t1=tile(5), t2=tile(5))
    seen = len(rig.browsers[0].log)
    rig.show(reset=True, t1=tile(5), t2=tile(6))
    assert rig.browsers[0].log[seen:] == [("put", 2)]


def test_a_change_that_nobody_would_see_waits_and_is_shown_in_the_end() -> None:
    rig = Rig()
    rig.show(t1=tile(1000))
    seen = len(rig.browsers[0].log)
    moved = replace(tile(1000), crossing=np.ones(1000, np.float32))
    moved.xyz[7] += 1.0
    rig.cloud.take(TileChanges(tiles={1: moved}))
    assert rig.step() == [0]
    rig.now_ns += SMALL_NS
    assert rig.step() == [1000 * 15]
    assert len(rig.browsers[0].log) == seen + 1
    rig.show(reset=True, t1=tile(1000))
    assert len(rig.browsers[0].log) == seen + 2, "a snapshot is shown at once"


def test_tenths_of_a_micron_survive_the_way_to_the_browser() -> None:
    rig = Rig()
    rig.show(t0=tile(3, (250.0, -3.0, 7.0)), t9=tile(3, (262.0, 5.0, 9.0)))
    for points, _ in rig.browsers[0].nodes.values():
        assert np.diff(points[:, 0].astype(float)) == pytest.approx(0.0001, rel=0.02)
    assert rig.browsers[0].all_points()[:, 0].max() == pytest.approx(262.0002, abs=1e-5)


def test_a_new_scan_removes_the_tiles_of_the_one_before() -> None:
    rig = Rig()
    rig.show(t1=tile(5), t2=tile(5))
    rig.show(reset=True, t2=tile(3, (500.0, 0.0, 0.0)))
    assert len(rig.browsers[0].nodes) == 1
    assert rig.browsers[0].all_points()[:, 0].min() == pytest.approx(500.0)


def test_a_tile_that_lost_its_points_disappears() -> None:
    rig = Rig()
    rig.show(t1=tile(5), t2=tile(5))
    rig.show(t1=tile(0))
    assert list(rig.browsers[0].nodes) == [2]


def test_a_cloud_over_the_budget_is_thinned_everywhere_and_a_larger_budget_brings_the_rest() -> None:
    rig = Rig(max_points=1000)
    rig.show(t1=tile(900))
    assert rig.cloud.fine == 1
    rig.show(t2=tile(900))
    assert rig.cloud.fine == 2
    assert [len(points) for points, _ in rig.browsers[0].nodes.values()] == pytest.approx([450, 450], abs=5)
    rig.cloud.show(replace(rig.cloud.settings, max_points=5000))
    rig.show()
    assert len(rig.browsers[0].all_points()) == 1800


def test_more_tiles_than_nodes_share_nodes_and_no_point_is_lost() -> None:
    rig = Rig()
    rig.show(t0=tile(2), t1=tile(2))
    rig.show(**{f"t{number}": tile(2) for number in range(2, 3 * MAX_NODES)})
    assert len(rig.browsers[0].nodes) <= MAX_NODES
    assert len(rig.browsers[0].all_points()) == 2 * 3 * MAX_NODES


def test_a_large_cloud_comes_as_an_overview_first_and_what_is_near_the_eye_is_refined_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(point_nodes, "OVERVIEW_POINTS", 5_000)
    browser = Browser(rate_bytes_per_s=200_000)
    browser.eye_mm = np.array([90.0, 0.0, 0.0])
    rig = Rig(browser)
    rig.cloud.take(TileChanges(tiles={number: tile(10_000, (10.0 * number, 0.0, 0.0)) for number in range(10)}))
    assert rig.step() == [pytest.approx(100_000 // 32 * 15, rel=0.05)]
    assert len(browser.nodes) == 10, "all of it is there, thinly"
    seen = len(browser.log)
    rig.show()
    assert browser.log[seen] == ("put", 9)
    assert len(browser.all_points()) == 100_000


def test_a_step_is_what_the_link_carries_and_the_next_waits_until_it_has_arrived() -> None:
    slow, fast = Browser(rate_bytes_per_s=10_000), Browser()
    rig = Rig(slow, fast)
    rig.cloud.take(TileChanges(tiles={number: tile(1000) for number in range(40)}))
    first = rig.step()
    assert first[0] < LEAST_STEP_BYTES + 1000 * 15
    assert first[1] == 40 * 1000 * 15
    slow.busy = True
    assert rig.step() == [0, 0]
    rig.cloud.take(TileChanges(tiles={3: tile(500)}))
    assert rig.step() == [0, 500 * 15], "a browser that hangs keeps nobody waiting"


def test_a_browser_that_falls_behind_gets_overviews_of_what_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_nodes, "OVERVIEW_POINTS", 1_000)
    lagging, fast = Browser(rate_bytes_per_s=20_000), Browser()
    rig = Rig(lagging, fast)
    sent = [0, 0]
    for turn in range(5):
        moved = tile(4000, (0.0, 0.0, float(turn)))
        rig.cloud.take(TileChanges(tiles=dict.fromkeys(range(8), moved)))
        sent = [total + step for total, step in zip(sent, rig.step(), strict=True)]
    assert sent[1] == 5 * 8 * 4000 * 15
    assert sent[0] < sent[1] / 20
    assert set(lagging.nodes) == set(range(8))
    assert lagging.sizes[0] > fast.sizes[0], "thinner points are drawn larger"


def test_another_colour_mode_sends_colours_alone() -> None:
    rig = Rig()
    (browser,) = rig.browsers
    rig.show(t1=tile(50), t2=tile(50, (0.0, 0.0, 1.0)))
    points, before = dict(browser.nodes), len(browser.log)
    rig.cloud.show(replace(rig.cloud.settings, mode="height"))
    assert [rig.step(), rig.step()] == [[100 * 3], [0]]
    assert browser.log[before:] == [("paint", 1), ("paint", 2)]
    assert not np.array_equal(points[1][1], browser.nodes[1][1])
    legend = rig.cloud.legend()
    assert legend is not None
    assert legend.unit == "mm"


def test_a_clipping_box_sends_only_what_is_inside_it() -> None:
    rig = Rig()
    rig.show(t1=tile(100))
    rig.cloud.show(replace(rig.cloud.settings, box=BoundingBox((0.00495, -1.0, -1.0), (1.0, 1.0, 1.0))))
    rig.show()
    assert len(rig.browsers[0].all_points()) == 50
    rig.cloud.show(replace(rig.cloud.settings, box=None))
    rig.show()
    assert len(rig.browsers[0].all_points()) == 100


def test_a_bigger_point_is_set_without_sending_points_again() -> None:
    rig = Rig()
    (browser,) = rig.browsers
    rig.show(t1=tile(50))
    size = browser.sizes[1]
    rig.cloud.show(replace(rig.cloud.settings, size_factor=2.0))
    rig.step()
    assert browser.sizes[1] == pytest.approx(2 * size)
    assert browser.log == [("put", 1), ("resize", 1)]


def test_points_and_parts_of_a_file_take_turns() -> None:
    browser = Browser(rate_bytes_per_s=10_000)
    rig = Rig(browser)
    rig.cloud.take(TileChanges(tiles={number: tile(4000) for number in range(4)}))
    browser.file_parts = 3
    while browser.file_parts:
        rig.step()
    kinds = [kind for kind, _ in browser.log]
    assert kinds == ["file", "put", "file", "put", "file"]
