"""Makes one whole recording, with an index, of what an interrupted or killed program left in a session's folder.

The new file is made beside the old ones and takes their place in one step each: `recording.joined.rrd`, which while it
is there is all of the recording, then `recording.rrd`. Whatever fails, and whenever, all that could be read before can
be read after.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from datetime import timedelta
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
from rerun.chunk import LazyChunkStream

from station.errors import InvalidFile, StationError
from station.recording.blueprint import session_blueprint
from station.recording.contents import read_description
from station.recording.layout import PROPERTY_ENTITY
from station.recording.lock import SessionBusy, SessionLock
from station.recording.opening import has_rows, notices_on, open_piece, read_piece, sound_framing
from station.recording.rrd_files import HEADER_BYTES, scan_framing
from station.recording.rrd_stream import BATCH_BYTES, RrdStream
from station.session import (
    JOINED_FILE,
    JOINING_FILE,
    RECORDING_FILE,
    SessionDescription,
    later_pieces,
    read_status,
    recording_pieces,
    write_status,
)

if TYPE_CHECKING:
    from station.recording.reader import Recording

# Chunks between two flushes: what is read but not yet written is kept in memory.
CHUNKS_AT_A_TIME = 64
# A 14 GB session takes minutes; each flush must come to its end within this, s.
FLUSH_S = 60.0
# Of the old files' bytes, what must be free for the new one.
ROOM = 1.02


def repair(folder: Path) -> tuple[str, ...]:
    """Repair and join the recording's files, unless a program still writes them; returns notices of what was done.

    Nothing is done, and nothing said, where all is well. What can't be repaired (a read-only folder, no room) stays as
    it is, with a notice.
    """
    if not _needs_repair(folder):
        return ()
    try:
        with SessionLock(folder) as lock:
            if not lock.exclusive:
                raise StationError("its file system has no locks, and who records there must not be disturbed")
            return join_pieces(folder)
    except SessionBusy:
        return ()
    except (OSError, StationError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error).splitlines()[0]
        return (f"the recording couldn't be repaired, and is read as it is: {reason}",)


def join_pieces(folder: Path) -> tuple[str, ...]:
    """As `repair`, for who has the folder's lock.

    Raises:
        OSError, StationError: it can't be done; all is as it was.
    """
    if not _needs_repair(folder):
        return ()
    pieces = [piece for piece in recording_pieces(folder) if has_rows(piece)]
    if pieces[0].name == JOINED_FILE:
        finish_joining(folder)
        return ()
    framings = [sound_framing(piece) for piece in pieces]
    for piece, framing in zip(pieces, framings, strict=True):
        if framing.torn and not framing.cut:
            raise StationError(
                f"{piece.name} is damaged from byte {framing.whole} on, not merely cut: nothing is removed"
            )
        if framing.torn and framing.size - framing.whole > BATCH_BYTES:
            left_mb = (framing.size - framing.whole) / 1e6
            raise StationError(
                f"{piece.name} has {left_mb:.0f} MB after its last whole message, more than a kill leaves"
            )
    with ExitStack() as cuts:
        for piece in pieces:
            cuts.enter_context(_cut(piece))
        _rebuild(pieces, folder / JOINED_FILE)
    _take_place(folder)
    of_pieces = [
        notice for piece, framing in zip(pieces, framings, strict=True) for notice in notices_on(piece, framing)
    ]
    return tuple(f"{notice}; it was repaired" for notice in of_pieces)


def finish_joining(folder: Path) -> None:
    """Let a joined file take its place, where the last repair was interrupted after its work was done.

    Before a piece is added: all that are there are taken for parts of the joined file.
    """
    if (folder / JOINED_FILE).exists():
        _take_place(folder)


def cut_torn_end(path: Path) -> None:
    """Leave out what follows the file's last whole message; nothing is done where a kill can't explain it.

    Raises:
        OSError: the file can't be written.
        InvalidFile: it can't be read.
    """
    framing = sound_framing(path)
    if framing.messages and framing.torn and framing.cut and framing.size - framing.whole <= BATCH_BYTES:
        os.truncate(path, framing.whole)


def correct_status(folder: Path, recording: Recording) -> None:
    """Have session.json say that a session, which a kill left as "recording", was interrupted, and what it has.

    Nothing is done while a program records, or where the folder can't be written.
    """
    with suppress(InvalidFile, OSError, StationError):
        if read_status(folder).state != "recording":
            return
        with SessionLock(folder) as lock:
            status = read_status(folder)
            if status.state == "recording" and lock.exclusive:
                ended = status.started + timedelta(seconds=recording.duration_s)
                counts = {**status.counts, **recording.counts}
                write_status(folder, replace(status, state="interrupted", ended=ended, counts=counts))


def _needs_repair(folder: Path) -> bool:
    pieces = [piece for piece in recording_pieces(folder) if has_rows(piece)]
    if not pieces:
        return False
    return len(pieces) > 1 or pieces[0].name == JOINED_FILE or not scan_framing(pieces[0]).complete


@contextmanager
def _cut(path: Path) -> Iterator[None]:
    """The file without its torn end; put on again if what is done with it fails."""
    framing = sound_framing(path)
    with path.open("rb") as file:
        file.seek(framing.whole)
        end = file.read(BATCH_BYTES) if framing.torn else b""
    try:
        cut_torn_end(path)
        yield
    except BaseException:
        if path.stat().st_size == framing.whole < framing.size:
            with path.open("ab") as file:
                file.write(end)
        raise


def _rebuild(pieces: Sequence[Path], target: Path) -> None:
    """Write all that is in the pieces into one file with an index."""
    part = target.with_name(JOINING_FILE)
    part.unlink(missing_ok=True)  # of a repair that was killed: it may be what takes the room
    _check_room(pieces, target.parent)
    recording_id, _, about = read_piece(pieces[0], _description)[0]
    try:
        stream = RrdStream(part, recording_id, 0, blueprint=session_blueprint(about.joints), send_properties=False)
        try:
            sent = sum(_send(stream, piece) for piece in pieces)
        finally:
            stream.end()
        if not (framing := scan_framing(part)).complete or framing.messages <= sent:
            raise StationError(f"{part} can't be written: {sent} chunks were, {framing.messages} messages are there")
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def _send(stream: RrdStream, piece: Path) -> int:
    """Write the piece's chunks into the stream; returns how many there were."""
    sent = 0
    with open_piece(piece) as chunks:
        each = iter(chunks)
        while some := list(islice(each, CHUNKS_AT_A_TIME)):
            stream.raw.send_chunks(some)
            stream.flush(FLUSH_S)
            sent += len(some)
    return sent


def _description(stream: LazyChunkStream) -> tuple[str, int, SessionDescription]:
    batches: list[pa.RecordBatch] = [chunk.to_record_batch() for chunk in stream.filter(content=PROPERTY_ENTITY)]
    return read_description(batches)


def _check_room(pieces: Sequence[Path], folder: Path) -> None:
    want, have = ROOM * sum(piece.stat().st_size for piece in pieces), shutil.disk_usage(folder).free
    if want > have:
        raise StationError(f"{want / 1e6:.0f} MB are needed for that on its disk, {have / 1e6:.0f} MB are free")


def _take_place(folder: Path) -> None:
    """The joined file becomes the recording; the pieces that are in it go."""
    for piece in later_pieces(folder):
        if has_rows(piece) or piece.stat().st_size <= HEADER_BYTES:
            piece.unlink()
    (folder / JOINED_FILE).replace(folder / RECORDING_FILE)
