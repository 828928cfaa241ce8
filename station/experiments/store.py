"""A sweep's folder: its grid, its rows as they come, the fits that are kept, the tables.

    sweep.json          the grid, schema sweep/1
    rows.jsonl          a line a fit, in the order in which they came
    trees/NAME.json     the generating trees
    fits/CELL.json      found trees: of the least inflation, the first repeats
    sweep.csv .parquet  all rows in the grid's order, written when the sweep ends or is broken off

Whatever ends the program, a kill or a power cut, costs no line that was handed to `add`: lines are on the disk before
it returns, and an end that was torn is taken away when the folder is opened again. One program at a time may write.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from station.errors import InvalidFile, StationError
from station.experiments.fits import Outcome
from station.experiments.grid import Cell, CellKey, Grid
from station.experiments.grid_json import grid_changes, grid_json, parse_grid
from station.experiments.rows import Row, parse_row, row_line, rows_csv, rows_table
from station.formats.text import read_text
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import from_json, to_json
from station.session import check_output_folder

GRID_FILE, ROWS_FILE = "sweep.json", "rows.jsonl"
TREES_FOLDER, FITS_FOLDER = "trees", "fits"
CSV_FILE, PARQUET_FILE = "sweep.csv", "sweep.parquet"
# Found trees are kept of so many repeats.
KEPT_REPEATS = 4


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep as its folder tells it.

    Attributes:
        folder: where it is.
        grid: what is fitted.
        rows: what came of the fits that are done, in the grid's order.
        notices: what is to be known about them, plain sentences.
    """

    folder: Path
    grid: Grid
    rows: tuple[Row, ...]
    notices: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether every cell of the grid has its row."""
        return len(self.rows) == len(self.grid)

    def found_tree(self, cell: Cell) -> KinematicTree | None:
        """The tree that a cell's fit found; None if it wasn't kept, isn't done or failed."""
        path = self.folder / FITS_FOLDER / fit_file(cell)
        return from_json(read_text(path, "found tree"), str(path)) if path.exists() else None


def read_sweep(folder: str | PathLike[str]) -> Sweep:
    """Read a sweep, complete or not, while it is under way or when it is done; raises InvalidFile if there is none."""
    folder = Path(folder)
    grid = _read_grid(folder)
    rows, torn = _read_rows(folder, grid)
    return _sweep(folder, grid, rows, [torn.notice] if torn else [])


def fit_file(cell: Cell) -> str:
    """Name of the file in fits/ that a cell's found tree is kept in."""
    tree, method, translation_m, rotation_rad, inflation, repeat = cell.key
    return f"{tree}_{method}_{translation_m!r}m_{rotation_rad!r}rad_i{inflation}_r{repeat}.json"


def is_kept(cell: Cell, grid: Grid) -> bool:
    """Whether the tree that is found is kept: enough to draw, few enough for any disk."""
    return cell.options.inflation == grid.inflation[0] and cell.repeat < KEPT_REPEATS


@dataclass
class Store:
    """A sweep's folder, open for one program to write."""

    folder: Path
    grid: Grid
    notices: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rows: dict[CellKey, Row] = {}
        self._file: BinaryIO | None = None

    @classmethod
    def open(cls, folder: Path, grid: Grid, *, force: bool = False) -> Store:
        """Begin a sweep in a folder that is new or empty, or go on with the one that is there.

        A grid that has all cells of the one that is there extends it: what is done stays.

        Args:
            folder: made if it isn't there.
            grid: to be swept.
            force: begin anew, whatever is in the folder.

        Raises:
            StationError: the folder holds something else, a sweep of another grid, one that another program is writing;
                it can't be written.
        """
        begun = (folder / GRID_FILE).exists()
        if not begun and not _is_first_breath(folder):
            check_output_folder(folder, force=force)
        store = cls(folder, grid)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            store._lock()
            if begun and not force and (folder / ROWS_FILE).stat().st_size:
                store._take_up()
            else:
                store._clear()
            store._write_grid()
        except OSError as error:
            store.close()
            raise StationError(f"can't write the sweep into '{folder}': {error.strerror or error}") from error
        except BaseException:
            store.close()
            raise
        return store

    def __enter__(self) -> Store:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let others write."""
        if self._file is not None:
            self._file.close()
            self._file = None

    @property
    def done(self) -> int:
        """Number of rows."""
        return len(self._rows)

    def missing(self) -> list[Cell]:
        """The cells without a row, in the grid's order."""
        return [cell for cell in self.grid.cells() if cell.key not in self._rows]

    def add(self, outcomes: Sequence[Outcome]) -> None:
        """Have rows, and trees that are kept, on the disk; a cell that has its row already is left as it is.

        Raises:
            StationError: where the disk takes nothing more; the rows before are kept.
        """
        new = {outcome.row.cell.key: outcome for outcome in outcomes if outcome.row.cell.key not in self._rows}
        try:
            for outcome in new.values():
                if outcome.found is not None:
                    _write(self.folder / FITS_FOLDER / fit_file(outcome.row.cell), outcome.found.encode())
            self._append("".join(row_line(outcome.row) for outcome in new.values()).encode())
        except OSError as error:
            raise StationError(
                f"can't write into '{self.folder}': {error.strerror or error}\n"
                f"{self.done} fits are kept; run the same command again to go on"
            ) from error
        self._rows |= {key: outcome.row for key, outcome in new.items()}

    def sweep(self) -> Sweep:
        """What there is."""
        return _sweep(self.folder, self.grid, self._rows, self.notices)

    def write_tables(self) -> None:
        """Write sweep.csv and sweep.parquet of all rows that there are; raises StationError where the disk is full."""
        import pyarrow.parquet as pq

        told, _ = _read_rows(self.folder, self.grid)  # what the disk has: a signal may have come between it and `_rows`
        rows = _ordered(told, self.grid)
        if not rows:
            return
        try:
            _write(self.folder / CSV_FILE, rows_csv(rows).encode())
            part = self.folder / (PARQUET_FILE + ".part")
            pq.write_table(rows_table(rows), part)
            part.replace(self.folder / PARQUET_FILE)
        except OSError as error:
            raise StationError(f"can't write the tables into '{self.folder}': {error.strerror or error}") from error

    def _lock(self) -> None:
        self._file = (self.folder / ROWS_FILE).open("ab")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StationError(
                f"another program is writing the sweep in '{self.folder}'; let it end, or stop it"
            ) from None

    def _take_up(self) -> None:
        before = _read_grid(self.folder)
        if (why := grid_changes(before, self.grid)) is not None:
            raise StationError(
                f"'{self.folder}' holds a sweep of another grid: {why}\n"
                "name another folder with --out, give the same grid, or begin anew with --force"
            )
        rows, torn = _read_rows(self.folder, before)
        if torn is not None:
            os.truncate(self.folder / ROWS_FILE, torn.whole)
            self.notices.append(torn.notice)
        own = {cell.key: cell for cell in self.grid.cells()}
        self._rows = {key: parse_row(row_line(row), own, str(self.folder)) for key, row in rows.items()}

    def _clear(self) -> None:
        """Take away what a sweep leaves; what else is in the folder stays."""
        os.truncate(self.folder / ROWS_FILE, 0)
        for name in (TREES_FOLDER, FITS_FOLDER):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        for name in (CSV_FILE, PARQUET_FILE):
            with suppress(FileNotFoundError):
                (self.folder / name).unlink()

    def _write_grid(self) -> None:
        for folder in (TREES_FOLDER, FITS_FOLDER):
            (self.folder / folder).mkdir(exist_ok=True)
        for named in self.grid.trees:
            _write(self.folder / TREES_FOLDER / f"{named.name}.json", to_json(named.tree).encode())
        _write(self.folder / GRID_FILE, grid_json(self.grid).encode())

    def _append(self, lines: bytes) -> None:
        if self._file is None:
            raise StationError(f"the sweep in '{self.folder}' is closed")
        self._file.write(lines)
        self._file.flush()
        os.fsync(self._file.fileno())


@dataclass(frozen=True)
class _Torn:
    """The end of rows.jsonl is torn; so many bytes before it are whole."""

    whole: int
    notice: str


def _is_first_breath(folder: Path) -> bool:
    """Whether a sweep was killed here before it had written its grid."""
    if not folder.is_dir():
        return False
    rows = folder / ROWS_FILE
    names = {path.name.removesuffix(".part") for path in folder.iterdir()}
    return rows.exists() and not rows.stat().st_size and names <= {ROWS_FILE, TREES_FOLDER, FITS_FOLDER, GRID_FILE}


def _read_grid(folder: Path) -> Grid:
    path = folder / GRID_FILE
    if not path.exists():
        raise InvalidFile(f"{folder} holds no sweep: it has no {GRID_FILE}\nrun: station sweep --out {folder}")

    def tree(name: str) -> KinematicTree:
        file = folder / TREES_FOLDER / f"{name}.json"
        return from_json(read_text(file, "generating tree"), str(file))

    return parse_grid(read_text(path, "sweep"), str(path), tree)


def _read_rows(folder: Path, grid: Grid) -> tuple[dict[CellKey, Row], _Torn | None]:
    """The rows, each cell's first; and from where on a kill or a power cut left no whole lines.

    Raises:
        InvalidFile: for a line that is no row, though rows follow: no kill does that.
    """
    path = folder / ROWS_FILE
    content = path.read_bytes() if path.exists() else b""
    lines = content.splitlines(keepends=True)
    whole = len(lines)
    while whole and not _is_whole(lines[whole - 1]):
        whole -= 1
    cells = {cell.key: cell for cell in grid.cells()}
    rows: dict[CellKey, Row] = {}
    for number, line in enumerate(lines[:whole], start=1):
        row = parse_row(line.decode(errors="replace"), cells, f"{path}, line {number}")
        rows.setdefault(row.cell.key, row)
    if whole == len(lines):
        return rows, None
    notice = f"{path}: its end was torn, as by a kill, and is left out: what it told is fitted again"
    return rows, _Torn(sum(map(len, lines[:whole])), notice)


def _is_whole(line: bytes) -> bool:
    """Whether a line has its end and is JSON."""
    try:
        json.loads(line)
    except ValueError:
        return False
    return line.endswith(b"\n")


def _sweep(folder: Path, grid: Grid, rows: dict[CellKey, Row], notices: Sequence[str]) -> Sweep:
    versions = sorted({row.versions for row in rows.values()})
    mixed = [f"the fits are not all by the same programs, last digits may differ: {'; '.join(versions)}"]
    return Sweep(folder, grid, _ordered(rows, grid), (*notices, *(mixed if len(versions) > 1 else ())))


def _ordered(rows: dict[CellKey, Row], grid: Grid) -> tuple[Row, ...]:
    return tuple(rows[cell.key] for cell in grid.cells() if cell.key in rows)


def _write(path: Path, content: bytes) -> None:
    """Write a file in one step: a reader finds the old one or the new one, never half of it."""
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
