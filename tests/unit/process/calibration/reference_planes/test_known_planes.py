"""The file of reference planes is read, and each mistake in it is named."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.calibration.reference_planes.known_planes import read_planes
from tests.reference.shadow_sequence import RECTANGLE_MM, Room

ROOM = Room()
CAMERA = msgspec.convert(ROOM.camera, CameraModel)
NAN = float("nan")


def read(document: object, folder: Path) -> list:
    path = folder / "planes.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return read_planes(path, CAMERA)


def changed(**wall: object) -> dict:
    document = copy.deepcopy(ROOM.planes())
    document["reference_planes"]["wall"] |= wall
    return document


def test_planes_are_where_their_markers_are(tmp_path):
    for plane in read(ROOM.planes(), tmp_path):
        start, across, along = ROOM.surfaces[plane.name]
        assert abs(plane.normal @ np.cross(across, along)) == pytest.approx(1, abs=1e-6)
        assert plane.normal @ start == pytest.approx(plane.offset, abs=0.02)
        assert plane.misfit_px < 0.01


def test_each_plane_may_have_its_own_rectangle(tmp_path):
    document = ROOM.planes()["reference_planes"]
    del document["marker_rectangle_mm"]
    for name in ("wall", "floor"):
        document[name]["marker_rectangle_mm"] = list(RECTANGLE_MM)
    wall = np.array(document["wall"]["marker_corners_px"])
    # the same plane by a rectangle of half the height: its upper corners lie between
    assert [plane.misfit_px < 0.01 for plane in read({"reference_planes": document}, tmp_path)] == [True, True]
    document["wall"]["marker_rectangle_mm"] = [RECTANGLE_MM[0], 3 * RECTANGLE_MM[1]]
    with pytest.raises(
        CalibrationError, match=r"wall: marker_corners_px miss a rectangle of 400 x 600 mm by .* px RMS"
    ):
        read({"reference_planes": document}, tmp_path)
    assert wall.shape == (4, 2)


def test_corners_may_go_around_either_way(tmp_path):
    corners = ROOM.planes()["reference_planes"]["wall"]["marker_corners_px"]
    mirrored = [corners[1], corners[0], corners[3], corners[2]]
    given, other = (read(changed(marker_corners_px=order), tmp_path)[0] for order in (corners, mirrored))
    sign = np.sign(given.normal @ other.normal)
    assert np.allclose(given.normal, sign * other.normal, atol=1e-6)
    assert given.offset == pytest.approx(sign * other.offset, abs=1e-3)


CORNERS = ROOM.planes()["reference_planes"]["wall"]["marker_corners_px"]


@pytest.mark.parametrize(
    ("wall", "words"),
    [
        ({"image_region_px": [[10, 5], [90, 40]]}, "image_region_px is given as corners.*10, 90, 5, 40"),
        ({"image_region_px": [["a", 5], [90, 40]]}, "image_region_px is given as corners"),
        ({"image_region_px": [95, 3, 235, 150]}, r"another order.*meant: \[95, 235, 3, 150\]"),
        ({"image_region_px": [90, 20, 10, 40]}, "image_region_px .* is empty"),
        ({"image_region_px": [300, 400, 10, 40]}, "image_region_px .* less than 9 pixels"),
        ({"image_region_px": [10, 90, 1e300, 2e300]}, "outside of the picture"),
        ({"image_region_px": [10, 90, 10]}, "image_region_px is not four"),
        ({"image_region_px": []}, "image_region_px is not four"),
        ({"image_region_px": [10, 90, "10", 40]}, "image_region_px is not four"),
        ({"image_region_px": [10, 90, NAN, 40]}, "image_region_px is not four finite"),
        ({"image_region_px": {"left": 1}}, "image_region_px is not four"),
        ({"image_region_px": None}, "image_region_px is missing"),
        ({"image_region_px": True}, "image_region_px is not four"),
        ({"marker_corners_px": None}, "marker_corners_px is missing"),
        ({"marker_corners_px": CORNERS[:3]}, "marker_corners_px is not four"),
        ({"marker_corners_px": [[NAN, 1], *CORNERS[1:]]}, "marker_corners_px is not four"),
        ({"marker_corners_px": [CORNERS[i] for i in (0, 2, 1, 3)]}, "cross over"),
        ({"marker_corners_px": [CORNERS[0]] * 4}, "on one line"),
        ({"marker_corners_px": [CORNERS[i] for i in (1, 2, 3, 0)]}, "first two corners span .* begin with the next"),
        ({"marker_corners_px": (np.array(CORNERS) + 9e3).tolist()}, "outside of the picture"),
        ({"marker_rectangle_mm": [0, 5]}, "marker_rectangle_mm is not"),
        ({"marker_rectangle_mm": "400x200"}, "marker_rectangle_mm is not"),
        ({"marker_rectangle_mm": [400, 700]}, "miss a rectangle"),
    ],
)
def test_each_mistake_is_named_by_plane_and_key(wall, words, tmp_path):
    with pytest.raises(CalibrationError, match=r"planes\.json: wall: |wall: ") as error:
        read(changed(**wall), tmp_path)
    assert error.match(words) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no JSON"),
        ("[1]", "reference_planes is missing"),
        ('{"reference_planes": 3}', "reference_planes is missing"),
        ('{"reference_planes": {"wall": {}}}', r"1 were given \(wall\)"),
        ("[" * 100_000, "no JSON"),
    ],
)
def test_a_file_that_describes_no_planes_is_refused(text, words, tmp_path):
    with pytest.raises(CalibrationError, match=words):
        read(text, tmp_path)


def test_swapped_regions_are_refused(tmp_path):
    document = ROOM.planes()
    planes = document["reference_planes"]
    planes["wall"]["image_region_px"] = [90, 160, 105, 130]
    planes["floor"]["image_region_px"] = [90, 160, 50, 70]
    with pytest.raises(CalibrationError, match="swapped"):
        read(document, tmp_path)


def test_the_same_region_for_both_planes_is_refused(tmp_path):
    document = ROOM.planes()
    document["reference_planes"]["floor"]["image_region_px"] = document["reference_planes"]["wall"]["image_region_px"]
    with pytest.raises(CalibrationError, match="overlap"):
        read(document, tmp_path)


def test_a_region_that_reaches_out_of_the_picture_is_cut(tmp_path):
    assert read(changed(image_region_px=[-5, 300, 4, 60]), tmp_path)[0].region == (0, 255, 4, 60)


def test_one_reference_plane_is_not_enough(tmp_path):
    document = ROOM.planes()
    del document["reference_planes"]["wall"]
    with pytest.raises(CalibrationError, match="it takes two reference planes; 1 were given"):
        read(document, tmp_path)
