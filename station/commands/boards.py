"""What `station board` does, as a function: boards and markers on paper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calibration.boards import MM_PER_M, CharucoBoard, MarkerSheet, PrintedMarker
from calibration.pages import Page, pdf, svg
from calibration.sheets import charuco_page, marker_pages
from station.errors import InvalidData, OutputExists
from station.formats.board import format_board
from station.rig_reading import read_rig

FORMATS = (".pdf", ".svg")
LARGEST_ID = 9999  # more than any dictionary has


@dataclass(frozen=True)
class PrintedSheet:
    """What was written: the pages' files (an SVG holds one page), and the board.toml beside them, if it is a board."""

    files: tuple[Path, ...]
    pages: int
    board_file: Path | None


def board(sheet: CharucoBoard | MarkerSheet, out: Path, *, paper: str = "a4", force: bool = False) -> PrintedSheet:
    """Draw a board, or markers to be cut out, at 100 % on paper; beside a board is written its board.toml.

    Args:
        out: a .pdf, or a .svg; several pages of SVG are numbered files.
        paper: "a4", "letter" or "a3".
        force: write over what is there.

    Raises:
        CalibrationError: for what doesn't fit on the paper.
        InvalidData: for another kind of file.
        OutputExists: there is such a file.
    """
    if out.suffix.lower() not in FORMATS:
        raise InvalidData(f"--out {out}: want a file that ends in {' or '.join(FORMATS)}")
    pages = [charuco_page(sheet, paper)] if isinstance(sheet, CharucoBoard) else marker_pages(sheet, paper)
    texts: dict[Path, bytes] = _drawn(pages, out)
    board_file = None
    if isinstance(sheet, CharucoBoard):
        board_file = out.with_suffix(".toml")
        texts[board_file] = format_board(sheet, measured=False).encode("utf-8")
    for path in texts:
        if path.exists() and not force:
            raise OutputExists(f"{path} exists; want a new file, or --force to write over it")
    out.parent.mkdir(parents=True, exist_ok=True)
    for path, text in texts.items():
        path.write_bytes(text)
    return PrintedSheet(tuple(path for path in texts if path != board_file), len(pages), board_file)


def _drawn(pages: list[Page], out: Path) -> dict[Path, bytes]:
    if out.suffix.lower() == ".pdf":
        return {out: pdf(pages, out.stem)}
    if len(pages) == 1:
        return {out: svg(pages[0]).encode("utf-8")}
    return {
        out.with_name(f"{out.stem}-{k}{out.suffix}"): svg(page).encode("utf-8") for k, page in enumerate(pages, start=1)
    }


def rig_sheet(rig: str) -> MarkerSheet:
    """All markers of a rig (the name of a packaged one, or a path), each at its size; raises InvalidFile."""
    table = read_rig(rig)[0].marker_table()
    return MarkerSheet(table.dictionary, tuple(PrintedMarker(m.id, m.size_m, m.part) for m in table.markers))


def id_sheet(dictionary: str, ids: str, size_mm: float) -> MarkerSheet:
    """Markers of the ids in a text such as "0-9,20", all of one size.

    Raises:
        InvalidData: for a text that is no list of ids.
        CalibrationError: for a size that can't be.
    """
    return MarkerSheet(dictionary, tuple(PrintedMarker(n, size_mm / MM_PER_M) for n in _ids(ids)))


def _ids(text: str) -> list[int]:
    ids: list[int] = []
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if (
            not first.isdecimal()
            or not (last or first).isdecimal()
            or not int(first) <= int(last or first) <= LARGEST_ID
        ):
            raise InvalidData(f"ids '{text}': want numbers and ranges, such as 0-9,20")
        ids += range(int(first), int(last or first) + 1)
    return ids
