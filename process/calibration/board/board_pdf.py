"""Boards to print, as a PDF page of vectors in true millimetres with a scale bar."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from acquire.contract.errors import CalibrationError

from .charuco import MARKER_SHARE, possible_layouts, printed_board
from .detection import Board

PAPERS_MM = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}
"""Width and height, landscape."""
MARGIN_MM = 10.0
"""White around the board: printers leave out so much, and the detectors need a light border."""
FOOT_MM = 28.0
"""Height of the text and the scale bar below the board."""
BAR_MM = 100.0
TEXT_MM = 3.6
DOT_RADIUS = 0.25
"""Of the distance of two dots."""
_POINTS_PER_MM = 72 / 25.4
_ROUND = 0.5523
"""Length of the handles of four Bezier curves that make a circle of radius 1."""


def most_squares(paper: str, square_mm: float) -> tuple[int, int]:
    """Columns and rows of squares that fit on a paper."""
    width, height = PAPERS_MM[paper]
    return int((width - 2 * MARGIN_MM) / square_mm + 1e-9), int((height - MARGIN_MM - FOOT_MM) / square_mm + 1e-9)


def usual_squares(paper: str, square_mm: float) -> tuple[int, int]:
    """As many as fit, one side even and one odd, so that the board turned by 180 degrees looks different."""
    columns, rows = most_squares(paper, square_mm)
    return columns - (columns - rows + 1) % 2, rows


def board_pdf(board: Board, paper: str) -> bytes:
    """A PDF of one page.

    Args:
        board: with a dictionary, if it is a ChArUco board.
        paper: a key of PAPERS_MM.

    Raises:
        CalibrationError: the board does not fit, or the dictionary has too few markers.
    """
    columns, rows = most_squares(paper, board.pitch_mm)
    if board.columns > columns or board.rows > rows:
        raise CalibrationError(
            f"{board.columns} x {board.rows} squares of {board.pitch_mm:g} mm do not fit on {paper}: "
            f"at most {columns} x {rows}"
        )
    width, height = PAPERS_MM[paper]
    left = (width - board.columns * board.pitch_mm) / 2
    bottom = FOOT_MM + (height - MARGIN_MM - FOOT_MM - board.rows * board.pitch_mm) / 2
    # PDF's y points up; one path, so that no hairlines show between neighbours
    place = f"{board.pitch_mm:.6g} 0 0 {-board.pitch_mm:.6g} {left:.6g} {bottom + board.rows * board.pitch_mm:.6g} cm"
    content = [
        f"{_POINTS_PER_MM:.9g} 0 0 {_POINTS_PER_MM:.9g} 0 0 cm 0 g",
        f"q {place}", *_shapes(board), "f Q", *_foot(board, left),
    ]  # fmt: skip
    return _document("\n".join(content).encode("ascii"), width, height)


def command(board: Board) -> str:
    """The command that calibrates with the board."""
    words = f"sweepscope calibrate camera VIEWS --squares {board.columns}x{board.rows} --square-mm {board.pitch_mm:g}"
    if board.kind != "chessboard":
        words += f" --kind {board.kind}"
    return words + (f" --dictionary {board.dictionary}" if board.kind == "charuco" else "")


def _shapes(board: Board) -> Iterator[str]:
    """Path of all that is black, in squares from the upper left corner, y down."""
    if board.kind == "dots":
        for row in range(board.rows):
            for column in range(board.columns):
                yield _circle(column + 0.5, row + 0.5)
    elif board.kind == "chessboard":
        for row in range(board.rows):
            for column in range(row % 2, board.columns, 2):
                yield f"{column} {row} 1 1 re"
    else:
        yield from _charuco_shapes(board)


def _charuco_shapes(board: Board) -> Iterator[str]:
    printed = printed_board(possible_layouts(board.columns, board.rows, board.dictionary, legacy=False)[0])
    dictionary = printed.getDictionary()
    numbers, corners = np.asarray(printed.getIds()).ravel(), printed.getObjPoints()
    white = {tuple(np.floor(np.mean(at, axis=0)[:2]).astype(int)) for at in corners}
    for row in range(board.rows):
        for column in range(board.columns):
            if (column, row) not in white:
                yield f"{column} {row} 1 1 re"
    cells = dictionary.markerSize + 2
    side = MARKER_SHARE / cells
    for number, at in zip(numbers, corners, strict=True):
        left, top = float(np.min(at, axis=0)[0]), float(np.min(at, axis=0)[1])
        bits = cv2.aruco.generateImageMarker(dictionary, int(number), cells, borderBits=1)
        for row, column in np.argwhere(bits == 0):
            yield f"{left + column * side:.6f} {top + row * side:.6f} {side:.6f} {side:.6f} re"


def _circle(x: float, y: float) -> str:
    r, h = DOT_RADIUS, DOT_RADIUS * _ROUND
    turns = [(math.cos(a), math.sin(a)) for a in (0, math.pi / 2, math.pi, 3 * math.pi / 2)]
    parts = [f"{x + r:.6f} {y:.6f} m"]
    for (c, s), (d, t) in zip(turns, [*turns[1:], turns[0]], strict=True):
        first, second = (x + r * c - h * s, y + r * s + h * c), (x + r * d + h * t, y + r * t - h * d)
        parts.append(f"{first[0]:.6f} {first[1]:.6f} {second[0]:.6f} {second[1]:.6f} {x + r * d:.6f} {y + r * t:.6f} c")
    return " ".join([*parts, "h"])


def _foot(board: Board, left: float) -> Iterator[str]:
    """Scale bar and text below the board."""
    left = max(left, MARGIN_MM)
    yield f"0.3 w {left:.6g} 20 m {left + BAR_MM:.6g} 20 l S"
    for tick in range(11):
        size = 3 if tick % 5 == 0 else 1.5
        yield f"{left + tick * BAR_MM / 10:.6g} 20 m {left + tick * BAR_MM / 10:.6g} {20 + size} l S"
    what = "dots, distance" if board.kind == "dots" else "squares of"
    facts = f"{board.kind}, {board.columns} x {board.rows} {what} {board.pitch_mm:g} mm"
    if board.kind == "charuco":
        facts += f", {board.dictionary}, markers of {MARKER_SHARE * board.pitch_mm:g} mm"
    yield _text(left + BAR_MM + 3, 20, "measure this: 100 mm. If it is not, print again at 100 % (no scaling)")
    yield _text(left, 14, facts + "; glue it flat, with its white border, onto something stiff")
    yield _text(left, 8.5, command(board))


def _text(x: float, y: float, words: str) -> str:
    escaped = words.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    return f"BT /F {TEXT_MM:g} Tf {x:.6g} {y:.6g} Td ({escaped}) Tj ET"


def _document(content: bytes, width_mm: float, height_mm: float) -> bytes:
    """A PDF file with one page (ISO 32000-1, 7.5)."""
    box = f"{width_mm * _POINTS_PER_MM:.4f} {height_mm * _POINTS_PER_MM:.4f}"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Contents 4 0 R "
        f"/Resources << /Font << /F 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    made, offsets = b"%PDF-1.7\n", []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(made))
        made += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    count = len(objects) + 1
    return made + (
        b"xref\n0 %d\n0000000000 65535 f \n%strailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n"
        % (count, table, count, len(made))
    )
