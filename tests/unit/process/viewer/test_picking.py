import numpy as np
import pytest

from process.viewer.panels.picking import Distance, PickedPoint, Ray, measurements_csv, pick, profile, quality_words
from process.viewer.rig_client.tile import BoundingBox, Tile

DOWN = Ray((0.0, 0.0, 50.0), (0.0, 0.0, -2.0), 0.001)


def tile(xyz: list[tuple[float, float, float]], origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Tile:
    count = len(xyz)
    return Tile(
        origin,
        np.array(xyz, np.float32).reshape(-1, 3),
        np.zeros((count, 3), np.uint8),
        np.zeros(count, bool),
        np.arange(count, dtype=np.float32),
        np.full(count, 0.5, np.float32),
        np.full(count, 8 | 16, np.uint16),
    )


def at(
    x: float, y: float, z: float, sigma_um: float = 0.0, along: tuple[float, float, float] | None = None
) -> PickedPoint:
    return PickedPoint((x, y, z), sigma_um, 0.0, 0, provisional=False, along=along)


def test_a_click_snaps_to_a_real_point_and_tells_all_of_it() -> None:
    found = pick([tile([(3.0, 0, 1), (0.05, 0, 1), (-2.0, 0, 1)], (0.0, 0.0, 1.0))], DOWN, 0.01, np.array([0, 0, 77.0]))
    assert found is not None
    assert found.xyz_mm == pytest.approx((0.05, 0.0, 2.0))
    assert (found.sigma_um, found.crossing, found.quality) == (0.5, 1.0, 24)
    assert found.along is not None
    assert found.along[2] == pytest.approx(-1.0, abs=1e-3)


def test_the_front_of_an_object_hides_its_back() -> None:
    found = pick([tile([(0.0, 0, -9)]), tile([(0.1, 0, 4)])], DOWN, 0.01, None)
    assert found is not None
    assert found.xyz_mm[2] == pytest.approx(4.0)


@pytest.mark.parametrize("points", [[], [(9.0, 0.0, 0.0)], [(0.0, 0.0, 99.0)]])
def test_where_nothing_is_before_the_eye_nothing_is_picked(points: list[tuple[float, float, float]]) -> None:
    assert pick([tile(points)], DOWN, 0.01, None) is None


def test_what_is_clipped_away_cannot_be_picked() -> None:
    found = pick([tile([(0.0, 0, 4), (0.0, 0, 1)])], DOWN, 0.01, None, BoundingBox((-1, -1, 0), (1, 1, 2)))
    assert found is not None
    assert found.xyz_mm[2] == pytest.approx(1.0)


def test_a_distance_has_its_parts_and_the_uncertainty_of_each_along_itself() -> None:
    ray = (0.0, 0.0, -1.0)
    found = Distance(at(0, 0, 0, 0.3, ray), at(3, 4, 12, 0.4, ray))
    assert (found.straight.um, found.horizontal.um, found.height.um) == pytest.approx((13_000, 5_000, 12_000))
    assert found.height.sigma_um == pytest.approx(0.5)
    assert found.horizontal.sigma_um == pytest.approx(0.0)
    assert found.straight.sigma_um == pytest.approx(0.5 * 12 / 13)


def test_without_a_calibration_the_uncertainty_is_that_of_the_worst_direction() -> None:
    assert Distance(at(0, 0, 0, 0.3), at(1, 0, 0, 0.4)).horizontal.sigma_um == pytest.approx(0.5)


def test_two_points_in_one_place_are_no_distance_apart() -> None:
    assert Distance(at(1, 1, 1, 0.1), at(1, 1, 1, 0.1)).straight.um == 0.0
    assert profile([tile([(1.0, 1, 1)])], Distance(at(1, 1, 1), at(1, 1, 2)), 0.1) is None


def test_a_section_follows_the_heights_along_its_line_and_has_gaps_where_there_are_none() -> None:
    x = np.linspace(-1.0, 2.0, 3001)
    x = x[(x < 0.4) | (x > 0.6)]
    points = [(float(one), 0.0, float(one**2)) for one in x] + [(0.5, 3.0, 77.0)]
    found = profile([tile(points)], Distance(at(0, 0, 0), at(1, 0, 1)), 0.1, bins=10)
    assert found is not None
    assert found.along_mm == pytest.approx(np.arange(10) / 10 + 0.05)
    assert np.flatnonzero(np.isnan(found.mean_mm)).tolist() == [4, 5]
    assert found.mean_mm[9] == pytest.approx(0.9038, abs=0.005)
    assert found.low_mm[9] < found.mean_mm[9] < found.high_mm[9]


def test_the_csv_names_scan_units_and_what_speaks_against_a_point() -> None:
    header, line = measurements_csv("frog", [("D1", Distance(at(0, 0, 0, 0.3), at(0, 0, 0.25, 0.4)))]).splitlines()
    row = dict(zip(header.split(","), line.split(","), strict=True))
    assert (row["scan"], row["name"], row["straight_um"], row["height_um"]) == ("frog", "D1", "250.000", "250.000")
    assert row["quality1"] == "good"
    assert quality_words(8 | 16) == "saturated, several crossings"
    assert "not known" in quality_words(None)
