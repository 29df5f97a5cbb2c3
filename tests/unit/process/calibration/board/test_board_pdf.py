"""Boards to print: what is drawn has its size in millimetres and is found by our own detectors."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.board.board_pdf import PAPERS_MM, board_pdf, command, most_squares, usual_squares
from process.calibration.board.detection import Board, find_board

PX_PER_MM = 4.0
KNOWN = "DICT_5X5"


def drawn(pdf: bytes) -> np.ndarray:
    """The page, drawn from the rectangles and curves of its content; what is on it decides, not our module."""
    width, height = (float(number) * 25.4 / 72 for number in re.search(rb"MediaBox \[0 0 (\S+) (\S+)\]", pdf).groups())
    page = np.full((round(height * PX_PER_MM * 2), round(width * PX_PER_MM * 2)), 255, np.uint8)
    content = pdf.split(b"stream\n")[1].split(b"\nendstream")[0].decode()
    page_scale = float(content.split(maxsplit=1)[0]) * 25.4 / 72
    a, _, _, d, e, f = (float(number) for number in re.search(r"q (.*?) cm", content)[1].split())

    def place(points: list[tuple[float, float]]) -> np.ndarray:
        at = np.array(points) * [a, d] + [e, f]
        return np.rint((at * page_scale * [1, -1] + [0, height]) * PX_PER_MM * 2 - 0.5).astype(np.int32)

    for x, y, w, h in re.findall(r"(\S+) (\S+) (\S+) (\S+) re", content):
        left, top, right, bottom = float(x), float(y), float(x) + float(w), float(y) + float(h)
        cv2.rectangle(page, place([(left, top)])[0].tolist(), (place([(right, bottom)])[0] - 1).tolist(), 0, -1)
    for x, y, rest in re.findall(r"(\S+) (\S+) m (.*? c) h", content):
        knots = [(float(x), float(y))]
        for part in rest.split(" c"):
            numbers = [float(number) for number in part.split()]
            knots += [(numbers[4], numbers[5])] if numbers else []
        centre, edge = place([tuple(np.mean(knots[:4], axis=0)), knots[0]])
        cv2.circle(page, centre.tolist(), round(float(np.linalg.norm(edge - centre))), 0, -1)
    return np.asarray(cv2.resize(page, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


@pytest.mark.parametrize("paper", PAPERS_MM)
@pytest.mark.parametrize("kind", ["chessboard", "charuco", "dots"])
def test_the_printed_board_is_found_and_has_its_size(kind, paper):
    side = 30.0 if paper == "a3" else 20.0
    board = Board(*usual_squares(paper, side), side, kind, KNOWN)
    found = find_board(drawn(board_pdf(board, paper)), Board(board.columns, board.rows, side, kind))
    assert found.whole and len(found.pixels) == board.grid[0] * board.grid[1]
    spans = np.linalg.norm(np.ptp(found.pixels, axis=0)), np.linalg.norm(np.ptp(found.board_mm, axis=0))
    assert spans[0] / PX_PER_MM == pytest.approx(spans[1], abs=0.3)


def test_the_file_is_laid_out_as_its_table_says():
    pdf = board_pdf(Board(13, 8, 20.0, "charuco", KNOWN), "a4")
    start = int(pdf.split(b"startxref\n")[1].split()[0])
    assert pdf[start:].startswith(b"xref\n0 6\n")
    offsets = [int(line[:10]) for line in pdf[start:].splitlines()[3:8]]
    assert [pdf[at : at + 7] for at in offsets] == [b"%d 0 obj" % number for number in range(1, 6)]
    length = int(re.search(rb"/Length (\d+)", pdf)[1])
    assert len(re.search(rb">>\nstream\n(.*?)\nendstream", pdf, re.DOTALL)[1]) == length


def test_the_page_has_the_bar_and_the_command_that_belongs_to_it():
    board = Board(13, 8, 20.0, "charuco", KNOWN)
    pdf = board_pdf(board, "a4").decode("latin-1")
    assert "measure this: 100 mm" in pdf and command(board) in pdf
    assert command(board).endswith("--squares 13x8 --square-mm 20 --kind charuco --dictionary DICT_5X5")


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (Board(30, 20, 20.0), "do not fit on a4: at most 13 x 8"),
        (Board(13, 9, 20.0), "do not fit"),
        (Board(20, 12, 10.0, "charuco", "DICT_APRILTAG_25h9"), "has 35"),
    ],
    ids=["too many", "a row too many", "too few markers"],
)
def test_a_board_that_cannot_be_printed_is_refused(board, words):
    with pytest.raises(CalibrationError, match=words):
        board_pdf(board, "a4")


def test_usual_boards_have_one_even_and_one_odd_side():
    for paper in PAPERS_MM:
        columns, rows = usual_squares(paper, 20.0)
        assert (columns + rows) % 2 == 1 and (columns, rows) <= most_squares(paper, 20.0)


def test_large_dots_are_found():
    board = Board(13, 8, 30.0, "dots")
    page = cv2.resize(drawn(board_pdf(board, "a3")), None, fx=1.5, fy=1.5)
    assert len(find_board(page, board).pixels) == 13 * 8
