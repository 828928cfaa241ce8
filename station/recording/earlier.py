"""What was recorded of a session before it was interrupted, as far as going on with it needs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from station.errors import StationError
from station.recording.lock import SessionLock
from station.recording.reader import Recording
from station.recording.repair import cut_torn_end, finish_joining
from station.session import SessionDescription, SessionStatus, next_piece, read_status, recording_pieces

# At least between the last row that was recorded and the first one after it, whatever the wall clock says, s.
LEAST_GAP_S = 1e-3


@dataclass(frozen=True, eq=False)
class Earlier:
    """An interrupted session.

    Attributes:
        status: what its session.json says.
        description: what it is of.
        start_ns: its start on its own clock.
        elapsed_s: what its clock says now, seconds since its start.
        next_frame: number of the frame after the last one.
        piece: number of the file to go on in.
        lock: keeps other programs out of its folder.
    """

    status: SessionStatus
    description: SessionDescription
    start_ns: int
    elapsed_s: float
    next_frame: int
    piece: int
    lock: SessionLock


def read_earlier(folder: Path, since_last_s: float | None) -> Earlier:
    """What is in the folder, with a lock on it.

    Args:
        since_last_s: how long ago the last row was recorded; by the wall clock if None.

    Raises:
        SessionBusy: another program records into the folder.
        StationError: the session is complete.
        InvalidFile: there is no session, or it can't be read.
    """
    read_status(folder)  # is there one?
    lock = SessionLock(folder)
    try:
        status = read_status(folder)
        if status.state == "complete":
            raise StationError(f"{folder} is complete; there is nothing to go on with\nrecord into another folder")
        finish_joining(folder)
        for piece in recording_pieces(folder):
            cut_torn_end(piece)  # or it would be copied to be read
        recording = Recording.read(folder)
        if status.state == "recording":  # a kill left it so: what was counted last is older than what is in the file
            status = replace(status, counts={**status.counts, **recording.counts})
        return Earlier(
            status=status,
            description=recording.description,
            start_ns=recording.start_ns,
            elapsed_s=_elapsed_s(status, recording.duration_s, since_last_s),
            next_frame=int(recording.frame_index.max(initial=-1)) + 1,
            piece=next_piece(folder),
            lock=lock,
        )
    except BaseException:
        lock.release()
        raise


def _elapsed_s(status: SessionStatus, last_s: float, since_last_s: float | None) -> float:
    """What the session's clock says now: later than all that was recorded, whatever became of the wall clock."""
    by_wall_s = (datetime.now(UTC) - status.started).total_seconds()
    return max(by_wall_s if since_last_s is None else last_s + since_last_s, last_s + LEAST_GAP_S)
