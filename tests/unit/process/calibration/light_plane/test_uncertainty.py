"""The uncertainty of a light plane: honest over many seeds, and told by source."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.light_plane.edge_on_surface import clustered
from process.calibration.light_plane.uncertainty import camera_covariance
from tests.accuracy.uncertainty import COARSE, SMALL, figures


@pytest.mark.parametrize(("rig", "seeds"), [(COARSE, 6), (SMALL, 4)])
def test_errors_are_as_large_as_their_standard_deviations_say(rig, seeds):
    found = figures(rig, range(seeds))
    assert 0.3 < found["chi_squared_per_degree_of_freedom"] < 2.0
    assert 0.4 < found["normal_error_deg"] / found["normal_sd_deg"] < 1.7
    assert 0.4 < found["speed_error_percent"] / found["speed_sd_percent"] < 1.7
    assert 0.4 < found["point_error_um_on_the_stage"] / found["point_predicted_um_on_the_stage"] < 1.7


def test_pixels_that_err_together_count_once():
    generator = np.random.default_rng(1)
    group = np.repeat(np.arange(100), 50)
    residual = generator.normal(size=100)[group]
    alone = clustered(np.ones((5000, 1)), residual, np.ones(5000), np.arange(5000))
    together = clustered(np.ones((5000, 1)), residual, np.ones(5000), group)
    assert together[0, 0] == pytest.approx(0.01, rel=0.35)
    assert together[0, 0] == pytest.approx(50 * alone[0, 0], rel=0.1)


def test_a_camera_whose_covariance_is_no_matrix_is_refused():
    with pytest.raises(CalibrationError, match="no 15 x 15 matrix"):
        camera_covariance({"camera": {"quality": {"covariance": [[1.0, 2.0]]}}})


def test_a_camera_of_another_origin_has_no_covariance():
    assert camera_covariance({"camera": {}}) is None
