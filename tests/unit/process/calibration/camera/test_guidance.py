"""Advice while board views are collected."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation import Renderer, build_scene
from process.calibration.board.detection import Board
from process.calibration.board.guidance import ENOUGH_VIEWS, GRID, SIDES, ViewFacts, assess_view, guide, live_advice

BOARD = Board(16, 13, 0.3)


def picture(tilt_x: float = 0.0, tilt_y: float = 0.0) -> np.ndarray:
    config = SimulationConfig(object="checkerboard", colour=False, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y, seed=3)
    scene = build_scene(config, width=512, height=384, um_per_microstep=3.175)
    return Renderer(scene).render(4000, exposure_ms=30.0, gain=6.0, brightness=0.0)


def view(name: str, higher: str = "", tilt: float = 12.0, at: tuple[float, float] = (0.5, 0.5), **changes) -> ViewFacts:
    corners = tuple((at[0] + dx, at[1] + dy) for dx in (-0.1, 0.1) for dy in (-0.1, 0.1))
    return ViewFacts(name, True, "", changes.get("whole", True), corners, tilt if higher else 1.0, higher)


@pytest.mark.parametrize(
    ("tilt_x", "tilt_y", "higher"), [(0, 0, ""), (12, 0, "top"), (-12, 0, "bottom"), (0, 12, "left"), (0, -12, "right")]
)
def test_the_lean_of_a_board_is_told_from_one_picture(tilt_x, tilt_y, higher):
    found = assess_view("live", picture(tilt_x, tilt_y), BOARD)
    assert found.found and found.higher == higher, found.text()
    assert found.tilt_deg == pytest.approx(max(abs(tilt_x), abs(tilt_y)), abs=5.0)
    assert all(0 <= x <= 1 and 0 <= y <= 1 for x, y in found.corners)


def test_a_picture_without_a_board_says_why():
    found = assess_view("live", np.full((96, 128), 90, np.uint8), BOARD)
    assert not found.found and "no chessboard found" in found.text()
    assert live_advice(found, []).startswith("no board: ")


def test_without_views_the_flat_one_is_asked_for_first():
    found = guide([])
    assert not found.ready and "lay the board flat" in found.advice[0] and found.stage_view == ""


def test_after_one_side_the_other_way_is_asked_for():
    found = guide([view("flat"), view("a", "right"), view("b", "top"), view("c", "left")])
    assert found.stage_view == "flat"
    assert found.advice[0] == "tilt it the other way: bottom side higher"


def test_an_empty_corner_of_the_picture_is_named():
    spots = [(0.15, 0.15), (0.4, 0.15), (0.15, 0.8), (0.85, 0.8), (0.4, 0.8), (0.6, 0.8)]
    found = guide(
        [view("flat"), *[view(side, side, at=spot) for side, spot in zip((*SIDES, *SIDES), spots, strict=False)]]
    )
    assert found.advice[0] == "move it: corner top right is empty"
    assert len(found.coverage) == GRID[0] and found.coverage[0][3] == 0 and found.coverage[0][0] > 0


def test_a_part_of_the_board_lying_flat_cannot_carry_the_world():
    assert "lay the board flat" in guide([view("part", whole=False)]).advice[0]


def test_enough_is_called_enough():
    spots = [(0.15 + 0.233 * (k % 4), 0.16 + 0.33 * (k // 4)) for k in range(12)]
    views = [view(f"v{k}", SIDES[k % 4], at=spot) for k, spot in enumerate(spots)] + [view("flat")]
    assert len(views) >= ENOUGH_VIEWS
    assert guide(views).ready


def test_views_that_were_not_found_count_for_nothing():
    assert guide([ViewFacts("x", False, "blurred")] * 20).usable == 0


def test_a_view_like_one_that_is_there_is_not_worth_a_capture():
    live = view("live", "right")
    assert "as in a; move or tilt it first" in live_advice(live, [view("a", "right")])
    assert "a new view" in live_advice(live, [view("a", "left"), view("b", "right", at=(0.2, 0.5))])
