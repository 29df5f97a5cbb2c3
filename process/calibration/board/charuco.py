"""ChArUco boards: corners numbered by markers, of any of OpenCV's dictionaries, in the new and in the old layout.

What is not known of a board (dictionary, layout, along which side its markers are numbered) is found by trying.
Pixels [n, 2] as x, y with centres at integers; numbers [n] of the corners, row by row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError

F8 = NDArray[np.float64]
Grey = NDArray[np.uint8]
MARKER_SHARE = 0.75
"""Side of a marker as a share of a square's; corners lie between two markers, so that another share hardly matters."""
SHARPENED_SCALE = 3
SHARPENED_SIDE_PX = 640
"""Longest side of a picture that is sharpened for every dictionary: larger ones take too long."""
COARSE_SIDE_PX = 1600
"""Longest side of the picture in which dictionary and layout are searched."""
FEW_MARKERS = 4
"""Fewer markers of a dictionary may be chance."""
UNCLEAR = "too blurred, too little of the board in the field, or another board"
_SIZED = {f"DICT_{n}X{n}": (50, 100, 250, 1000) for n in (4, 5, 6, 7)}
# a smaller dictionary is the beginning of the larger one
_FIXED = ("ARUCO_ORIGINAL", "APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h10", "APRILTAG_36h11", "ARUCO_MIP_36h12")
DICTIONARIES = (*_SIZED, *(f"DICT_{name}" for name in _FIXED))
"""Names of the dictionaries, those that boards are mostly made of first."""


@dataclass(frozen=True)
class Layout:
    """How squares and markers are arranged on a board."""

    columns: int
    rows: int
    """Squares; the markers are numbered along the columns first."""
    dictionary: str
    """One of :data:`DICTIONARIES`."""
    legacy: bool
    """True for the layout before OpenCV 4.6; it differs where the number of rows is even."""

    @property
    def markers(self) -> int:
        """Number of markers on the board."""
        return self.columns * self.rows // 2


@dataclass(frozen=True)
class Corners:
    """Corners of a board in a picture."""

    pixels: F8
    number: NDArray[np.intp]
    layout: Layout


def dictionary_named(text: str) -> str:
    """The dictionary that ``text`` names, as OpenCV does (``DICT_5X5_250``) or in short (``5x5``, ``apriltag_36h11``).

    Raises:
        ValueError: there is none of this name.
    """
    wanted = text.strip().upper().removeprefix("DICT_")
    for name in DICTIONARIES:
        own = name.upper().removeprefix("DICT_")
        if wanted == own or wanted in [f"{own}_{size}" for size in _SIZED.get(name, ())]:
            return name
    raise ValueError(f"{text!r} is no dictionary of markers; there are {', '.join(DICTIONARIES)}")


@lru_cache(maxsize=64)
def _dictionary(name: str, markers: int) -> Any:
    """The first ``markers`` of a dictionary: others are not on the board, and searching them takes time."""
    sizes = _SIZED.get(name)
    size = "" if sizes is None else f"_{next((size for size in sizes if size >= markers), sizes[-1])}"
    whole = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"{name}{size}"))
    return cv2.aruco.Dictionary(whole.bytesList[:markers], whole.markerSize, whole.maxCorrectionBits)


def marker_count(name: str) -> int:
    """How many markers a dictionary has."""
    return len(_dictionary(name, 1_000_000).bytesList)


def possible_layouts(columns: int, rows: int, dictionary: str = "", legacy: bool | None = None) -> list[Layout]:
    """Layouts of a board of so many squares; an empty ``dictionary`` and ``legacy`` None leave them open.

    Raises:
        CalibrationError: no dictionary has as many markers.
    """
    found = _layouts(columns, rows, [dictionary] if dictionary else DICTIONARIES, legacy)
    if not found:
        most = marker_count(dictionary) if dictionary else max(map(marker_count, DICTIONARIES))
        raise CalibrationError(
            f"a board of {columns} x {rows} squares takes {columns * rows // 2} markers, "
            f"{dictionary or 'the largest dictionary'} has {most}: see --squares, --dictionary"
        )
    return found


def _layouts(columns: int, rows: int, dictionaries: Sequence[str], legacy: bool | None) -> list[Layout]:
    found = [
        Layout(wide, high, name, bool(old))
        for name in dictionaries
        for wide, high in dict.fromkeys([(columns, rows), (rows, columns)])
        for old in ([legacy] if legacy is not None else [False, True] if high % 2 == 0 else [False])
    ]
    return [layout for layout in found if layout.markers <= marker_count(layout.dictionary)]


def printed_board(layout: Layout) -> cv2.aruco.CharucoBoard:
    """OpenCV's board of squares of size 1."""
    squares = layout.columns, layout.rows
    board = cv2.aruco.CharucoBoard(squares, 1.0, MARKER_SHARE, _dictionary(layout.dictionary, layout.markers))
    board.setLegacyPattern(layout.legacy)
    return board


def find_corners(grey: Grey, layouts: Sequence[Layout], enough: int, *, thorough: bool = True) -> Corners:
    """The corners of the layout that most are found of.

    Args:
        grey: the picture.
        layouts: those that the board may have.
        enough: corners that tell one layout from another.
        thorough: where few are found, search again in a sharpened picture, or in a coarse one where it is large.
    """
    best = Corners(np.empty((0, 2)), np.empty(0, np.intp), layouts[0])
    unknown = len({layout.dictionary for layout in layouts}) > 1
    large = max(grey.shape) > COARSE_SIDE_PX
    if unknown and large:
        coarse = find_corners(_coarse(grey), layouts, enough, thorough=False)
        layouts = [coarse.layout] if len(coarse.number) >= enough else layouts
    scales = [1.0]
    if large:
        scales.append(COARSE_SIDE_PX / max(grey.shape))
    elif thorough and (not unknown or max(grey.shape) <= SHARPENED_SIDE_PX):
        scales.append(SHARPENED_SCALE)
    for scale in scales:
        picture = grey if scale == 1 else _coarse(grey) if scale < 1 else _sharpened(grey, SHARPENED_SCALE)
        for found in _each(picture, layouts):
            if len(found.number) > len(best.number):
                best = Corners((found.pixels + 0.5) / scale - 0.5, found.number, found.layout)
            if len(best.number) >= 2 * enough:
                return best
    return best


def _each(grey: Grey, layouts: Sequence[Layout]) -> Iterator[Corners]:
    """What is found of each layout; the markers of a dictionary are searched once."""
    for name in dict.fromkeys(layout.dictionary for layout in layouts):
        same = [layout for layout in layouts if layout.dictionary == name]
        places, numbers = _markers(grey, name, same[0].markers)
        if len(numbers) < 2:
            continue
        for layout in same:
            corners, ids = cv2.aruco.CharucoDetector(printed_board(layout)).detectBoard(
                grey, None, None, places, numbers
            )[:2]
            if ids is not None and len(ids):
                pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
                yield Corners(pixels, np.asarray(ids).ravel().astype(np.intp), layout)


def _markers(grey: Grey, name: str, count: int) -> tuple[Sequence[Any], NDArray[np.int32]]:
    """Corners of the markers in a picture, and their numbers."""
    places, numbers, _ = cv2.aruco.ArucoDetector(_dictionary(name, count)).detectMarkers(grey)
    return places, np.empty(0, np.int32) if numbers is None else np.asarray(numbers, np.int32)


def refusal(grey: Grey, layouts: Sequence[Layout], found: Corners, needed: int) -> str:
    """Why fewer corners than are needed were found: what is in the picture instead."""
    first = layouts[0]
    few = (
        f"only {len(found.number)} of {(first.columns - 1) * (first.rows - 1)} ChArUco corners were found, {needed} "
        "are needed"
    )
    coarse = _coarse(grey)
    name, numbers = _most_markers(coarse, first.markers)
    if len(numbers) < FEW_MARKERS:
        mirrored = np.ascontiguousarray(coarse[:, ::-1])
        if len(find_corners(mirrored, layouts, needed).number) >= needed:
            return "the markers are mirrored: the board lies upside down, or the camera's picture is mirrored"
        return f"{few}: {UNCLEAR}? (No dictionary's markers are seen)"
    said = f"{len(numbers)} markers of {name} seen (numbers {numbers.min()} to {numbers.max()}), {few}"
    if name not in {layout.dictionary for layout in layouts}:
        return f"{said}: --dictionary is {first.dictionary}"
    return f"{said}: {_other_board(coarse, first, name, numbers, needed)}"


def _most_markers(grey: Grey, count: int) -> tuple[str, NDArray[np.int32]]:
    """The dictionary that most markers are seen of, and their numbers; larger boards have more than ``count``."""
    best = "", np.empty(0, np.int32)
    for name in DICTIONARIES:
        numbers = _markers(grey, name, 4 * count)[1].ravel()
        best = (name, numbers) if len(numbers) > len(best[1]) else best
    return best


def _other_board(grey: Grey, given: Layout, name: str, numbers: NDArray[np.int32], needed: int) -> str:
    """How the board differs from the one given: its layout, its size, or nothing that is known."""
    squares = f"--squares is {given.columns}x{given.rows}"
    for step, words in ((0, "it has the other layout: leave --legacy-layout and --new-layout out"), (1, "")):
        columns, rows = given.columns + step, given.rows + step
        likely = [one for one in _layouts(columns, rows, [name], None) if one.markers > numbers.max()]
        if likely and len(find_corners(grey, likely, needed, thorough=False).number) >= needed:
            return (
                words or f"it looks like {columns} x {rows} squares (squares are counted, not inner corners); {squares}"
            )
    if numbers.max() >= given.markers:
        return f"{squares}, a board with the numbers 0 to {given.markers - 1} only"
    return f"{UNCLEAR} than {given.columns} x {given.rows} squares?"


def _coarse(grey: Grey) -> Grey:
    scale = COARSE_SIDE_PX / max(grey.shape)
    if scale >= 1:
        return grey
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _sharpened(grey: Grey, scale: int) -> Grey:
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.asarray(
        cv2.addWeighted(large, 2.5, cv2.GaussianBlur(large, (0, 0), 2.0 * scale), -1.5, 0), dtype=np.uint8
    )
