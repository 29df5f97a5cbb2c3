"""Pictures are imported and reconstructed: the known figures, the right points, the photograph's colours.

Once with the small sequence in tests/data, once with a public scan of a frog where it is (see README).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import h5py
import numpy as np
import pytest
from plyfile import PlyData

from acquire.contract.calibration import load_calibration
from acquire.importing.folder import import_folder
from process.cloud.light_planes import planes_at
from process.cloud.triangulation import rays
from process.results.reconstruct import Summary, reconstruct
from process.results.settings import ReconstructOptions
from tests import ROOT
from tests.reference.two_pass import two_pass

BONE = ROOT / "tests" / "data" / "bone"


@dataclass(frozen=True)
class Known:
    """What is known of a sequence of pictures beforehand."""

    edge: Literal["rising", "falling"]
    lit: str
    """A picture in which all that gets points is lit; empty: there is none, and the lightest of all counts."""
    frames: int
    over_contrast: int
    past_s_in_first: int
    crossings: int
    sum_of_crossings: float
    planes: tuple[int, int]
    """First and last frame, counted from 1, that the calibration has planes for."""
    within_planes: int
    points: int


KNOWN = {
    # documented beside the pictures
    "frog": Known("falling", "000001.jpg", 166, 172_192, 8, 172_184, 15_773_369.54, (47, 149), 122_001, 122_001),
    # by tests/reference/two_pass.py: see the test of these figures
    "bone": Known("rising", "", 66, 1000, 0, 1000, 37_782.37, (1, 66), 1000, 987),
}


class Sequence(NamedTuple):
    """A sequence, the scan that it became, and its cloud by two samples for each crossing."""

    known: Known
    folder: Path
    scan: Path
    summary: Summary


def imported(folder: Path, known: Known, target: Path) -> Sequence:
    scan = target / "scan.h5"
    import_folder(folder / "frames", scan)
    options = ReconstructOptions(
        calibration=folder / "calibration.json", edge=known.edge, contrast=50, median=0, method="linear"
    )
    return Sequence(known, folder, scan, reconstruct(scan, options))


@pytest.fixture(scope="module")
def bone(tmp_path_factory: pytest.TempPathFactory) -> Sequence:
    return imported(BONE, KNOWN["bone"], tmp_path_factory.mktemp("bone"))


@pytest.fixture(scope="module")
def frog(real_scan: Path, tmp_path_factory: pytest.TempPathFactory) -> Sequence:
    return imported(real_scan, KNOWN["frog"], tmp_path_factory.mktemp("frog"))


@pytest.fixture(params=KNOWN)
def sequence(request: pytest.FixtureRequest) -> Sequence:
    found = request.getfixturevalue(request.param)
    assert isinstance(found, Sequence)
    return found


def test_the_known_figures_of_the_bone_are_those_of_two_passes_over_all_pictures():
    read = [cv2.imread(str(path)) for path in sorted((BONE / "frames").glob("*.png"))]
    frames, known = [cv2.cvtColor(picture, cv2.COLOR_BGR2RGB) for picture in read], KNOWN["bone"]
    maps = two_pass(
        list(range(len(frames))), frames, bit_depth=8, edge=known.edge, contrast=50, median=0, noise_counts=2.0
    )
    over, first = maps.mask > 0, (maps.quality & 1) > 0
    assert (len(frames), over.sum(), first.sum()) == (known.frames, known.over_contrast, known.past_s_in_first)
    assert np.isfinite(maps.crossing).sum() == known.crossings
    assert np.nansum(maps.crossing) == pytest.approx(known.sum_of_crossings, abs=0.005)
    assert (over & ((maps.quality & (1 | 2)) == 0)).sum() == known.points


@pytest.mark.parametrize(("method", "median_um", "rms_um"), [("linear", 1.3, 2.0), ("auto", 0.9, 1.6)])
def test_the_points_of_the_bone_are_where_it_truly_is(bone, tmp_path, method, median_um, rms_um):
    options = ReconstructOptions(
        calibration=BONE / "calibration.json", edge="rising", contrast=50, median=0, method=method, out=tmp_path
    )
    cloud = reconstruct(bone.scan, options).results.cloud
    truth = np.load(BONE / "truth.npz")
    seen = truth["visible"].ravel()[cloud.pixels] == 1
    off = (cloud.points_mm - truth["points_mm"].reshape(-1, 3)[cloud.pixels])[seen]
    error_um = 1000 * np.linalg.norm(off, axis=1)
    assert seen.sum() > 900
    assert np.median(error_um) < median_um and np.sqrt(np.mean(error_um**2)) < rms_um


def test_the_mask_the_crossings_and_their_sum_are_the_known_ones(sequence):
    counts, known = sequence.summary.results.report.counts, sequence.known
    found = counts["over_contrast"], counts["past_s_in_first"], counts["crossings"]
    assert found == (known.over_contrast, known.past_s_in_first, known.crossings)
    with h5py.File(sequence.summary.paths.maps) as maps:
        crossing = maps["crossing"][()]
    assert crossing.dtype == np.float64
    assert np.nansum(crossing) == pytest.approx(known.sum_of_crossings, abs=0.005)


def test_the_scan_is_complete_and_nothing_is_warned_of(sequence):
    count = sequence.known.frames
    assert sequence.summary.complete and sequence.summary.warnings == []
    assert sequence.summary.outcome_text == f"SAVED: {count} of {count} frames are safe"


def test_every_crossing_within_the_planes_gets_a_point_of_that_plane_on_that_ray(sequence):
    known, cloud = sequence.known, sequence.summary.results.cloud
    calibration, _ = load_calibration(sequence.folder / "calibration.json")
    with h5py.File(sequence.summary.paths.maps) as maps:
        t = maps["crossing"][()].ravel() + 1
        left_out = (maps["quality"][()].ravel() & (1 | 2 | 128)) != 0
    inside = (t >= known.planes[0]) & (t <= known.planes[1])
    assert int(inside.sum()) == known.within_planes
    assert cloud is not None
    assert len(cloud) == sequence.summary.points == known.points
    assert np.array_equal(cloud.pixels, np.flatnonzero(inside & ~left_out))
    planes = planes_at(calibration.light_plane, cloud.crossing + 1)
    seen = rays(calibration.camera)
    directions = seen.directions[cloud.pixels]
    depth = (planes[:, 3] - planes[:, :3] @ seen.centre_mm) / (planes[:, :3] * directions).sum(axis=1)
    assert np.abs(cloud.points_mm - seen.centre_mm - depth[:, None] * directions).max() < 1e-8


def test_the_cloud_has_the_colours_of_the_photograph(sequence):
    cloud = PlyData.read(str(sequence.summary.paths.cloud))["vertex"].data
    pixels = sequence.summary.results.cloud.pixels
    pictures = [path for path in (sequence.folder / "frames").iterdir() if sequence.known.lit in path.name]
    photograph = np.max([cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB) for path in pictures], axis=0)
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
    auto = reconstruct(frog.scan, options)
    for name, linear_mm, probit_mm in (("wall", 3.20, 2.17), ("floor", 1.73, 1.27)):
        linear, points, _ = _spread_mm(frog.summary, planes[name])
        found, kept, histogram = _spread_mm(auto, planes[name])
        assert linear == pytest.approx(linear_mm, abs=0.01)
        assert found < 0.95 * probit_mm and kept > 0.99 * points
        assert histogram.max() < 1.3 * histogram.mean() and histogram.min() > 0.7 * histogram.mean()
