"""Numbers in a TOML text changed in place: comments, order and layout stay; the result is read again to be sure."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.errors import InvalidFile, StationError

Key = tuple[str | int, ...]
"""Where a value is: keys, and in arrays of tables the number, from 0: ("joint", 1, "servo", 0, "zero")."""

HEADER = re.compile(r"^\s*(\[\[?)\s*([A-Za-z0-9_.-]+)\s*\]\]?\s*(#.*)?$")
# A bare key and a number, with whatever comes before and after it.
NUMBER = re.compile(r"^(\s*([A-Za-z0-9_-]+)\s*=\s*)([+-]?[0-9][0-9_]*(?:\.[0-9_]+)?(?:[eE][+-]?[0-9]+)?)(\s*(?:#.*)?)$")


@dataclass(frozen=True)
class _Table:
    """A table of the text: its place, and the lines (from, to) of its own keys."""

    place: Key
    start: int
    end: int


def set_numbers(text: str, values: Mapping[Key, int | float], name: str) -> str:
    """The TOML `text` of the file `name` with numbers changed or added; everything else is as it was.

    Raises:
        InvalidFile: a table isn't written out under a header of its own, or the result doesn't read as it should.
    """
    wanted = _expected(tomllib.loads(text), values, name)
    lines = text.splitlines(keepends=True)
    for key, value in values.items():
        _set(lines, key, value, name)
    edited = "".join(lines)
    try:
        good = tomllib.loads(edited) == wanted
    except tomllib.TOMLDecodeError:
        good = False
    if not good:
        raise _not_safe(name)
    return edited


def rewrite(path: Path, values: Mapping[Key, int | float]) -> Path:
    """Change numbers in a TOML file; the old one is kept beside it, and its path returned.

    Raises:
        InvalidFile: as `set_numbers` does, before anything is written.
        StationError: the file can't be written.
    """
    text = path.read_bytes().decode("utf-8")  # with the line ends that it has
    edited = set_numbers(text, values, str(path))
    kept = next(kept for kept in _names_beside(path) if not kept.exists())
    part = path.with_name(f".{path.name}.part")
    try:
        kept.write_text(text, encoding="utf-8", newline="")
        part.write_text(edited, encoding="utf-8", newline="")
        part.replace(path)
    except OSError as error:
        raise StationError(f"can't write {path}: {error.strerror}\nset the values by hand") from error
    finally:
        part.unlink(missing_ok=True)
    return kept


def _names_beside(path: Path) -> Iterator[Path]:
    yield path.with_name(f"{path.name}.old")
    number = 2
    while True:
        yield path.with_name(f"{path.name}.old{number}")
        number += 1


def _not_safe(name: str) -> InvalidFile:
    return InvalidFile(f"{name} is written in a way that can't be changed safely; nothing was\nset the values by hand")


def _expected(document: dict[str, Any], values: Mapping[Key, int | float], name: str) -> dict[str, Any]:
    expected = copy.deepcopy(document)
    for (*place, last), value in values.items():
        table: Any = expected
        try:
            for key in place:
                table = table[key]
            table[last] = value
        except (LookupError, TypeError):
            raise _not_safe(name) from None
    return expected


def _set(lines: list[str], key: Key, value: int | float, name: str) -> None:
    """Replace the number on the key's line, or add a line after the last key of its table."""
    table = next((table for table in _tables(lines) if table.place == key[:-1]), None)
    if table is None:
        raise _not_safe(name)
    last = table.start
    for at in range(table.start, table.end):
        body = lines[at].rstrip("\r\n")
        found = NUMBER.match(body)
        if found is not None and found[2] == key[-1]:
            lines[at] = f"{found[1]}{value!r}{found[4]}{lines[at][len(body) :]}"
            return
        if body.strip() and not body.lstrip().startswith("#"):
            last = at + 1
    ending = "\r\n" if lines[0].endswith("\r\n") else "\n"
    if not lines[last - 1].endswith("\n"):
        lines[last - 1] += ending
    lines.insert(last, f"{key[-1]} = {value!r}{ending}")


def _tables(lines: list[str]) -> Iterator[_Table]:
    """The tables that have a header, in the order of the text; the one without comes first."""
    place: Key = ()
    start = 0
    counts: dict[Key, int] = {}
    for at, line in enumerate(lines):
        header = HEADER.match(line.rstrip("\r\n"))
        if header is None:
            continue
        yield _Table(place, start, at)
        place, start = _place(header[2].split("."), header[1] == "[[", counts), at + 1
    yield _Table(place, start, len(lines))


def _place(names: list[str], is_array: bool, counts: dict[Key, int]) -> Key:
    """Where a header's table is: within the latest table of each array that it names."""
    place: Key = ()
    for depth, key in enumerate(names):
        place = (*place, key)
        if is_array and depth == len(names) - 1:
            counts[place] = counts.get(place, -1) + 1
        if place in counts:
            place = (*place, counts[place])
    return place
