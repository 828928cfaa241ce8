"""What came of one fit, and its forms: a line of JSON as it comes, the columns of sweep.csv and sweep.parquet."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from station.errors import InvalidFile
from station.experiments.grid import Cell, CellKey
from station.simulate import SimulationOptions

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class JointRow:
    """What a fit found of one true joint; None where there is nothing to compare (`station.tree_scores`).

    Attributes:
        joint: the true joint's name.
        true_type, found_type: types.
        found_joint: name in the found tree.
        axis_error_deg: between the axes, whichever way they point.
        point_error_mm: from the found point to the true axis.
        state_rms: of found less true state, but for their mean; deg, or mm of a prismatic joint.
    """

    joint: str
    true_type: str
    found_type: str | None
    found_joint: str | None
    axis_error_deg: float | None
    point_error_mm: float | None
    state_rms: float | None


@dataclass(frozen=True, eq=False)
class Row:
    """One fit of a sweep: its cell, and what came of it.

    Attributes:
        cell: what was fitted, and how.
        groups_correct, structure_correct, types_correct: see `station.tree_scores`; False where the fit failed.
        axis_error_deg: the largest of the joints' that have one; None if none has.
        point_error_mm: likewise.
        joints: one for each true joint; none where the fit failed.
        fit_s: processor time of the fit, which has one thread; an even share of that of all that are fitted together.
        error: why the fit failed; None if it didn't.
        versions: of the programs that fitted it.
    """

    cell: Cell
    groups_correct: bool
    structure_correct: bool
    types_correct: bool
    axis_error_deg: float | None
    point_error_mm: float | None
    joints: tuple[JointRow, ...]
    fit_s: float
    error: str | None
    versions: str


# Of a Row, what is a column as it is.
RESULTS = ("structure_correct", "types_correct", "axis_error_deg", "groups_correct", "point_error_mm", "fit_s", "error")
SETTINGS = tuple(entry.name for entry in fields(SimulationOptions) if entry.name not in ("noise", "inflation"))


def row_line(row: Row) -> str:
    """A line of rows.jsonl, strict JSON; what all cells of the grid share is not told."""
    tree, method, translation_m, rotation_rad, inflation, repeat = row.cell.key
    told = {
        "tree": tree,
        "method": method,
        "noise_translation_m": translation_m,
        "noise_rotation_rad": rotation_rad,
        "inflation": inflation,
        "repeat": repeat,
        "seed": row.cell.seed,
        **{name: getattr(row, name) for name in RESULTS},
        "joints": [asdict(joint) for joint in row.joints],
        "versions": row.versions,
    }
    return json.dumps(told, allow_nan=False, ensure_ascii=False) + "\n"


def parse_row(line: str, cells: Mapping[CellKey, Cell], where: str) -> Row:
    """The row of a line.

    Args:
        line: as `row_line` wrote it.
        cells: of the grid that it is of.
        where: file and line, for errors.

    Raises:
        InvalidFile: for what is no row, or of no cell of the grid.
    """
    try:
        told: dict[str, Any] = json.loads(line)
        names = ("tree", "method", "noise_translation_m", "noise_rotation_rad", "inflation", "repeat")
        key: CellKey = tuple(told[name] for name in names)  # pyright: ignore[reportAssignmentType]
        results = {name: told[name] for name in RESULTS}
        joints = tuple(JointRow(**joint) for joint in told["joints"])
        seed, versions = told["seed"], told["versions"]
    except (ValueError, KeyError, TypeError) as error:
        raise InvalidFile(f"{where} is no row of a sweep: {error}") from None
    cell = cells.get(key)
    if cell is None or cell.seed != seed:
        raise InvalidFile(f"{where}: no such fit is in the grid of this sweep: {line.strip()[:200]}")
    return Row(cell=cell, joints=joints, versions=versions, **results)


def columns(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """The columns of the table of all rows, in order: DESIGN's first, then the rest; `joints` as lists of mappings."""
    cells = [row.cell for row in rows]
    table: dict[str, list[Any]] = {
        "method": [cell.method for cell in cells],
        "noise_translation_m": [float(cell.noise.translation_m) for cell in cells],
        "noise_rotation_rad": [float(cell.noise.rotation_rad) for cell in cells],
        "inflation": [cell.options.inflation for cell in cells],
        "repeat": [cell.repeat for cell in cells],
        "seed": [cell.seed for cell in cells],
    }
    table |= {name: [getattr(row, name) for row in rows] for name in RESULTS[:3]}
    table |= {"tree": [cell.tree for cell in cells]}
    table |= {name: [getattr(row, name) for row in rows] for name in RESULTS[3:]}
    table |= {"joints": [[asdict(joint) for joint in row.joints] for row in rows]}
    table |= {"noise_model": [cell.options.noise.name for cell in cells]}
    table |= {name: [getattr(cell.options, name) for cell in cells] for name in SETTINGS}
    return table | {"versions": [row.versions for row in rows]}


def rows_csv(rows: Sequence[Row]) -> str:
    """sweep.csv: true and false, blank where there is nothing; the joints of a fit as JSON in one cell."""
    import csv
    import io

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    table = columns(rows)
    writer.writerow(table)
    writer.writerows([_cell_text(value) for value in values] for values in zip(*table.values(), strict=True))
    return text.getvalue()


def _cell_text(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return json.dumps(value, allow_nan=False, separators=(",", ":"))
    return repr(value) if isinstance(value, float) else value


def rows_table(rows: Sequence[Row]) -> pa.Table:
    """sweep.parquet: the same columns; null where there is nothing; joints as lists of structs."""
    import pyarrow as pa

    kinds = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
    usual = SimulationOptions()
    sample = {name: getattr(usual, name) for name in SETTINGS}
    sample |= {"axis_error_deg": 0.0, "point_error_mm": 0.0, "error": ""}
    joint = pa.struct([(entry.name, pa.string()) for entry in fields(JointRow)[:4]]
                      + [(entry.name, pa.float64()) for entry in fields(JointRow)[4:]])  # fmt: skip
    arrays = {
        name: pa.array(values, pa.list_(joint) if name == "joints" else kinds[type(sample.get(name, values[0]))])
        for name, values in columns(rows).items()
    }
    return pa.table(arrays)
