"""board.toml: a printed ChArUco board, and what its rulers measure, so that a camera is calibrated with it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from calibration.boards import MM_PER_M, RULER_MM, CharucoBoard
from calibration.errors import CalibrationError
from station.errors import InvalidFile
from station.formats.toml_models import StrictModel, parse

BOARD_SCHEMA = "board/1"

Measured = Annotated[list[float], Field(min_length=2, max_length=2)]


class BoardTable(StrictModel):
    """The keys of board.toml; `measured_mm` is what the rulers of 100 mm measure (across, down) on the paper."""

    kind: Literal["charuco"]
    columns: int
    rows: int
    square_mm: float
    marker_mm: float
    dictionary: str
    legacy: bool = False
    measured_mm: Measured | None = None

    def to_board(self) -> CharucoBoard:
        """The board, with the printer's scale where it was measured; raises CalibrationError for what can't be."""
        board = CharucoBoard(
            self.columns, self.rows, self.square_mm / MM_PER_M, self.marker_mm / MM_PER_M, self.dictionary, self.legacy
        )
        return board if self.measured_mm is None else board.measured((self.measured_mm[0], self.measured_mm[1]))


def parse_board(text: str, name: str) -> tuple[CharucoBoard, bool]:
    """The board in a board.toml text, and whether its rulers were measured; raises InvalidFile."""
    table = parse(BoardTable, text, name, BOARD_SCHEMA)
    try:
        return table.to_board(), table.measured_mm is not None
    except CalibrationError as error:
        raise InvalidFile(f"{name}: {error}") from error


def format_board(board: CharucoBoard, *, measured: bool) -> str:
    """board.toml's text; with the rulers' lengths where they were `measured`."""
    lines = [
        f'schema = "{BOARD_SCHEMA}"',
        'kind = "charuco"',
        f"columns = {board.columns}",
        f"rows = {board.rows}",
        f"square_mm = {_mm(board.square_m)}",
        f"marker_mm = {_mm(board.marker_m)}",
        f'dictionary = "{board.dictionary}"',
    ]
    if board.legacy:
        lines.append("legacy = true")
    if measured:
        lengths = [float(f"{RULER_MM * share:.6g}") for share in board.stretch]
        lines.append(f"measured_mm = {lengths}    # the rulers of 100 mm on the paper: across, down")
    return "\n".join(lines) + "\n"


def _mm(length_m: float) -> str:
    return repr(float(f"{length_m * MM_PER_M:.9g}"))
