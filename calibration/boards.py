"""Printed boards: ChArUco chessboards and single markers, as descriptions and as black rectangles and points.

A board's frame is OpenCV's: origin in the outer top-left corner, x right, y down, z into the paper. The layout is that
of OpenCV 5: the top-left square is black, markers stand in the white squares and are numbered row by row. Boards of
OpenCV before 4.6 with an even number of rows begin with a white square: those are `legacy`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.intrinsics import FloatArray

MM_PER_M = 1000.0
# What the printed ruler has to be, and what a printer or a reader of rulers can plausibly have made of it.
RULER_MM = 100.0
LEAST_RULER_MM, MOST_RULER_MM = 90.0, 110.0
SMALLEST_SIDE = 3  # squares
# A marker leaves a white rim in its square: with less, OpenCV doesn't find it.
LARGEST_MARKER_SHARE = 0.9
SMALLEST_MARKER_SHARE = 0.3
# The white that a marker on its own needs around it, in its own cells.
QUIET_CELLS = 1
SPEC = re.compile(r"charuco:(\d+)x(\d+):([\d.]+):([\d.]+):(\w+?)(:legacy)?")


def dictionary_names() -> list[str]:
    """OpenCV's predefined dictionaries."""
    return sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))


@lru_cache(maxsize=64)
def load_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of that name; raises CalibrationError for another name."""
    if name not in dictionary_names():
        raise CalibrationError(f"no marker dictionary '{name}'; want one of\n{', '.join(dictionary_names())}")
    return cv2.aruco.getPredefinedDictionary(int(getattr(cv2.aruco, name)))


def marker_cells(dictionary: str, marker_id: int) -> NDArray[np.bool_]:
    """Which cells (n + 2, n + 2) of a marker are black, its border included; raises CalibrationError for no such id."""
    book = load_dictionary(dictionary)
    count = len(book.bytesList)
    if not 0 <= marker_id < count:
        raise CalibrationError(f"marker {marker_id} is not in {dictionary}; its ids are 0 to {count - 1}")
    return np.asarray(book.generateImageMarker(marker_id, book.markerSize + 2)) == 0


def black_runs(cells: NDArray[np.bool_], side: float) -> FloatArray:
    """Black rectangles (K, 4) `x, y, width, height` of a marker of this side at the origin: a run of cells each."""
    count = len(cells)
    runs: list[tuple[int, int, int]] = []
    for row, line in enumerate(cells):  # once a marker, when a board is drawn
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
        runs += [(int(start), row, int(end - start)) for start, end in zip(edges[::2], edges[1::2], strict=True)]
    table = np.array(runs, np.float64)
    return np.column_stack([table[:, 0], table[:, 1], table[:, 2], np.ones(len(table))]) * (side / count)


@dataclass(frozen=True)
class CharucoBoard:
    """A chessboard with markers in its white squares.

    Attributes:
        columns, rows: squares across and down.
        square_m, marker_m: sides of the squares and of the markers' black squares, as drawn.
        dictionary: name of OpenCV's dictionary; the markers are its first `columns * rows // 2`.
        legacy: begins with a white square where `rows` is even, as OpenCV drew boards before 4.6.
        stretch: (across, down) true length of what is drawn as one: the printer's scale, measured on the paper.

    Raises:
        CalibrationError: for a board that can't be drawn or found.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False
    stretch: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < SMALLEST_SIDE:
            raise CalibrationError(f"board of {self.columns}x{self.rows} squares; want at least 3x3")
        share = self.marker_m / self.square_m if self.square_m > 0 else np.nan
        if not SMALLEST_MARKER_SHARE <= share <= LARGEST_MARKER_SHARE:
            have = f"squares of {self.square_m * MM_PER_M:g} mm with markers of {self.marker_m * MM_PER_M:g} mm"
            raise CalibrationError(f"board: {have}; want markers of 0.3 to 0.9 of a square")
        have = len(load_dictionary(self.dictionary).bytesList)
        if self.marker_count > have:
            raise CalibrationError(
                f"a board of {self.columns}x{self.rows} squares has {self.marker_count} markers, "
                f"{self.dictionary} only {have}; want fewer squares or a larger dictionary"
            )

    @property
    def marker_count(self) -> int:
        """How many markers it has: one in each white square."""
        return len(self._white_squares())

    @property
    def corner_count(self) -> int:
        """How many inner corners the chessboard has."""
        return (self.columns - 1) * (self.rows - 1)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the printed board."""
        across, down = self.stretch
        return self.columns * self.square_m * across, self.rows * self.square_m * down

    @property
    def spec(self) -> str:
        """The board in one word, as `parse_spec` reads it; without the printer's scale."""
        legacy = ":legacy" if self.legacy else ""
        sizes = f"{self.square_m * MM_PER_M:g}:{self.marker_m * MM_PER_M:g}"
        return f"charuco:{self.columns}x{self.rows}:{sizes}:{self.dictionary}{legacy}"

    @property
    def said(self) -> str:
        """The board in words."""
        return (
            f"{self.columns} x {self.rows} squares of {self.square_m * MM_PER_M:g} mm, "
            f"markers of {self.marker_m * MM_PER_M:g} mm, {self.dictionary}"
        )

    def measured(self, ruler_mm: tuple[float, float]) -> CharucoBoard:
        """The same board as printed, where its rulers of 100 mm measure so much (across, down).

        Raises:
            CalibrationError: for lengths that no printer makes of 100 mm.
        """
        check_ruler(ruler_mm)
        return replace(self, stretch=(ruler_mm[0] / RULER_MM, ruler_mm[1] / RULER_MM))

    def corner_points(self) -> FloatArray:
        """(N, 3) the chessboard's inner corners on the paper, m, in the order of OpenCV's ids: row by row."""
        column, row = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return self._on_paper(np.stack([column.ravel(), row.ravel()], axis=-1) * self.square_m)

    def marker_points(self) -> FloatArray:
        """(M, 4, 3) corners of the markers' black squares on the paper, m, by id; clockwise from the top left."""
        low = (self._white_squares() + 0.5) * self.square_m - self.marker_m / 2
        turn = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * self.marker_m
        return self._on_paper(low[:, None] + turn)

    def black_rectangles(self) -> FloatArray:
        """(K, 4) `x, y, width, height` of all that is printed black, as drawn: without the printer's scale, m."""
        white = self._white_squares()
        every = np.stack(np.meshgrid(np.arange(self.columns), np.arange(self.rows)), axis=-1).reshape(-1, 2)
        black = every[(every.sum(axis=-1) + self._first_white) % 2 == 0] * self.square_m
        rectangles = [np.column_stack([black, np.full((len(black), 2), self.square_m)])]
        for marker_id, square in enumerate(white):
            runs = black_runs(marker_cells(self.dictionary, marker_id), self.marker_m)
            runs[:, :2] += (square + 0.5) * self.square_m - self.marker_m / 2
            rectangles.append(runs)
        return np.concatenate(rectangles)

    def opencv_board(self) -> cv2.aruco.CharucoBoard:
        """The board as OpenCV's detector takes it, as drawn."""
        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square_m, self.marker_m, load_dictionary(self.dictionary)
        )
        board.setLegacyPattern(self.legacy)
        return board

    @property
    def _first_white(self) -> int:
        """1 where the top-left square is white."""
        return int(self.legacy and self.rows % 2 == 0)

    def _white_squares(self) -> NDArray[np.int64]:
        """(M, 2) column and row of the white squares, row by row."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        white = (row + column + self._first_white) % 2 == 1
        return np.stack([column[white], row[white]], axis=-1)

    def _on_paper(self, drawn: NDArray[np.floating]) -> FloatArray:
        """Points (..., 3) m on the printed paper of points (..., 2) as drawn."""
        flat = np.asarray(drawn * np.array(self.stretch), np.float64)
        return np.concatenate([flat, np.zeros((*flat.shape[:-1], 1))], axis=-1)


def check_ruler(ruler_mm: tuple[float, float]) -> None:
    """Raise CalibrationError for a measured ruler (across, down) that no printer makes of 100 mm."""
    for length_mm in ruler_mm:
        if not LEAST_RULER_MM <= length_mm <= MOST_RULER_MM:
            raise CalibrationError(
                f"the 100 mm ruler measures {length_mm:g} mm; want {LEAST_RULER_MM:g} to {MOST_RULER_MM:g} mm\n"
                "measure the ruler printed on the sheet from its first to its last line, in millimetres; "
                "if it is right, print again at 100 % (not 'fit to page')"
            )


def parse_spec(text: str) -> CharucoBoard:
    """The board of a word such as "charuco:7x9:25:17.5:DICT_5X5_100", as printed on each board.

    Raises:
        CalibrationError: for another text, or a board that can't be.
    """
    match = SPEC.fullmatch(text)
    if match is None:
        raise CalibrationError(
            f"'{text}' is no board; want charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY as it is printed on the "
            "sheet, such as charuco:7x9:25:17.5:DICT_5X5_100"
        )
    columns, rows, square_mm, marker_mm, dictionary, legacy = match.groups()
    return CharucoBoard(
        int(columns), int(rows), float(square_mm) / MM_PER_M, float(marker_mm) / MM_PER_M, dictionary, bool(legacy)
    )


@dataclass(frozen=True)
class PrintedMarker:
    """A marker to be printed, cut out and stuck on: its id, the side of its black square, and what is written on it.

    Raises:
        CalibrationError: for a size that isn't positive.
    """

    id: int
    size_m: float
    label: str = ""

    def __post_init__(self) -> None:
        if not 0 < self.size_m < np.inf:
            raise CalibrationError(f"marker {self.id}: size is {self.size_m * MM_PER_M:g} mm; want more than 0")


@dataclass(frozen=True)
class MarkerSheet:
    """Markers of one dictionary to be printed, cut out and stuck on.

    Raises:
        CalibrationError: for no markers.
    """

    dictionary: str
    markers: tuple[PrintedMarker, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", tuple(self.markers))
        if not self.markers:
            raise CalibrationError("no markers to print; want at least one id, such as 0-9")
