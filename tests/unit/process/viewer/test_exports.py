import io
import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from plyfile import PlyData

from acquire.contract.errors import ScanFileError
from process.viewer.exports.figure import figure_png
from process.viewer.exports.files import report_of, screenshot_of
from process.viewer.exports.offline_page import page_html
from process.viewer.exports.results_list import facts_of, list_scans, open_scan
from process.viewer.exports.shown_cloud import ShownCloud, ply_bytes
from process.viewer.rig_client.feed import TileChanges
from process.viewer.rig_client.tile import Tile
from process.viewer.stream.colouring import ViewSettings
from process.viewer.stream.point_nodes import PointNodes
from tests.fakes.fake_results import hill_tiles


def tiles() -> dict[int, Tile]:
    return {
        header.tile: Tile(
            header.origin_mm,
            np.stack([points[axis] for axis in "xyz"], axis=1),
            np.stack([points[channel] for channel in ("red", "green", "blue")], axis=1),
            points["provisional"] != 0,
            points["crossing"],
            points["sigma_um"],
            np.full(len(points), 16, np.uint16),
        )
        for header, points in hill_tiles(4, 3, 12)
    }


def view(**look: Any) -> ShownCloud:
    cloud = PointNodes(ViewSettings(**look))
    cloud.take(TileChanges(tiles=tiles()))
    cloud.settle(10**12)
    return ShownCloud(
        "a <b>frog</b>",
        cloud.tiles,
        cloud.settings,
        cloud.range,
        cloud.plane,
        cloud.legend(),
        [("Outcome", "complete")],
    )


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    scan = tmp_path / "20260102T030405Z-frog"
    scan.mkdir()
    (scan / "cloud.ply").write_bytes(ply_bytes(tiles()))
    (scan / "report.json").write_text(json.dumps({"outcome": "stopped", "counts": {"points": 1728}}))
    (tmp_path / "20260101T000000Z-empty").mkdir()
    return tmp_path


def test_scans_with_a_cloud_are_listed_newest_first_with_outcome_and_points(data_dir: Path) -> None:
    shutil.copytree(data_dir / "20260102T030405Z-frog", data_dir / "20260305T000000Z-later")
    (data_dir / "20260305T000000Z-later" / "report.json").write_text("{broken")
    labels = [entry.label for entry in list_scans(data_dir)]
    assert labels == ["20260305T000000Z-later (no report)", "20260102T030405Z-frog (stopped, 1,728 points)"]
    assert list_scans(data_dir / "nowhere") == []


def test_an_opened_scan_has_every_point_with_what_is_known_of_it(data_dir: Path) -> None:
    opened = open_scan(list_scans(data_dir)[0])
    before = np.concatenate([tile.points_mm() for tile in tiles().values()])
    after = np.concatenate([tile.points_mm() for tile in opened.tiles.values()])
    assert np.sort(after, axis=0) == pytest.approx(np.sort(before, axis=0), abs=1e-6)
    for tile in opened.tiles.values():
        assert tile.quality is not None
        assert (tile.quality == 16).all()
        assert not tile.provisional.any()


@pytest.mark.parametrize("damage", [b"", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"])
def test_a_cloud_that_is_none_of_ours_is_refused_in_one_line(data_dir: Path, damage: bytes) -> None:
    entry = list_scans(data_dir)[0]
    (entry.folder / "cloud.ply").write_bytes(damage)
    with pytest.raises(ScanFileError) as caught:
        open_scan(entry)
    assert "\n" not in str(caught.value)


def test_the_downloaded_cloud_has_the_fields_of_cloud_ply() -> None:
    vertices = PlyData.read(io.BytesIO(ply_bytes(tiles())))["vertex"].data
    assert vertices.dtype.names == ("x", "y", "z", "red", "green", "blue", "sigma_um", "crossing", "quality")
    assert len(vertices) == 4 * 3 * 12 * 12
    assert len(PlyData.read(io.BytesIO(ply_bytes({})))["vertex"].data) == 0


def test_the_page_holds_its_numbers_and_legend_escaped_and_asks_nobody_for_anything() -> None:
    page = page_html(view(mode="height"))
    assert "a &lt;b&gt;frog&lt;/b&gt;" in page
    for words in ("complete", "Points shown", "1,728", "Height over z = 0", "__VISER_EMBED_DATA__"):
        assert words in page
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=[\"']https?://", page)


def test_a_page_without_points_is_still_a_page() -> None:
    empty = ShownCloud("nothing", {}, ViewSettings(), None, None, None)
    assert "nothing" in page_html(empty)
    assert figure_png(empty).startswith(b"\x89PNG")


def test_the_figure_shows_the_cloud_in_the_colours_of_the_page() -> None:
    drawn = cv2.imdecode(np.frombuffer(figure_png(view(mode="height")), np.uint8), cv2.IMREAD_COLOR)
    blue, green, red = np.moveaxis(drawn.astype(int), 2, 0)
    violet = (blue > red + 20) & (green < 90)
    assert violet.mean() > 0.05, "the low ground in the lowest colours"


def test_a_rendering_without_background_gets_that_of_the_page() -> None:
    half = np.zeros((1, 2, 4), np.uint8)
    half[0, 1] = (200, 100, 50, 255)
    drawn = cv2.imdecode(np.frombuffer(screenshot_of(half), np.uint8), cv2.IMREAD_COLOR)
    assert drawn[0].tolist() == [[20, 20, 20], [50, 100, 200]]


def test_a_report_of_a_scan_without_results_is_refused_in_one_line(data_dir: Path) -> None:
    for folder in (None, data_dir / "20260102T030405Z-frog"):
        with pytest.raises(ScanFileError) as caught:
            report_of(folder)
        assert "\n" not in str(caught.value)


def test_the_facts_of_a_scan_are_those_of_its_report_and_without_one_it_is_still_running(data_dir: Path) -> None:
    assert facts_of(data_dir / "20260102T030405Z-frog") == [("Outcome", "stopped"), ("Points", "1728")]
    assert facts_of(data_dir / "20260101T000000Z-empty") == facts_of(None) == [("Outcome", "still running")]
