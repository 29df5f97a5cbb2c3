"""Frames without a light plane: no points in the gap, points up to it on both sides."""

from __future__ import annotations

import json

import numpy as np
import pytest

from acquire.contract.calibration import CameraModel, PerFramePlanes, parse_calibration
from acquire.contract.errors import CalibrationError
from process.cloud.light_planes import plane_table, planes_at
from process.cloud.triangulation import Hits, intersect, rays

EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
CAMERA = CameraModel(width=4, height=4, K=((4.0, 0.0, 1.5), (0.0, 4.0, 1.5), (0.0, 0.0, 1.0)), R=EYE, T=(0.0, 0.0, 0.0))
ROWS = tuple(None if t in (4, 5) else (0.0, 0.0, 1.0, 100.0 + t) for t in range(1, 9))
PLANES = PerFramePlanes("frame", 1, ROWS)


def test_points_end_where_the_gap_begins_and_begin_where_it_ends():
    t = np.array([1.0, 2.5, 3.0, 3.01, 4.0, 4.5, 5.99, 6.0, 7.5, 8.0])
    known = np.array([1, 1, 1, 0, 0, 0, 0, 1, 1, 1], bool)
    hits = Hits(np.zeros(len(t), np.intp), t - 1, np.ones(len(t), np.float32))
    points = intersect(rays(CAMERA), plane_table(PLANES), np.arange(1.0, 9.0), hits)[0]
    assert np.array_equal(np.isfinite(planes_at(PLANES, t)[:, 0]), known)
    assert np.array_equal(np.isfinite(points[:, 0]), known)
    assert np.allclose(points[known, 2], 100 + t[known])


def document(planes: list) -> str:
    camera = {"width": 4, "height": 4, "K": CAMERA.K, "R": EYE, "T": [0, 0, 0]}
    light = {"kind": "per-frame", "parameter": "frame", "first_frame": 1, "planes": planes}
    return json.dumps({"format": "sweepscope-calibration", "version": 1, "camera": camera, "light_plane": light})


def test_a_calibration_may_have_null_planes_but_not_only_these():
    assert parse_calibration(document([[0, 0, 1, 5], None, [0, 0, 1, 6]])).light_plane.planes[1] is None
    with pytest.raises(CalibrationError, match="no plane"):
        parse_calibration(document([None, None]))
