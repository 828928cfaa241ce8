"""Paper and camera: boards and markers to print, and the camera's calibration from views of a board."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import app
from station.cli.options import Force, Json
from station.cli.show import say_next

if TYPE_CHECKING:
    from calibration.boards import CharucoBoard, MarkerSheet
    from station.commands.boards import PrintedSheet


class Sheet(StrEnum):
    """What can be printed."""

    charuco = "charuco"
    markers = "markers"


class Paper(StrEnum):
    """Papers that it can be printed on."""

    a4 = "a4"
    letter = "letter"
    a3 = "a3"


BOARD_DICTIONARY, MARKER_DICTIONARY = "DICT_5X5_100", "DICT_4X4_50"


@app.command()
def board(
    out: Annotated[Path, typer.Option("--out", help="File to write: .pdf or .svg.", show_default=False)],
    kind: Annotated[Sheet, typer.Argument(metavar="KIND", help="charuco (calibrates cameras) or markers.")] = (
        Sheet.charuco
    ),
    paper: Annotated[Paper, typer.Option("--paper", help="Paper.")] = Paper.a4,
    squares: Annotated[
        str | None, typer.Option("--squares", help="charuco: squares, such as 7x10; as many as fit.")
    ] = None,
    square_mm: Annotated[float, typer.Option("--square-mm", help="charuco: side of a square.")] = 25.0,
    marker_mm: Annotated[
        float | None, typer.Option("--marker-mm", help="charuco: side of a marker; 0.7 of a square if left out.")
    ] = None,
    dictionary: Annotated[
        str | None,
        typer.Option("--dictionary", help=f"Of OpenCV; charuco: {BOARD_DICTIONARY}, markers: {MARKER_DICTIONARY}."),
    ] = None,
    rig: Annotated[
        str | None, typer.Option("--rig", help="markers: all of this rig's, at its sizes.", show_default=False)
    ] = None,
    ids: Annotated[str | None, typer.Option("--ids", help="markers: such as 0-9,20.", show_default=False)] = None,
    size_mm: Annotated[float, typer.Option("--size-mm", help="markers: side of the black square.")] = 50.0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw a calibration board, or markers to cut out, as PDF or SVG to print at 100 %.

    A ruler of 100 mm is printed with it: its measured length says what the printer made of it.
    """
    from station.commands import boards

    if kind is Sheet.charuco:
        if rig or ids:
            raise typer.BadParameter("--rig and --ids are for markers: station board markers --rig RIG --out FILE")
        sheet: CharucoBoard | MarkerSheet = _board(paper, squares, square_mm, marker_mm, dictionary)
    elif rig:
        if ids or dictionary:
            raise typer.BadParameter("--rig has its own ids and dictionary: leave out --ids and --dictionary")
        sheet = boards.rig_sheet(rig)
    elif ids:
        sheet = boards.id_sheet(dictionary or MARKER_DICTIONARY, ids, size_mm)
    else:
        raise typer.BadParameter("markers: want --rig RIG or --ids, such as --ids 0-9")
    _show_sheet(boards.board(sheet, out, paper=paper.value, force=force), sheet, as_json)


def _board(
    paper: Paper, squares: str | None, square_mm: float, marker_mm: float | None, dictionary: str | None
) -> CharucoBoard:
    from calibration.sheets import largest_board

    counts = None
    if squares is not None:
        columns, _, rows = squares.lower().partition("x")
        if not (columns.isdecimal() and rows.isdecimal()):
            raise typer.BadParameter(f"--squares {squares}: want columns x rows, such as 7x10")
        counts = int(columns), int(rows)
    marker_mm = 0.7 * square_mm if marker_mm is None else marker_mm
    return largest_board(paper.value, square_mm, marker_mm, dictionary or BOARD_DICTIONARY, counts)


def _show_sheet(printed: PrintedSheet, sheet: CharucoBoard | MarkerSheet, as_json: bool) -> None:
    from calibration.boards import MM_PER_M, CharucoBoard

    files = [str(path) for path in printed.files]
    is_board = isinstance(sheet, CharucoBoard)
    if as_json:
        about = {"board": sheet.spec} if is_board else {"markers": [marker.id for marker in sheet.markers]}
        print(json.dumps({"files": files, "pages": printed.pages, **about}))
        return
    print(f"{', '.join(files)}: {printed.pages} page{'' if printed.pages == 1 else 's'} to print at 100 %")
    if is_board:
        say_next(
            f"{sheet.said}; it is described in {printed.board_file}",
            "next: print it at 100 % (not 'fit to page'), glue it flat on something stiff, measure both 100 mm rulers,",
            f"  station calibrate camera 0 --board {printed.board_file} --measured-mm 100.0x100.0 --out camera",
        )
    else:
        sizes = ", ".join(f"{mm:g} mm" for mm in sorted({marker.size_m * MM_PER_M for marker in sheet.markers}))
        say_next(
            f"{len(sheet.markers)} markers of {sheet.dictionary}, black squares of {sizes}",
            "next: print them at 100 %, cut them out along the marks, measure the 100 mm ruler: if it is not 100 mm,",
            "  put the measured sides of the black squares into the rig as size_mm",
        )
