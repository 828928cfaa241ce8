"""Rows of one entity, gathered from rerun's chunks in the order of their times, as arrays of NumPy.

Arrow's own ways of doing this take seconds for a session of minutes, and import pandas where it is installed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from station.errors import InvalidFile
from station.logs import FloatArray

IntArray = NDArray[np.int64]

ROW_ID = "rerun.controls.RowId"
ID_BYTES = 16
ARROW_TYPES = {np.int64: pa.int64(), np.float64: pa.float64()}


class Rows:
    """All rows of one entity, in the order of a timeline and, at equal times, of logging.

    Args:
        batches: the entity's chunks, in any order; chunks without the timeline or a column are refused.
        timeline: an index column, int64 or nanoseconds.
        columns: index and component columns to keep.

    Raises:
        InvalidFile: a chunk lacks a column.
    """

    def __init__(self, batches: Sequence[pa.RecordBatch], timeline: str, columns: Sequence[str]) -> None:
        for batch in batches:
            if missing := {timeline, ROW_ID, *columns} - set(batch.schema.names):
                raise InvalidFile(f"rows without {', '.join(sorted(missing))}")
        names = list(dict.fromkeys((ROW_ID, timeline, *columns)))
        kept = [batch.select(names) for batch in batches if batch.num_rows]
        kept.sort(key=lambda batch: batch.column(0)[0].as_py())  # by the first row's identity: in the order of logging
        table = pa.Table.from_batches(kept).combine_chunks() if kept else None
        self._columns: dict[str, Any] = {name: table.column(name).chunk(0) for name in names} if table else {}
        self._order: IntArray | None = None
        self.times: IntArray = self.index(timeline)
        if kept:
            ids = _ids(self._columns[ROW_ID])
            order = np.lexsort((ids[:, 1], ids[:, 0], self.times))
            # Most often they are in order already: a chunk is logged after the other.
            if not np.array_equal(order, np.arange(len(order))):
                self._order, self.times = order, self.times[order]

    def __len__(self) -> int:
        return len(self.times)

    def index(self, name: str) -> IntArray:
        """(N,) values of an index column."""
        return self._ordered(_int64(self._columns[name])) if self._columns else np.zeros(0, np.int64)

    def lengths(self, name: str) -> IntArray:
        """(N,) how many values a component column has in each row."""
        return self._ordered(_lengths(self._columns[name])) if self._columns else np.zeros(0, np.int64)

    def texts(self, name: str) -> list[str]:
        """N texts of a component column, one a row; empty where there is none."""
        texts = [(texts or [""])[0] for texts in self._columns[name].to_pylist()] if self._columns else []
        return texts if self._order is None else [texts[row] for row in self._order]

    def floats(self, name: str, counts: IntArray, shape: tuple[int, ...] = ()) -> FloatArray:
        """(sum(counts), *shape) values of a component column whose rows have `counts` (N,) such items each."""
        return self._numbers(name, counts, shape, np.float64)

    def integers(self, name: str, counts: IntArray, shape: tuple[int, ...] = ()) -> IntArray:
        """The same of whole numbers."""
        return self._numbers(name, counts, shape, np.int64)

    def _numbers(self, name: str, counts: IntArray, shape: tuple[int, ...], dtype: type) -> NDArray[Any]:
        size = int(np.prod(shape))
        if not np.array_equal(self.lengths(name), counts * size):
            raise InvalidFile(f"rows of {name} have other lengths than {shape} for each item")
        if not self._columns:
            return np.zeros((0, *shape), dtype)
        flat = _values(name, self._columns[name], dtype)
        if self._order is not None:
            flat = flat[_places(counts * size, self._order)]
        return flat.reshape(int(counts.sum()), *shape)

    def _ordered(self, values: NDArray[Any]) -> NDArray[Any]:
        return values if self._order is None else values[self._order]


def _ids(column: pa.Array) -> NDArray[np.uint64]:
    """(N, 2) the rows' identities, which rise in the order of logging."""
    content = np.frombuffer(column.buffers()[1], ">u8", offset=column.offset * ID_BYTES, count=2 * len(column))
    return content.reshape(-1, 2).astype(np.uint64)


def _int64(column: pa.Array) -> IntArray:
    """(N,) whole numbers, or times, which are whole numbers of nanoseconds."""
    if column.null_count or column.type.bit_width != 64:
        raise InvalidFile(f"an index of type {column.type} with {column.null_count} gaps")
    return np.frombuffer(column.buffers()[1], np.int64, offset=column.offset * 8, count=len(column))


def _lengths(column: pa.ListArray) -> IntArray:
    if column.null_count:
        return np.array([len(values or ()) for values in column.to_pylist()], np.int64)
    offsets = np.frombuffer(column.buffers()[1], np.int32, offset=column.offset * 4, count=len(column) + 1)
    return np.diff(offsets).astype(np.int64)


def _values(name: str, column: pa.ListArray, dtype: type) -> NDArray[Any]:
    """All values of a column's rows, one after the other."""
    values = column.flatten()
    if values.type != ARROW_TYPES[dtype] or values.null_count:
        raise InvalidFile(f"{name} has numbers of type {values.type}; want {ARROW_TYPES[dtype]}")
    return np.frombuffer(values.buffers()[1], dtype, offset=values.offset * 8, count=len(values))


def _places(lengths: IntArray, order: IntArray) -> IntArray:
    """Where the values of the rows stand that are put in `order`; `lengths` are those of the rows so ordered."""
    unordered = np.empty_like(lengths)
    unordered[order] = lengths
    starts = (np.cumsum(unordered) - unordered)[order]
    return np.repeat(starts - (np.cumsum(lengths) - lengths), lengths) + np.arange(int(lengths.sum()))
