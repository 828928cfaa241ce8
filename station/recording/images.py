"""The images of a recording's frames, which are read only when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import LazyChunkStream

from station.recording.layout import BLOB, ELAPSED, IMAGE


def find_image(stream: LazyChunkStream, elapsed_ns: int) -> bytes | None:
    """The JPEG at this time since the session's start (ns); None where there is none."""
    for chunk in stream.filter(content=f"/{IMAGE}", is_static=False, components=BLOB):
        batch = chunk.to_record_batch()
        hits = np.flatnonzero(batch.column(ELAPSED).cast(pa.int64()).to_numpy() == elapsed_ns)
        if hits.size:
            return _blob(batch.column(BLOB)[int(hits[0])])
    return None


def images(stream: LazyChunkStream) -> Iterator[tuple[int, bytes]]:
    """Time since the start (ns) and JPEG of each frame, as the chunks have them: in the order of writing."""
    for chunk in stream.filter(content=f"/{IMAGE}", is_static=False, components=BLOB):
        batch = chunk.to_record_batch()
        times = batch.column(ELAPSED).cast(pa.int64()).to_pylist()
        for row, elapsed_ns in enumerate(times):
            yield elapsed_ns, _blob(batch.column(BLOB)[row])


def _blob(cell: Any) -> bytes:
    """The bytes of one image: a list of one list of bytes, however Arrow keeps them."""
    value = cell.values[0]
    return value.as_py() if isinstance(value, pa.BinaryScalar) else value.values.to_numpy().tobytes()
