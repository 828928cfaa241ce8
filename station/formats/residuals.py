"""Residuals of a fit on corners as Parquet: a row a marker of a frame, float64 to the last bit; tests in the metadata.

Columns: `t_s`, `marker_id`, `part`, `tilt_rad`, `corners_px` and `residual_px` (lists of u0, v0, u1, ... v3),
`outward_px`, `sigma_px`, `chi2`, `inlier`, `doubtful`. Metadata: `schema` (residuals/1), `size_px` and `checks`, both
JSON.
"""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from station.errors import InvalidData, InvalidFile
from station.fit.image_checks import Finding, ModelChecks, Residuals, Size
from station.fit.image_checks.residuals import ROW_FIELDS
from station.logs import FloatArray

SCHEMA = "residuals/1"
LISTS = ("corners_px", "residual_px")
NUMBERS = 8


def write_residuals(residuals: Residuals, file: BinaryIO) -> None:
    """Write all rows, and what the tests found."""
    columns = {name: _column(name, getattr(residuals, name)) for name in ROW_FIELDS}
    metadata = {
        "schema": SCHEMA,
        "size_px": json.dumps(residuals.size_px),
        "checks": json.dumps(asdict(residuals.checks), allow_nan=False),
    }
    pq.write_table(pa.table(columns).replace_schema_metadata(metadata), file)


def _column(name: str, values: Any) -> pa.Array:
    if name in LISTS:
        return pa.FixedSizeListArray.from_arrays(_floats(values.ravel()), NUMBERS)
    if name == "part":
        return pa.array(list(values), pa.string())
    return _floats(values) if values.dtype.kind == "f" else pa.array(values)


def _floats(values: FloatArray) -> pa.Array:
    return pa.array(np.ascontiguousarray(values), from_pandas=True)


_TYPES: dict[str, pa.DataType] = {
    "marker_id": pa.int64(),
    "part": pa.string(),
    "doubtful": pa.bool_(),
    **{name: pa.list_(pa.float64(), NUMBERS) for name in LISTS},
}


def read_residuals(path: Path) -> Residuals:
    """Read what `write_residuals` wrote.

    Raises:
        InvalidFile: a StationError: a file that is missing, torn, of another schema, or with other columns.
    """
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise InvalidFile(f"{path} can't be read as Parquet: {error}; fit again") from error
    metadata = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    if metadata.get("schema") != SCHEMA:
        raise InvalidFile(f"{path} has the schema '{metadata.get('schema')}'; want '{SCHEMA}'; fit again")
    for name in ROW_FIELDS:
        want = _TYPES.get(name, pa.float64())
        have = table.schema.field(name).type if name in table.column_names else None
        if have != want:
            raise InvalidFile(f"{path}: column {name} is {have or 'missing'}; want {want}; fit again")
    try:
        rows = {name: _values(table, name) for name in ROW_FIELDS}
        width, height = json.loads(metadata["size_px"])
        return Residuals(**rows, size_px=(int(width), int(height)), checks=_checks(metadata["checks"]))
    except (KeyError, TypeError, ValueError, InvalidData) as error:
        raise InvalidFile(f"{path} is no whole '{SCHEMA}': {error!r}; fit again") from error


def _values(table: pa.Table, name: str) -> Any:
    column = table.column(name).combine_chunks()
    if name in LISTS:
        return column.flatten().to_numpy(zero_copy_only=False).reshape(-1, 4, 2)
    return tuple(column.to_pylist()) if name == "part" else column.to_numpy(zero_copy_only=False)


def _checks(text: str) -> ModelChecks:
    told = json.loads(text)
    findings = tuple(_finding(finding) for finding in told["findings"])
    return ModelChecks(**_known(ModelChecks, told) | {"findings": findings, "untested": tuple(told["untested"])})


def _finding(told: dict[str, Any]) -> Finding:
    sizes = tuple(Size(**_known(Size, size)) for size in told["sizes"])
    return Finding(**_known(Finding, told) | {"sizes": sizes, "or_else": tuple(told["or_else"])})


def _known(kind: type, told: dict[str, Any]) -> dict[str, Any]:
    """The values, none too many; a dataclass says itself which are missing."""
    extra = set(told) - {field.name for field in fields(kind)}
    if extra:
        raise ValueError(f"{kind.__name__} has no {', '.join(sorted(extra))}")
    return told
