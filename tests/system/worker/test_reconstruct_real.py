"""The public scan of a frog: the documented figures come out, and the cloud has the photograph's colours."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from plyfile import PlyData

from acquire.contract.calibration import load_calibration
from acquire.importing.folder import import_folder
from process.cloud.triangulation import planes_at, rays
from process.results.reconstruct import Summary, reconstruct
from process.results.settings import ReconstructOptions


@pytest.fixture(scope="module")
def frog(real_scan: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Summary]]:
    scan = tmp_path_factory.mktemp("frog") / "frog.h5"
    import_folder(real_scan / "frames", scan)
    options = ReconstructOptions(
        calibration=real_scan / "calibration.json", edge="falling", contrast=50, median=0, method="linear"
    )
    yield scan, reconstruct(scan, options)


def test_the_mask_the_crossings_and_their_sum_are_the_documented_ones(frog):
    counts = frog[1].results.report.counts
    assert (counts["over_contrast"], counts["past_s_in_first"], counts["crossings"]) == (172_192, 8, 172_184)
    with h5py.File(frog[1].paths.maps) as maps:
        crossing = maps["crossing"][()]
    assert crossing.dtype == np.float64
    assert np.nansum(crossing) == pytest.approx(15_773_369.54, abs=0.005)


def test_the_scan_is_complete_and_nothing_is_warned_of(frog):
    assert frog[1].complete and frog[1].warnings == []
    assert frog[1].outcome_text == "SAVED: 166 of 166 frames are safe"


def test_every_crossing_within_the_planes_gets_a_point_of_that_plane_on_that_ray(frog, real_scan):
    calibration, _ = load_calibration(real_scan / "calibration.json")
    with h5py.File(frog[1].paths.maps) as maps:
        t = maps["crossing"][()].ravel() + 1
        left_out = (maps["quality"][()].ravel() & (1 | 2 | 128)) != 0
    inside = (t >= 47) & (t <= 149)
    assert int(inside.sum()) == 122_001
    cloud = frog[1].results.cloud
    assert cloud is not None
    assert len(cloud) == frog[1].points == 122_001
    assert np.array_equal(cloud.pixels, np.flatnonzero(inside & ~left_out))
    planes = planes_at(calibration.light_plane, cloud.crossing + 1)
    directions = rays(calibration.camera).directions[cloud.pixels]
    depth = planes[:, 3] / (planes[:, :3] * directions).sum(axis=1)
    assert np.abs(cloud.points_mm - depth[:, None] * directions).max() < 1e-8


def test_the_cloud_has_the_colours_of_the_photograph(frog, real_scan):
    cloud = PlyData.read(str(frog[1].paths.cloud))["vertex"].data
    pixels = frog[1].results.cloud.pixels
    photograph = cv2.cvtColor(cv2.imread(str(real_scan / "frames" / "000001.jpg")), cv2.COLOR_BGR2RGB)
    seen = photograph.reshape(-1, 3)[pixels].astype(float)
    found = np.stack([cloud["red"], cloud["green"], cloud["blue"]], axis=1).astype(float)
    assert np.median(np.abs(found - seen)) < 8
    assert np.corrcoef(found[:, 0] - found[:, 2], seen[:, 0] - seen[:, 2])[0, 1] > 0.9


def _spread_mm(summary: Summary, plane: dict) -> tuple[float, int, np.ndarray]:
    """Robust sigma of the distance from a reference plane, number of points, histogram of the fractional part."""
    cloud = summary.results.cloud
    left, right, top, bottom = plane["image_region_px"]
    row, column = np.divmod(cloud.pixels, 512)
    inside = (column >= left) & (column <= right) & (row >= top) & (row <= bottom)
    distance = (cloud.points_mm[inside] - plane["T"]) @ np.array(plane["R"])[:, 2]
    distance = distance[np.abs(distance - np.median(distance)) < 30]
    histogram = np.histogram(cloud.crossing[inside] % 1, bins=10, range=(0, 1))[0]
    return 1.4826 * np.median(np.abs(distance - np.median(distance))), int(inside.sum()), histogram


def test_auto_is_closer_to_the_reference_planes_than_two_samples_are(frog, real_scan, tmp_path):
    planes = json.loads((real_scan / "calibration.json").read_text())["reference_planes"]
    options = ReconstructOptions(
        calibration=real_scan / "calibration.json", edge="falling", contrast=50, median=0, method="auto", out=tmp_path
    )
    auto = reconstruct(frog[0], options)
    for name, linear_mm, probit_mm in (("wall", 3.20, 2.17), ("floor", 1.73, 1.27)):
        linear, points, _ = _spread_mm(frog[1], planes[name])
        found, kept, histogram = _spread_mm(auto, planes[name])
        assert linear == pytest.approx(linear_mm, abs=0.01)
        assert found < 0.95 * probit_mm and kept > 0.99 * points
        assert histogram.max() < 1.3 * histogram.mean() and histogram.min() > 0.7 * histogram.mean()
