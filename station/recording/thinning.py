"""Reads every second, fourth, eighth, ... frame of a long session, so that memory doesn't grow with its length."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from station.errors import InvalidFile
from station.recording.layout import FRAME


class Thinning:
    """Takes the rows of a session's frames, and once they have too many markers leaves frames out, evenly.

    Args:
        most: markers of all frames that are kept; None: all.
    """

    def __init__(self, most: int | None) -> None:
        self._most = most
        self._every = 1
        self._markers = 0
        self._pieces: dict[Path, list[pa.RecordBatch]] = {}
        self._seen: dict[Path, int] = {}

    def begin(self, piece: Path) -> None:
        """The rows of a file follow; those that there were of it, if it is read again, are forgotten."""
        self._pieces[piece], self._seen[piece] = [], 0
        self._markers = sum(map(_markers, self.rows))

    def take(self, piece: Path, batch: pa.RecordBatch) -> None:
        """Keep some rows, or all; raises InvalidFile for rows without numbers of frames."""
        self._seen[piece] += batch.num_rows
        kept = self._thinned(batch)
        self._pieces[piece].append(kept)
        if self._most is None:
            return
        self._markers += _markers(kept)
        while self._markers > self._most:
            self._every *= 2
            self._pieces = {path: [self._thinned(each) for each in of_it] for path, of_it in self._pieces.items()}
            self._markers = sum(map(_markers, self.rows))

    @property
    def rows(self) -> list[pa.RecordBatch]:
        """What is kept of all files."""
        return [batch for of_it in self._pieces.values() for batch in of_it]

    @property
    def left_out(self) -> int:
        """How many frames are not."""
        return sum(self._seen.values()) - sum(batch.num_rows for batch in self.rows)

    @property
    def notices(self) -> tuple[str, ...]:
        """What was left out, in words; nothing if nothing was."""
        if not self.left_out:
            return ()
        return (f"one frame in {self._every} is used: all of so long a session would need too much memory",)

    def _thinned(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        if self._every == 1:
            return batch
        if FRAME not in batch.schema.names:
            raise InvalidFile(f"rows without {FRAME}")
        number = batch.column(FRAME).cast(pa.int64()).to_numpy(zero_copy_only=False)
        return batch.filter(pa.array(number % self._every == 0))


def _markers(batch: pa.RecordBatch) -> int:
    """How many markers there are in all rows of a batch."""
    if "count" not in batch.schema.names:
        raise InvalidFile("rows without count")
    return int(pc.sum(pc.list_flatten(batch.column("count"))).as_py() or 0)
