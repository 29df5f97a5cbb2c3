from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from process.viewer import cloud as cloud_module
from process.viewer.cloud import MAX_NODES, Cloud
from process.viewer.feed import TileNews
from process.viewer.tiles import Tile


class FakeScene:
    """Remembers what was sent, as a browser would."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}
        self.sent: list[str] = []
        self.origin = (0.0, 0.0, 0.0)

    def add_frame(self, name: str, *, show_axes: bool, position: tuple[float, float, float]) -> None:
        assert not show_axes
        self.origin = position

    def add_point_cloud(self, name: str, *, points: Any, point_size: float, **options: Any) -> Any:
        assert "position" not in options, "a pose of its own would be applied late"
        assert (points.dtype, options["precision"]) == (np.float32, "float32")
        self.sent.append(name)
        self.nodes[name] = SimpleNamespace(
            points=points, point_size=point_size, remove=lambda: self.nodes.pop(name, None)
        )
        return self.nodes[name]

    def all_points(self) -> np.ndarray:
        return np.concatenate([node.points.astype(float) + self.origin for node in self.nodes.values()])


@pytest.fixture
def scene() -> FakeScene:
    return FakeScene()


def cloud_of(scene: FakeScene, max_points: int = 1_000_000) -> Cloud:
    return Cloud(SimpleNamespace(scene=scene), max_points)


def tile(count: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Tile:
    xyz = np.stack([np.arange(count) * 0.0001, np.zeros(count), np.zeros(count)], axis=1).astype(np.float32)
    return Tile(origin, xyz, np.zeros((count, 3), np.uint8), np.zeros(count, bool))


def show(cloud: Cloud, *, reset: bool = False, **tiles: Tile) -> None:
    cloud.take(TileNews(reset, {int(name[1:]): points for name, points in tiles.items()}))
    while cloud.pending:
        cloud.draw()


def test_only_the_tile_that_changed_is_sent_and_under_the_same_name(scene: FakeScene) -> None:
    cloud = cloud_of(scene)
    show(cloud, t1=tile(5), t2=tile(5))
    before = list(scene.sent)
    show(cloud, t2=tile(7))
    assert scene.sent[len(before) :] == [before[1]]
    assert len(scene.nodes) == 2


def test_tenths_of_a_micron_survive_the_way_to_the_browser(scene: FakeScene) -> None:
    cloud = cloud_of(scene)
    show(cloud, t0=tile(3, (250.0, -3.0, 7.0)), t9=tile(3, (262.0, 5.0, 9.0)))
    for node in scene.nodes.values():
        assert np.diff(node.points[:, 0].astype(float)) == pytest.approx(0.0001, rel=0.02)
    assert scene.all_points()[:, 0].max() == pytest.approx(262.0002, abs=1e-5)


def test_a_new_scan_removes_the_tiles_of_the_one_before(scene: FakeScene) -> None:
    cloud = cloud_of(scene)
    show(cloud, t1=tile(5), t2=tile(5))
    show(cloud, reset=True, t2=tile(3, (9.0, 0.0, 0.0)))
    assert len(scene.nodes) == 1
    assert scene.all_points()[:, 0].min() == pytest.approx(9.0)


def test_a_tile_that_lost_its_points_disappears(scene: FakeScene) -> None:
    cloud = cloud_of(scene)
    show(cloud, t1=tile(5), t2=tile(5))
    show(cloud, t1=tile(0))
    assert len(scene.nodes) == 1


def test_a_cloud_over_the_budget_is_thinned_everywhere_and_says_so(scene: FakeScene) -> None:
    cloud = cloud_of(scene, max_points=1000)
    show(cloud, t1=tile(900))
    assert cloud.keep_one_of == 1
    show(cloud, t2=tile(900))
    assert cloud.keep_one_of == 2
    assert [len(node.points) for node in scene.nodes.values()] == pytest.approx([450, 450], abs=5)


def test_more_tiles_than_nodes_share_nodes_and_no_point_is_lost(scene: FakeScene) -> None:
    cloud = cloud_of(scene)
    show(cloud, t0=tile(2), t1=tile(2))
    show(cloud, **{f"t{number}": tile(2) for number in range(2, 3 * MAX_NODES)})
    assert len(scene.nodes) <= MAX_NODES
    assert len(scene.all_points()) == 2 * 3 * MAX_NODES


def test_one_turn_sends_no_more_than_a_browser_digests_and_the_oldest_change_goes_first(
    scene: FakeScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cloud_module, "POINTS_PER_TURN", 100)
    cloud = cloud_of(scene)
    cloud.take(TileNews(tiles={number: tile(60) for number in range(5)}))
    assert cloud.draw() == 120
    assert scene.sent == ["/cloud/000", "/cloud/001"]
    assert cloud.pending == 3


def test_a_bigger_point_is_set_without_sending_points_again(scene: FakeScene) -> None:
    cloud = cloud_of(scene)
    show(cloud, t1=tile(50))
    size, sent = scene.nodes["/cloud/001"].point_size, len(scene.sent)
    cloud.size_factor = 2.0
    cloud.draw()
    assert scene.nodes["/cloud/001"].point_size == pytest.approx(2 * size)
    assert len(scene.sent) == sent
