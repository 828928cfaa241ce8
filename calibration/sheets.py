"""What is put on paper: a board with its rulers and its description, or markers to be cut out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.boards import (
    MM_PER_M,
    QUIET_CELLS,
    RULER_MM,
    CharucoBoard,
    MarkerSheet,
    PrintedMarker,
    black_runs,
    marker_cells,
)
from calibration.errors import CalibrationError
from calibration.intrinsics import FloatArray
from calibration.pages import LETTER_WIDTH, PAPERS_MM, Line, Page, Text

# Printers leave a rim of 4 to 6 mm.
MARGIN_MM = 7.0
SMALL_PRINT_MM = 2.3
LINE_STEP_MM = 3.2
TICK_MM, LONG_TICK_MM = 1.5, 3.0
# White between a board and the ruler beside it; a board needs a rim of white, as a marker does.
RIM_MM = 4.0
RULER_ROOM_MM = 8.0
CUT_MARK_MM = 3.0
# Between two markers' cut lines.
GAP_MM = 4.0


def paper_size(name: str) -> tuple[float, float]:
    """(width, height) mm of a paper; raises CalibrationError for one that isn't known."""
    if name.lower() not in PAPERS_MM:
        raise CalibrationError(f"no paper '{name}'; want one of {', '.join(PAPERS_MM)}")
    return PAPERS_MM[name.lower()]


def largest_board(
    paper: str, square_mm: float, marker_mm: float, dictionary: str, squares: tuple[int, int] | None = None
) -> CharucoBoard:
    """The board of that many squares (columns, rows), of as many as the paper has room for if None.

    Raises:
        CalibrationError: a board that can't be, or doesn't fit.
    """
    width, height = _board_room(paper_size(paper))
    if squares is None and square_mm > 0:
        squares = int(width // square_mm), int(height // square_mm)
    return CharucoBoard(*(squares or (0, 0)), square_mm / MM_PER_M, marker_mm / MM_PER_M, dictionary)


def _board_room(size_mm: tuple[float, float]) -> tuple[float, float]:
    """Room for a board beside and above its rulers and its small print."""
    across = size_mm[0] - 2 * MARGIN_MM - RIM_MM - RULER_ROOM_MM
    down = size_mm[1] - 2 * MARGIN_MM - 2 * RIM_MM - RULER_ROOM_MM - 4 * LINE_STEP_MM
    return across, down


def charuco_page(board: CharucoBoard, paper: str) -> Page:
    """A board on paper, as drawn (at 100 %), with rulers across and down and all that is needed to use it later.

    Raises:
        CalibrationError: a paper that isn't known, or is too small.
    """
    size_mm = paper_size(paper)
    room = _board_room(size_mm)
    side_mm = board.square_m * MM_PER_M
    width, height = board.columns * side_mm, board.rows * side_mm
    if width > room[0] or height > room[1] or max(room) < RULER_MM:
        raise CalibrationError(
            f"a board of {width:g} x {height:g} mm doesn't fit on {paper.upper()}, which has room for "
            f"{room[0]:.0f} x {room[1]:.0f} mm\nwant fewer or smaller squares (--squares, --square-mm), or other paper"
        )
    left = MARGIN_MM + RULER_ROOM_MM + RIM_MM + (room[0] - width) / 2
    top = MARGIN_MM + RIM_MM
    rectangles = board.black_rectangles() * MM_PER_M + np.array([left, top, 0, 0])
    below = top + height + RIM_MM
    lines, texts = _ruler_across(left, below)
    down_lines, down_texts = _ruler_down(left - RIM_MM, top)
    texts += _small_print(_description(board), left, below + RULER_ROOM_MM + LINE_STEP_MM)
    return Page(size_mm, rectangles, (*lines, *down_lines), (*texts, *down_texts))


def _description(board: CharucoBoard) -> list[str]:
    return [
        f"ChArUco board: {board.said}, ids 0 to {board.marker_count - 1}",
        "Print at 100 % (not 'fit to page'), glue it flat on something stiff, measure both rulers from end to end.",
        f"station calibrate camera SOURCE --board {board.spec} --measured-mm ACROSSxDOWN --out DIR",
    ]


def _small_print(words: Sequence[str], x: float, y: float) -> list[Text]:
    return [Text(x, y + k * LINE_STEP_MM, SMALL_PRINT_MM, line) for k, line in enumerate(words)]


def _ticks() -> list[tuple[float, float]]:
    """Place along the ruler and length of each tick, mm: every 5 mm, longer every 10."""
    return [(float(mm), LONG_TICK_MM if mm % 10 == 0 else TICK_MM) for mm in range(0, int(RULER_MM) + 1, 5)]


def _ruler_across(x: float, y: float) -> tuple[list[Line], list[Text]]:
    lines = [Line(x, y, x + RULER_MM, y), *(Line(x + at, y, x + at, y + tick) for at, tick in _ticks())]
    return lines, [
        Text(x - 0.6, y + LONG_TICK_MM + 2.4, SMALL_PRINT_MM, "0"),
        Text(x + RULER_MM - 2.0, y + LONG_TICK_MM + 2.4, SMALL_PRINT_MM, "100 mm across"),
    ]


def _ruler_down(x: float, y: float) -> tuple[list[Line], list[Text]]:
    lines = [Line(x, y, x, y + RULER_MM), *(Line(x, y + at, x - tick, y + at) for at, tick in _ticks())]
    words = x - LONG_TICK_MM - 0.8
    return lines, [
        Text(words, y + 0.6, SMALL_PRINT_MM, "0", upward=True),
        Text(words, y + RULER_MM + 2.0, SMALL_PRINT_MM, "100 mm down", upward=True),
    ]


@dataclass(frozen=True)
class _Tile:
    """A marker with its white border and the strip of its label: what is cut out, mm."""

    marker: PrintedMarker
    border_mm: float
    words: str
    print_mm: float

    @property
    def width_mm(self) -> float:
        return self.marker.size_m * MM_PER_M + 2 * self.border_mm

    @property
    def height_mm(self) -> float:
        return self.width_mm + 1.5 * self.print_mm

    def rectangles(self, dictionary: str, x: float, y: float) -> FloatArray:
        runs = black_runs(marker_cells(dictionary, self.marker.id), self.marker.size_m * MM_PER_M)
        return runs + np.array([x + self.border_mm, y + self.border_mm, 0, 0])

    def cut_marks(self, x: float, y: float) -> list[Line]:
        """Two short lines outside each corner, so that nothing of them is left on what is cut out."""
        marks: list[Line] = []
        for at_x, out_x in ((x, -1), (x + self.width_mm, 1)):
            for at_y, out_y in ((y, -1), (y + self.height_mm, 1)):
                marks.append(Line(at_x + out_x * 0.5, at_y, at_x + out_x * CUT_MARK_MM, at_y))
                marks.append(Line(at_x, at_y + out_y * 0.5, at_x, at_y + out_y * CUT_MARK_MM))
        return marks


def _tile(marker: PrintedMarker, dictionary: str) -> _Tile:
    size_mm = marker.size_m * MM_PER_M
    border_mm = QUIET_CELLS * size_mm / len(marker_cells(dictionary, marker.id))
    words = f"{marker.id}  {size_mm:g} mm  {dictionary}" + (f"  {marker.label}" if marker.label else "")
    room_mm = size_mm + border_mm
    return _Tile(marker, border_mm, words, min(SMALL_PRINT_MM, room_mm / (LETTER_WIDTH * len(words))))


def marker_pages(sheet: MarkerSheet, paper: str) -> list[Page]:
    """Markers to be cut out, each with a white border of one of its cells and its id and size below, on as many pages.

    Raises:
        CalibrationError: an id that isn't in the dictionary, a marker larger than the paper.
    """
    markers, dictionary = sheet.markers, sheet.dictionary
    size_mm = paper_size(paper)
    pages: list[list[tuple[_Tile, float, float]]] = []
    for tiles, y in _shelves([_tile(marker, dictionary) for marker in markers], size_mm, paper):
        if y is None or not pages:
            pages.append([])
        x, top = MARGIN_MM + CUT_MARK_MM, _first_shelf() if y is None else y
        for tile in tiles:
            pages[-1].append((tile, x, top))
            x += tile.width_mm + GAP_MM + 2 * CUT_MARK_MM
    return [_marker_page(placed, dictionary, size_mm, k + 1, len(pages)) for k, placed in enumerate(pages)]


def _first_shelf() -> float:
    """Where markers begin, below the ruler and the small print."""
    return MARGIN_MM + RULER_ROOM_MM + 3 * LINE_STEP_MM + CUT_MARK_MM


def _shelves(
    tiles: Sequence[_Tile], size_mm: tuple[float, float], paper: str
) -> list[tuple[list[_Tile], float | None]]:
    """Rows of tiles from left to right, each with its place from the top; None begins a page."""
    right, bottom = size_mm[0] - MARGIN_MM - CUT_MARK_MM, size_mm[1] - MARGIN_MM - CUT_MARK_MM
    shelves: list[tuple[list[_Tile], float | None]] = []
    row: list[_Tile] = []
    x, y, new_page = MARGIN_MM + CUT_MARK_MM, _first_shelf(), True
    for tile in tiles:
        if MARGIN_MM + CUT_MARK_MM + tile.width_mm > right or _first_shelf() + tile.height_mm > bottom:
            raise CalibrationError(
                f"marker {tile.marker.id} of {tile.marker.size_m * MM_PER_M:g} mm and its border don't fit on "
                f"{paper.upper()}; want smaller markers or larger paper"
            )
        if row and x + tile.width_mm > right:
            shelves.append((row, None if new_page else y))
            y += max(done.height_mm for done in row) + GAP_MM + 2 * CUT_MARK_MM
            row, x, new_page = [], MARGIN_MM + CUT_MARK_MM, False
        if not row and y + tile.height_mm > bottom:
            y, new_page = _first_shelf(), True
        if row and y + tile.height_mm > bottom:
            shelves.append((row, None if new_page else y))
            row, x, y, new_page = [], MARGIN_MM + CUT_MARK_MM, _first_shelf(), True
        row.append(tile)
        x += tile.width_mm + GAP_MM + 2 * CUT_MARK_MM
    shelves.append((row, None if new_page else y))
    return shelves


def _marker_page(
    placed: Sequence[tuple[_Tile, float, float]], dictionary: str, size_mm: tuple[float, float], number: int, count: int
) -> Page:
    lines, texts = _ruler_across(MARGIN_MM + CUT_MARK_MM, MARGIN_MM)
    words = [
        f"{dictionary}, page {number} of {count}. Print at 100 % (not 'fit to page'). Cut along the marks: the white "
        "border belongs to the marker.",
        "If the ruler isn't 100 mm, give the markers' measured sides (of the black squares) as size_mm.",
    ]
    texts += _small_print(words, MARGIN_MM + CUT_MARK_MM, MARGIN_MM + RULER_ROOM_MM + LINE_STEP_MM)
    rectangles = np.concatenate([tile.rectangles(dictionary, x, y) for tile, x, y in placed])
    for tile, x, y in placed:
        lines += tile.cut_marks(x, y)
        place = x + tile.border_mm, y + tile.width_mm + 0.9 * tile.print_mm
        texts.append(Text(*place, tile.print_mm, tile.words))
    return Page(size_mm, rectangles, tuple(lines), tuple(texts))
