"""An .rrd below rerun: where its last whole message ends, and rows of its columns in the order of their times.

An .rrd (version 2) is a header of 12 bytes, "RRF2", version, options, then messages: kind (u64), length (u64), payload.
A message of kind 0 ends it, with the index of the whole file as its payload; a trailer of 32 bytes follows. A writer
that was killed leaves neither, and its last message may be cut anywhere.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from station.errors import InvalidFile
from station.logs import FloatArray

IntArray = NDArray[np.int64]

MAGIC = b"RRF2"
HEADER_BYTES = 12
TRAILER_MAGIC = b"RRF2FOOT"
TRAILER_BYTES = 32
MESSAGE = struct.Struct("<QQ")
END_KIND = 0
# Kinds of message: end, store info, chunk, command to activate a blueprint.
KINDS = frozenset({END_KIND, 1, 2, 3})


@dataclass(frozen=True)
class Framing:
    """How far a file consists of whole messages.

    Attributes:
        size: bytes in the file.
        whole: bytes up to the end of the last whole message.
        messages: how many there are, the end included.
        body: bytes up to the end of the last one that isn't the end with its index.
        complete: whether the file was closed: it has its end, and with it the index.
    """

    size: int
    whole: int
    messages: int
    body: int
    complete: bool

    @property
    def torn(self) -> bool:
        """Whether something follows the last whole message that isn't the trailer of a complete file."""
        return not self.complete and self.whole < self.size

    def without_index(self) -> Framing:
        """The same file as if it had never been closed."""
        return replace(self, whole=self.body, complete=False)


def scan_framing(path: Path) -> Framing:
    """Walk the messages of the file without reading what is in them.

    Raises:
        InvalidFile: the file can't be read, is empty or is no .rrd of this version.
    """
    try:
        with path.open("rb") as file:
            return _scan(file, path)
    except OSError as error:
        raise InvalidFile(f"{path} can't be read: {error.strerror}") from error


def _scan(file: BinaryIO, path: Path) -> Framing:
    size = file.seek(0, 2)
    file.seek(0)
    header = file.read(HEADER_BYTES)
    if not header:
        raise InvalidFile(f"{path} is empty; nothing was recorded in it")
    if len(header) < HEADER_BYTES or not header.startswith(MAGIC):
        raise InvalidFile(f"{path} is no recording: it starts with {header[:4]!r}, an .rrd with {MAGIC!r}")
    whole, body, messages = HEADER_BYTES, HEADER_BYTES, 0
    while len(head := file.read(MESSAGE.size)) == MESSAGE.size:
        kind, length = MESSAGE.unpack(head)
        end = whole + MESSAGE.size + length
        if kind not in KINDS or end > size or (kind == END_KIND and not _ends_with_trailer(file, end, size)):
            break
        whole, messages = end, messages + 1
        if kind == END_KIND:
            return Framing(size, whole, messages, body, complete=True)
        body = end
        file.seek(end)
    return Framing(size, whole, messages, body, complete=False)


def _ends_with_trailer(file: BinaryIO, end: int, size: int) -> bool:
    """Whether only the trailer follows: zeros, as a power cut leaves them, read as an end without anything in it."""
    file.seek(end)
    trailer = file.read(TRAILER_BYTES + 1)
    return end < size and len(trailer) == TRAILER_BYTES and TRAILER_MAGIC in trailer


def copy_whole(path: Path, whole: int, target: Path) -> None:
    """Copy the first `whole` bytes of the file to `target`."""
    shutil.copyfile(path, target)
    with target.open("r+b") as file:
        file.truncate(whole)


ROW_ID = "rerun.controls.RowId"


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
        self._columns = {name: _joined(batches, name) for name in {timeline, *columns}}
        times = self._integers(timeline)
        ids = np.frombuffer(b"".join(_joined(batches, ROW_ID).to_pylist()), dtype=">u8").reshape(-1, 2)
        self._order = np.lexsort((ids[:, 1], ids[:, 0], times))
        self.times: IntArray = times[self._order]

    def __len__(self) -> int:
        return len(self._order)

    def _integers(self, name: str) -> IntArray:
        column = self._columns[name]
        if not len(column):
            return np.zeros(0, np.int64)
        return column.cast(pa.int64()).to_numpy(zero_copy_only=False)

    def index(self, name: str) -> IntArray:
        """(N,) values of an index column."""
        return self._integers(name)[self._order]

    def _lists(self, name: str) -> pa.ListArray:
        return self._columns[name].take(pa.array(self._order))

    def lengths(self, name: str) -> IntArray:
        """(N,) how many values a component column has in each row."""
        return _lengths(self._lists(name)) if len(self) else np.zeros(0, np.int64)

    def texts(self, name: str) -> list[str]:
        """N texts of a component column, one a row; empty where there is none."""
        return [(texts or [""])[0] for texts in self._lists(name).to_pylist()]

    def floats(self, name: str, counts: IntArray, shape: tuple[int, ...] = ()) -> FloatArray:
        """(sum(counts), *shape) values of a component column whose rows have `counts` (N,) such items each."""
        return self._numbers(name, counts, shape, np.float64)

    def integers(self, name: str, counts: IntArray, shape: tuple[int, ...] = ()) -> IntArray:
        """The same of whole numbers."""
        return self._numbers(name, counts, shape, np.int64)

    def _numbers(self, name: str, counts: IntArray, shape: tuple[int, ...], dtype: type) -> NDArray[Any]:
        total = int(counts.sum())
        if not len(self):
            return np.zeros((total, *shape), dtype)
        lists = self._lists(name)
        if not np.array_equal(_lengths(lists), counts * int(np.prod(shape))):
            raise InvalidFile(f"rows of {name} have other lengths than {shape} for each item")
        flat = lists.flatten().to_numpy(zero_copy_only=False)
        if flat.dtype != dtype:
            raise InvalidFile(f"{name} has numbers of type {flat.dtype}; want {np.dtype(dtype)}")
        return flat.reshape(total, *shape)


def _joined(batches: Sequence[pa.RecordBatch], name: str) -> Any:
    columns = [batch.column(name) for batch in batches]
    return pa.chunked_array(columns).combine_chunks() if columns else pa.array([], pa.null())


def _lengths(lists: pa.ListArray) -> IntArray:
    return lists.value_lengths().fill_null(0).to_numpy(zero_copy_only=False).astype(np.int64)
