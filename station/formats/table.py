"""Rows of text to columns of numbers: what the importers share; every refusal names the file and the row."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from station.errors import InvalidFile
from station.logs import FloatArray

_BYTE_ORDER_MARK = "\ufeff"


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Cells of a text file by column.

    Attributes:
        name: the file's name, for errors.
        columns: each column's name and its N cells, without blanks around them.
        rows: N row numbers as an editor counts lines: the first line of the file is row 1, whatever is in it.
    """

    name: str
    columns: dict[str, list[str]]
    rows: tuple[int, ...]

    def refusal(self, index: int, message: str) -> InvalidFile:
        """The error to raise for data row `index`, counted from 0."""
        return InvalidFile(f"{self.name}, row {self.rows[index]}: {message}")

    def floats(self, column: str) -> FloatArray:
        """(N,) finite numbers of a column, NaN where a cell is blank; raises InvalidFile for anything else."""
        cells = self.columns[column]
        try:
            values = np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
        except ValueError:
            bad = next(i for i, cell in enumerate(cells) if cell and not _is_number(cell))
            raise self.refusal(bad, f"{column} is '{cells[bad]}'; want a number") from None
        for i in np.flatnonzero(~np.isfinite(values)):
            if cells[i]:
                raise self.refusal(int(i), f"{column} is '{cells[i]}'; want a finite number")
        return values

    def filled_floats(self, column: str) -> FloatArray:
        """(N,) finite numbers of a column; raises InvalidFile for a blank cell too."""
        values = self.floats(column)
        blank = np.flatnonzero(np.isnan(values))
        if blank.size:
            raise self.refusal(int(blank[0]), f"{column} is blank; want a number")
        return values

    def times(self, column: str, *, repeats: bool) -> FloatArray:
        """(N,) seconds of a column that never fall and, unless they may, never repeat; raises InvalidFile."""
        t_s = self.filled_floats(column)
        before, after = t_s[:-1], t_s[1:]
        wrong = np.flatnonzero(after < before if repeats else after <= before)
        if wrong.size:
            i = int(wrong[0]) + 1
            rule = "times never fall" if repeats else "times increase"
            raise self.refusal(i, f"{column} {t_s[i]:.15g} follows {t_s[i - 1]:.15g}; want rows in which {rule}")
        return t_s


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_header(text: str) -> tuple[str, ...]:
    """Cells of the first line of comma-separated text that isn't blank; none if there is no such line."""
    for line in text.removeprefix(_BYTE_ORDER_MARK).splitlines():
        if line.strip():
            return tuple(cell.strip() for cell in next(csv.reader([line])))
    return ()


def count_words(text: str) -> int:
    """Number of words in the first line that isn't blank and doesn't begin with #; 0 if there is no such line."""
    return next((len(words) for words in _word_lines(text) if words), 0)


def parse_csv(text: str, name: str) -> Table:
    """Table of comma-separated text under a header, blank lines skipped.

    Raises:
        InvalidFile: without a header or without data, for a column without a name or there twice, and for a row of
            another width than the header's.
    """
    lines = csv.reader(text.removeprefix(_BYTE_ORDER_MARK).splitlines())
    try:
        cells, rows = _filled(lines)
    except csv.Error as error:
        raise InvalidFile(f"{name}, row {lines.line_num}: {error}") from None
    if not cells:
        raise InvalidFile(f"{name} is empty; want a header and rows of data below it")
    header = [cell.strip() for cell in cells[0]]
    if "" in header:
        raise InvalidFile(f"{name}, row {rows[0]}: column {header.index('') + 1} has no name")
    twice = [column for column in header if header.count(column) > 1]
    if twice:
        raise InvalidFile(f"{name}, row {rows[0]}: column '{twice[0]}' is there twice")
    return _table(name, header, cells[1:], rows[1:])


def parse_words(text: str, name: str, headers: Sequence[Sequence[str]]) -> Table:
    """Table of numbers parted by blanks; blank lines and lines that begin with # are skipped.

    Args:
        text: the file's text.
        name: the file's name, for errors.
        headers: names of the columns, one list for each width that is allowed; the first row of data chooses.

    Raises:
        InvalidFile: without data, and for a row of another width.
    """
    cells, rows = _filled(_word_lines(text))
    if not cells:
        raise InvalidFile(f"{name} has no data; want rows of {_choices(headers)}")
    fitting = [header for header in headers if len(header) == len(cells[0])]
    if not fitting:
        raise InvalidFile(f"{name}, row {rows[0]}: {len(cells[0])} numbers; want {_choices(headers)}")
    return _table(name, fitting[0], cells, rows)


def _word_lines(text: str) -> Iterator[list[str]]:
    """Words of each line, none for comments."""
    for line in text.removeprefix(_BYTE_ORDER_MARK).splitlines():
        yield [] if line.lstrip().startswith("#") else line.split()


def _choices(headers: Sequence[Sequence[str]]) -> str:
    return " or ".join(f"{len(header)} numbers ({' '.join(header)})" for header in headers)


def _filled(lines: Iterable[list[str]]) -> tuple[list[list[str]], tuple[int, ...]]:
    """Lines with something in them, and their row numbers."""
    filled = [(row, cells) for row, cells in enumerate(lines, start=1) if any(cell.strip() for cell in cells)]
    return [cells for _, cells in filled], tuple(row for row, _ in filled)


def _table(name: str, header: Sequence[str], cells: list[list[str]], rows: tuple[int, ...]) -> Table:
    if not cells:
        raise InvalidFile(f"{name} has no data below its header")
    for row, line in zip(rows, cells, strict=True):
        if len(line) != len(header):
            raise InvalidFile(f"{name}, row {row}: {len(line)} cells; want {len(header)} ({', '.join(header)})")
    columns = zip(*cells, strict=True)
    stripped = ([cell.strip() for cell in column] for column in columns)
    return Table(name, dict(zip(header, stripped, strict=True)), rows)
