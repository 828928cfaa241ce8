"""Writes a session's recording: commands, read-back, servos, frames, markers and events, each at its stamp.

Keeps the folder true at every moment: session.json, the lock that keeps others out, the pieces of a session that was
gone on with.
"""

from __future__ import annotations

import threading
import time
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.safety import ServoState
from station.errors import OutputExists, StationError
from station.perception.observations import FrameMarkers
from station.recording.earlier import Earlier, read_earlier
from station.recording.lock import SessionLock
from station.recording.lossless import LosslessFrames, check_kind
from station.recording.reader import Recording
from station.recording.repair import join_pieces
from station.recording.rrd_stream import FLUSH_TIMEOUT_S, RrdStream, check_rerun, written
from station.recording.session_rows import SessionRows
from station.session import (
    MOTION_FILE,
    NEXT_MOTION_FILE,
    RIG_FILE,
    STATUS_FILE,
    Checkpoint,
    SessionDescription,
    SessionStart,
    SessionStatus,
    clear_session,
    drop_reserve,
    frames_file,
    lossless_files,
    motion_sha256,
    piece_file,
    recording_pieces,
    reserve_status,
    stage_motion,
    take_staged_motion,
    write_status,
)

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

NS_PER_S = 1e9
COUNTED = ("frames", "commands", "readings", "events")
# A file's index is in memory until the file is finished: a capture goes on in another one each so many seconds.
PIECE_S = 120.0
# Of these those that are rows of the recording; commands are counted by who sends them, if anybody does.
ROWS = ("frames", "readings", "events")


class RecordingWriter:
    """Writes one session's recording.rrd and keeps its session.json true.

    Makes the folder, copies rig.toml and motion.toml, writes session.json with state "recording", then the description;
    from there on a kill loses at most what was logged in the last second. All times are ns on one monotonic clock. May
    be called from several threads. Leaving a `with` block without `close` closes it as interrupted.

    Args:
        folder: the session's folder; made if it isn't there.
        description: what the session is of.
        start_ns: the session's start on the clock of the stamps; logs count their seconds from there.
        blueprint: the viewer's layout, kept in the file.
        force: replace an earlier session in the folder, its fit and its report.
        frames: how images are kept: "jpeg", "none", or "ffv1", which loses nothing and needs the extra `lossless`.
        earlier: what `resume` goes on with.

    Raises:
        OutputExists: the folder has a recording, and `force` isn't given.
        SessionBusy: another program records into the folder.
        StationError: RERUN=off in the environment, the file can't be written.
    """

    def __init__(
        self,
        folder: Path,
        description: SessionDescription,
        *,
        start_ns: int,
        blueprint: Blueprint | None = None,
        force: bool = False,
        frames: str = "jpeg",
        earlier: Earlier | None = None,
    ) -> None:
        self._folder, self._about, self._earlier = folder, description, earlier
        self._first_piece = self._piece = earlier.piece if earlier else 0
        self._blueprint = blueprint
        self._turning = threading.Lock()
        self._start_ns = start_ns
        self._counts: Counter[str] = Counter(dict.fromkeys(COUNTED, 0))
        self._last_frame_ns: int | None = None
        self._closed = False
        self._rows = SessionRows(description)
        check_rerun()
        check_kind(frames)
        self._frames = frames
        self._video: LosslessFrames | None = None
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = earlier.lock if earlier else SessionLock(folder)
        try:
            self._status = self._gone_on(earlier) if earlier else self._begun(force)
            self._write_status()
            self._open()
        except BaseException:
            self._lock.release()
            raise

    @classmethod
    def resume(
        cls,
        folder: Path,
        *,
        now_ns: int,
        since_last_s: float | None = None,
        blueprint: Blueprint | None = None,
        frames: str | None = None,
    ) -> RecordingWriter:
        """Go on in a session that was interrupted or killed: the same recording, clock and frame numbers go on.

        Stamps are on this program's own clock; they are shifted to the session's.

        Args:
            now_ns: what this program's clock says now.
            since_last_s: how long ago the last row was recorded; by the wall clock if None. The session's clock goes on
                by that, and never backwards.
            frames: how images are kept; as they were if None.

        Raises:
            SessionBusy: another program records into the folder.
            StationError: the session is complete, or can't be written.
            InvalidFile: there is no session, or it can't be read.
        """
        earlier = read_earlier(folder, since_last_s)
        return cls(
            folder,
            earlier.description,
            start_ns=now_ns - round(earlier.elapsed_s * NS_PER_S),
            blueprint=blueprint,
            frames=frames or earlier.status.images or ("ffv1" if lossless_files(folder) else "jpeg"),
            earlier=earlier,
        )

    @property
    def recording_id(self) -> str:
        """Names the recording in the viewer and in session.json."""
        return self._status.recording_id

    @property
    def description(self) -> SessionDescription:
        """What the session is of."""
        return self._about

    @property
    def start_ns(self) -> int:
        """The session's start on the clock of the stamps that are logged now."""
        return self._start_ns

    @property
    def progress(self) -> Checkpoint | None:
        """The last checkpoint, also one of the program that was gone on with."""
        return self._status.progress

    def log_command(self, t_ns: int, q: ArrayLike) -> None:
        """Log the joint states (J,) that were commanded (rad or m), at the stamp of sending."""
        self._check_open()
        self._rows.command(t_ns, q)
        self._counts["commands"] += 1

    def log_reading(
        self, t_request_ns: int, t_reply_ns: int, q: ArrayLike, t_joint_ns: ArrayLike | None = None
    ) -> None:
        """Log the joint states (J,) that the servos reported (rad or m), with the stamps of request and reply.

        t_joint_ns (J,) are the joints' own stamps where they were asked one after the other; the midpoint if None.
        """
        self._check_open()
        self._rows.reading(t_request_ns, t_reply_ns, q, t_joint_ns)
        self._counts["readings"] += 1

    def log_servos(self, t_ns: int, states: Mapping[int, ServoState]) -> None:
        """Log what the servos said of themselves, by id; a servo of the first call that is missing now is NaN."""
        self._check_open()
        self._rows.servos(t_ns, states)

    def log_live_states(
        self, t_ns: int, q: ArrayLike, std: ArrayLike, columns: Sequence[str], units: Sequence[str]
    ) -> None:
        """Log the joint states (C,) that were detected in a frame while it is recorded, at the frame's stamp.

        Args:
            t_ns: the frame's stamp.
            q: in rad or m, as the tree tells them; NaN unseen.
            std: (C,) standard deviations.
            columns, units: names of the states, the same each time, and their units.
        """
        self._check_open()
        self._rows.live_states(t_ns, q, std, columns, units)

    def log_event(self, t_ns: int, level: str, text: str) -> None:
        """Log something that happened; level is INFO, WARN or ERROR."""
        self._check_open()
        self._rows.event(t_ns, level, text)
        self._counts["events"] += 1

    def log_frame(self, index: int, t_ns: int, image: bytes | NDArray[np.uint8] | None, markers: FrameMarkers) -> None:
        """Log one frame and the markers detected in it.

        Args:
            index: the camera's number of the frame, increasing; dropped frames leave gaps.
            t_ns: stamp of its arrival, increasing; a frame whose stamp isn't later than the last one's is left out and
                counted.
            image: (H, W, 3) BGR or (H, W) grey, encoded here; or a JPEG's bytes; None leaves it out.
            markers: may be none.
        """
        self._check_open()
        if self._last_frame_ns is not None and t_ns <= self._last_frame_ns:
            self._counts["repeated_frames"] += 1
            return
        self._last_frame_ns = t_ns
        self._rows.frame(index, t_ns, image if self._frames == "jpeg" else None, markers)
        if self._frames == "ffv1" and image is not None:
            self._write_lossless(t_ns - self._start_ns, image)
        self._counts["frames"] += 1

    def flush(self, timeout_s: float = FLUSH_TIMEOUT_S) -> None:
        """Hand all that was logged to the operating system; raises StationError if it can't be written (disk full).

        A thread does so by itself twice a second.
        """
        if not self._closed:
            self._stream.flush(timeout_s)

    def checkpoint(
        self, leg: int, legs: int, counts: Mapping[str, int] | None = None, motion: str | None = None
    ) -> None:
        """Leg number `leg` (from 0) of `legs` begins: what was logged before is safe, and session.json says how far.

        Args:
            counts: so far, to add to those that are kept here: what a kill leaves of them in session.json.
            motion: the session's motion.toml from this leg on; after a kill it is the one that session.json means.
        """
        self._check_open()
        if motion is not None:
            with written(self._folder / NEXT_MOTION_FILE):
                stage_motion(self._folder, motion)
        self._stream.flush()
        self._stream.sync()
        self._status = replace(self._status, progress=Checkpoint(leg, legs), counts=self._total(counts))
        if motion is not None:
            self._status = replace(self._status, motion_sha256=motion_sha256(motion))
        self._write_status()
        if motion is not None:
            with written(self._folder / MOTION_FILE):
                take_staged_motion(self._folder)

    def close(self, state: str, counts: Mapping[str, int] | None = None) -> None:
        """Finish the file and session.json, with a state, "complete" or "interrupted", and counts to add; once.

        Raises StationError if what was logged can't all be written; session.json then says "interrupted".
        """
        if self._closed:
            return
        self._closed = True
        self._status = replace(self._status, state="interrupted", ended=datetime.now(UTC), counts=self._total(counts))
        try:
            failure = self._finished()
            if failure is None:
                self._status = replace(self._status, state=state)
            else:
                self._status = replace(self._status, counts=self._written_counts())
            self._leave(failure)
        finally:
            self._lock.release()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close("interrupted")
        except StationError:
            if error is None:  # else it may be what ended the session, or matters less than that
                raise

    def _begun(self, force: bool) -> SessionStatus:
        """The folder of a new session, and what its session.json says."""
        if (pieces := recording_pieces(self._folder)) and not force:
            raise OutputExists(f"{pieces[0]} exists and is kept\nrecord into another folder, or use --force")
        if force:
            clear_session(self._folder)
        for name, text in ((RIG_FILE, self._about.rig), (MOTION_FILE, self._about.motion)):
            if text is not None:
                (self._folder / name).write_text(text, encoding="utf-8")
        return SessionStatus(
            state="recording",
            recording_id=uuid.uuid4().hex,
            started=self._about.started,
            seed=self._about.seed,
            versions=self._about.versions,
            starts=(SessionStart(self._about.started, 0.0),),
            images=self._frames,
        )

    def _gone_on(self, earlier: Earlier) -> SessionStatus:
        now = SessionStart(datetime.now(UTC), earlier.elapsed_s)
        return replace(earlier.status, state="recording", ended=None, starts=(*earlier.status.starts, now))

    def _open(self) -> None:
        earlier = self._earlier
        self._piece_ends_s = time.monotonic() + PIECE_S
        self._stream = RrdStream(self._path, self.recording_id, self._start_ns, blueprint=self._blueprint)
        try:
            session_ns = earlier.start_ns if earlier else self._start_ns
            self._rows.begin(
                self._stream, session_ns, session_ns - self._start_ns, earlier.next_frame if earlier else 0
            )
            self._rows.describe(self._folder.resolve().name, self.recording_id)
            self._stream.flush()
            self._rows.scene()
            self._stream.flush()
            self._stream.start_timers()
        except BaseException:
            self._stream.end()
            raise

    def _written_counts(self) -> Mapping[str, int]:
        """The counts of a recording that failed: what is in its files, and how many frames are not."""
        counts = self._status.counts
        with suppress(StationError):
            written = Recording.read(self._folder).counts
            return {**counts, **written, "unwritten_frames": counts["frames"] - written["frames"]}
        return counts

    def _finished(self) -> StationError | None:
        """Finish the file and have the disk keep it; what failed, if anything did."""
        try:
            if self._video is not None:
                self._video.close()
            self._stream.flush()
            self._stream.end()
            self._stream.sync()
        except StationError as error:
            self._stream.end()
            return error
        return None

    def _write_lossless(self, elapsed_ns: int, image: bytes | NDArray[np.uint8]) -> None:
        from station.perception.jpeg import decode_jpeg

        if self._video is None:
            self._video = LosslessFrames(self._folder / frames_file(self._first_piece))
        self._video.write(elapsed_ns, decode_jpeg(image) if isinstance(image, bytes) else image)

    def _leave(self, failure: StationError | None) -> None:
        """Have session.json say what became of the session, and join its pieces; raises the first thing that failed."""
        try:
            self._write_status()
        except StationError as error:
            failure = failure or error
        drop_reserve(self._folder)
        if failure is not None:
            raise failure
        if self._piece:
            with suppress(OSError, StationError):  # whoever opens it next tries again, and is told
                join_pieces(self._folder)

    def _write_status(self) -> None:
        with written(self._folder / STATUS_FILE):
            write_status(self._folder, self._status)
        reserve_status(self._folder)

    def _total(self, counts: Mapping[str, int] | None) -> Mapping[str, int]:
        """The session's counts: this program's, and those of the ones before."""
        before = self._earlier.status.counts if self._earlier else {}
        # What was handed over to be recorded and failed in here is in others' counts, and not in the file.
        own = {**self._counts, **(counts or {}), **{name: self._counts[name] for name in ROWS}}
        return {name: before.get(name, 0) + own.get(name, 0) for name in {**before, **own}}

    def _check_open(self) -> None:
        if self._closed:
            raise StationError(f"{self._path} is closed; nothing more is logged")
        if time.monotonic() > self._piece_ends_s and self._turning.acquire(blocking=False):
            try:
                self._turn_over()
            finally:
                self._turning.release()

    @property
    def _path(self) -> Path:
        return self._folder / piece_file(self._piece)

    def _turn_over(self) -> None:
        """Go on in a further piece; `close` joins them."""
        self._piece += 1
        self._piece_ends_s = time.monotonic() + PIECE_S
        self._stream.go_on_in(self._path, self._blueprint)
