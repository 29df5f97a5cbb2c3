"""One calibration as files: a folder with its board, its views and its results; it can be left and resumed."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from acquire.contract.errors import CalibrationError
from acquire.contract.files import read_text, replace_file
from tui.scans.json_file import read_object
from tui.text.sizes import parse_squares

FOLDER_NAME = "calibration"
BOARD_NAME = "board.json"
RESULT_NAME = "calibration.json"


class BoardPattern(msgspec.Struct, frozen=True):
    """The pattern of the board."""

    columns: Annotated[int, Meta(ge=3, le=200)] = 16
    """Squares, or dots, along the longer side."""
    rows: Annotated[int, Meta(ge=3, le=200)] = 13
    square_mm: Annotated[float, Meta(gt=0, le=100)] = 0.3
    """Side of a square, or distance of two dots, in mm."""
    kind: Literal["chessboard", "charuco", "dots"] = "chessboard"

    @property
    def arguments(self) -> list[str]:
        """Options of the calibration commands."""
        return ["--squares", f"{self.columns}x{self.rows}", "--square-mm", f"{self.square_mm:g}"]

    def words(self) -> str:
        """``chessboard 16 x 13, 0.3 mm``."""
        return f"{self.kind} {self.columns} x {self.rows}, {self.square_mm:g} mm"


def parse_board(texts: dict[str, str]) -> BoardPattern:
    """A board from the fields ``squares`` (CxR), ``square_mm``, ``kind``.

    Raises:
        ValueError: a field is not valid.
    """
    try:
        sides = parse_squares(texts["squares"])
        fields = {
            "columns": max(sides),
            "rows": min(sides),
            "square_mm": float(texts["square_mm"].replace(",", ".")),
            "kind": texts["kind"],
        }
        return msgspec.convert(fields, BoardPattern)
    except (ValueError, msgspec.ValidationError):
        raise ValueError(
            "give squares as 16x13 (3 to 200 each, squares and not inner corners), a size in mm, and chessboard, "
            "charuco or dots"
        ) from None


class CalibrationSession:
    """The newest folder of ``<data_dir>/calibration``, or a new one as soon as something is saved."""

    def __init__(self, data_dir: Path) -> None:
        self._root = data_dir / FOLDER_NAME
        self.folder = self._newest() or self._fresh()
        self.board = self._read_board()

    def _newest(self) -> Path | None:
        try:
            folders = sorted(path for path in self._root.iterdir() if path.is_dir())
        except OSError:
            return None
        return folders[-1] if folders else None

    def _fresh(self) -> Path:
        return self._root / datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")

    def begin_anew(self) -> None:
        """An empty folder with the same board; the one before stays."""
        self.folder = self._fresh()

    def _read_board(self) -> BoardPattern:
        try:
            return msgspec.json.decode(read_text(self.folder / BOARD_NAME), type=BoardPattern)
        except (OSError, ValueError):
            return BoardPattern()

    def save_board(self, board: BoardPattern) -> None:
        """Write the board to its file.

        Raises:
            CalibrationError: the folder cannot be written to.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            replace_file(self.folder / BOARD_NAME, msgspec.json.encode(board) + b"\n")
        except OSError as error:
            raise CalibrationError(f"cannot write {self.folder}: {error.strerror}; the board is not saved") from None
        self.board = board

    @property
    def views(self) -> list[Path]:
        """The views captured so far, in order."""
        return sorted(path for path in self.folder.glob("view-*.png") if path.is_file())

    def next_view(self) -> Path:
        """File of the next view."""
        numbers = [int(path.stem[5:]) for path in self.views if path.stem[5:].isdigit()]
        return self.folder / f"view-{max(numbers, default=0) + 1:02d}.png"

    def drop_last_view(self) -> str:
        """Put the last view aside; returns its name, empty where there is none.

        Raises:
            CalibrationError: it cannot be moved.
        """
        views = self.views
        if not views:
            return ""
        try:
            views[-1].replace(views[-1].with_name(f".dropped-{views[-1].name}"))
        except OSError as error:
            raise CalibrationError(f"{views[-1].name} stays: {error.strerror}") from None
        return views[-1].name

    @property
    def result(self) -> Path:
        """calibration.json of this session."""
        return self.folder / RESULT_NAME

    def watch_command(self) -> list[str]:
        """Arguments of the command that looks for the board in the preview and judges the views."""
        options = ["--kind", self.board.kind, "--views", str(self.folder), "--json"]
        return ["calibrate", "watch", *self.board.arguments, *options]

    def camera_command(self, stage_view: str) -> list[str]:
        """Arguments of the command that calibrates the camera with all views; ``stage_view`` (or empty) makes z = 0."""
        stage = ["--stage", stage_view] if stage_view else []
        options = ["--kind", self.board.kind, "--out", str(self.result), "--force", "--json"]
        return ["calibrate", "camera", *map(str, self.views), *self.board.arguments, *stage, *options]

    def plane_command(self, scans: Sequence[Path]) -> list[str]:
        """Arguments of the command that calibrates the light plane with these sweeps."""
        options = ["--camera", str(self.result), "--out", str(self.result), "--json"]
        return ["calibrate", "plane", *map(str, scans), *self.board.arguments, *options]

    def document_before(self) -> dict[str, Any]:
        """The calibration of the newest other session that has one, to compare with; empty where there is none."""
        try:
            folders = sorted(self._root.iterdir(), reverse=True)
        except OSError:
            return {}
        others = (read_object(folder / RESULT_NAME) for folder in folders if folder != self.folder)
        return next((found for found in others if found), {})
