"""Reads a session's recording: joint states, observations and events at once, frames only when they are asked for."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rerun.chunk import LazyChunkStream

from station.errors import InvalidData, InvalidFile
from station.logs import JointLog
from station.perception.observations import MARKER_SHAPES, ObservationLog
from station.recording.contents import (
    ADDED,
    NS_PER_S,
    Event,
    IntArray,
    ServoLog,
    joint_states,
    last_of_equal,
    read_description,
    read_events,
    read_live_states,
    read_observations,
    read_servos,
    read_stamps,
    seconds,
    states_at_one_time,
)
from station.recording.images import find_image, images
from station.recording.layout import (
    COMMANDED,
    ELAPSED,
    EVENTS,
    FRAME,
    JOINT_STAMPS,
    LIVE_STATES,
    MEASURED,
    OBSERVATIONS,
    PROPERTY_ENTITY,
    REPLY,
    REQUEST,
    SCALARS,
    SERVOS,
)
from station.recording.lossless import find_lossless
from station.recording.opening import errors_of, has_rows, open_piece, read_piece
from station.recording.repair import correct_status, repair
from station.recording.rows import Rows
from station.recording.thinning import Thinning
from station.session import RECORDING_FILE, SessionDescription, lossless_files, recording_pieces

READ = (COMMANDED, MEASURED, LIVE_STATES, SERVOS, OBSERVATIONS, EVENTS)
Batches = Mapping[str, Sequence[pa.RecordBatch]]


@dataclass(frozen=True, eq=False)
class Recording:
    """What was recorded in a session; times are seconds since its start, on its own clock.

    Attributes:
        path: the .rrd, the first one where there are several pieces.
        recording_id: names it in the viewer.
        description: the texts of rig, motion, camera and markers, and what else was known at the start.
        start_ns: the session's start on its clock.
        commanded: (T, J) states at the stamps of sending.
        measured: (T, J) states that the servos reported, at the midpoints of request and reply; joints that were read
            at times of their own are interpolated to them.
        stamps_ns: (T, 2) request and reply of each row of `measured`, on the session's clock.
        observations: the markers of each frame.
        frame_index: (F,) the camera's number of each row of `observations.t_s`; dropped frames leave gaps.
        frame_ns: (F,) stamps of the frames on the session's clock.
        events: in the order of their times.
        servos: what the servos said of themselves; without rows in sessions made before 0.2.0.
        live_states: what was detected while it was recorded, at the frames' times, by a tree that was known; without
            columns where none was.
        frames_left_out: how many are recorded and were left out in reading, of a long session.
        pieces: the files that were read: several of a session that was gone on with and isn't closed.
        notices: what was wrong with the files and how they were read nevertheless.
    """

    path: Path
    recording_id: str
    description: SessionDescription
    start_ns: int
    commanded: JointLog
    measured: JointLog
    stamps_ns: IntArray
    observations: ObservationLog
    frame_index: IntArray
    frame_ns: IntArray
    events: tuple[Event, ...]
    servos: ServoLog
    live_states: JointLog
    pieces: tuple[Path, ...]
    notices: tuple[str, ...] = field(default=())
    frames_left_out: int = 0

    @classmethod
    def load(cls, path: Path, *, most_markers: int | None = None) -> Recording:
        """Read a session folder or an .rrd; pictures are not read.

        A recording that was not closed, or was cut, is read up to its last whole message, with a notice. In a session
        folder it is repaired, unless a program still records there, and session.json is corrected.

        Args:
            most_markers: of all frames; of a longer session only every second, fourth, ... frame is read, with a
                notice, so that memory doesn't grow with its length. All frames are read if None.

        Raises:
            InvalidFile: missing, empty, damaged, no session's recording, or of a schema that isn't read.
        """
        repaired = repair(path) if path.is_dir() else ()
        recording = cls.read(path, repaired, most_markers=most_markers)
        if path.is_dir():
            correct_status(path, recording)
        return recording

    @classmethod
    def read(cls, path: Path, notices: Sequence[str] = (), *, most_markers: int | None = None) -> Recording:
        """As `load`, but nothing is repaired; `notices` are put before those of reading.

        Where another program repairs the files meanwhile, they are read once more.
        """
        while True:
            files = _files(path)
            try:
                recording = cls._read_once(path, notices, most_markers)
            except InvalidFile:
                if _files(path) == files:
                    raise
                continue
            if _files(path) == files:
                return recording

    @classmethod
    def _read_once(cls, path: Path, notices: Sequence[str], most_markers: int | None) -> Recording:
        pieces = recording_pieces(path) if path.is_dir() else [path] if path.is_file() else []
        if not pieces:
            path = path / RECORDING_FILE if path.is_dir() else path
            raise InvalidFile(f"{path} is missing; a session folder has its recording there")
        first, *later = pieces
        pieces = [first, *filter(has_rows, later)]
        thinning = Thinning(most_markers)
        read = [read_piece(piece, partial(_batches, piece=piece, thinning=thinning)) for piece in pieces]
        of_pieces = [notice for _, of_piece in read for notice in of_piece]
        with errors_of(first):
            together = {**_together([batches for batches, _ in read]), OBSERVATIONS: thinning.rows}
            whole = _assembled(pieces, together, (*notices, *of_pieces, *thinning.notices))
        return replace(whole, frames_left_out=thinning.left_out)

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.frame_ns)

    @property
    def duration_s(self) -> float:
        """Time of the last row of anything, seconds since the session's start; 0 where there is none."""
        read_s = (self.stamps_ns[:, 1] - self.start_ns) / NS_PER_S
        times = (self.commanded.t_s, read_s, self.observations.t_s, self.servos.t_s, [e.t_s for e in self.events])
        return float(max(np.max(t_s, initial=0.0) for t_s in times))

    @property
    def counts(self) -> dict[str, int]:
        """How many rows there are of what session.json counts."""
        return {
            "frames": self.frames + self.frames_left_out,
            "commands": len(self.commanded.t_s),
            "readings": len(self.measured.t_s),
            "events": len(self.events),
        }

    def frame_jpeg(self, row: int) -> bytes:
        """The JPEG of the frame in this row of `observations.t_s`.

        Raises:
            InvalidData: no such row.
            InvalidFile: the recording lost that image.
        """
        if not 0 <= row < self.frames:
            raise InvalidData(f"{self.path} has no frame {row}; its {self.frames} frames count from 0")
        elapsed_ns = int(self.frame_ns[row]) - self.start_ns
        for piece in self.pieces:
            jpeg, _ = read_piece(piece, lambda stream: find_image(stream, elapsed_ns))
            if jpeg is not None:
                return jpeg
        raise InvalidFile(f"{self.path} has no image of frame {row}; its markers are there")

    def frame_jpegs(self) -> Iterator[tuple[int, bytes]]:
        """Each frame that is kept, in order: nanoseconds since the session's start, and its JPEG.

        Raises:
            InvalidFile: the file is damaged.
        """
        for piece in self.pieces:
            with open_piece(piece) as stream:
                yield from images(stream)

    def frame_image(self, row: int) -> NDArray[np.uint8]:
        """The frame in this row of `observations.t_s`, decoded: (H, W, 3) BGR; without loss where it is kept so."""
        videos = lossless_files(self.path.parent)
        if videos and 0 <= row < self.frames:
            image = find_lossless(videos, int(self.frame_ns[row]) - self.start_ns)
            if image is not None:
                return image
        from station.perception.jpeg import decode_jpeg

        try:
            return decode_jpeg(self.frame_jpeg(row))
        except InvalidData as error:
            raise InvalidFile(f"{self.path}: the image of frame {row}: {error}") from error


def _files(path: Path) -> list[tuple[str, int]]:
    """Which files are read: another one in a name's place is another file."""
    return [(piece.name, piece.stat().st_ino) for piece in recording_pieces(path)] if path.is_dir() else []


def _batches(stream: LazyChunkStream, *, piece: Path, thinning: Thinning) -> Batches:
    """The rows that a fit needs, by entity; static ones of the description only. Those of frames go to `thinning`."""
    thinning.begin(piece)
    paths = [PROPERTY_ENTITY, *(f"/{entity}" for entity in READ)]
    batches: dict[str, list[pa.RecordBatch]] = defaultdict(list)
    for chunk in stream.filter(content=paths):
        if chunk.is_static == (chunk.entity_path == PROPERTY_ENTITY):
            entity, batch = chunk.entity_path.lstrip("/"), chunk.to_record_batch()
            if entity == OBSERVATIONS:
                thinning.take(piece, batch)
            else:
                batches[entity].append(batch)
    return batches


def _together(pieces: Sequence[Batches]) -> Batches:
    """The rows of all pieces, by entity."""
    entities = {entity for piece in pieces for entity in piece}
    return {entity: [batch for piece in pieces for batch in piece.get(entity, ())] for entity in entities}


def _assembled(pieces: Sequence[Path], batches: Batches, notices: tuple[str, ...]) -> Recording:
    recording_id, start_ns, about = read_description(batches.get(PROPERTY_ENTITY.lstrip("/"), ()))
    joints, units = about.joints, about.units
    commanded = Rows(batches.get(COMMANDED, ()), ELAPSED, [SCALARS])
    measured = Rows(batches.get(MEASURED, ()), ELAPSED, [SCALARS, REQUEST, REPLY, JOINT_STAMPS])
    rows = batches.get(OBSERVATIONS, ())
    present = {name for batch in rows for name in batch.schema.names}
    columns = [name for name in MARKER_SHAPES if name in present or name not in ADDED]
    observed = Rows(rows, ELAPSED, [FRAME, "count", *columns])
    seen = np.diff(observed.times, prepend=-np.inf) > 0
    if repeated := int(np.sum(~seen)):
        notices = (*notices, f"{repeated} frames were left out that have the stamp of another one")
    stamps_ns = read_stamps(measured)
    keep = last_of_equal(stamps_ns.sum(axis=1))
    read_s = seconds((stamps_ns[keep] - start_ns).sum(axis=1)) / 2
    sent = last_of_equal(commanded.times)
    return Recording(
        path=pieces[0],
        recording_id=recording_id,
        description=about,
        start_ns=start_ns,
        commanded=JointLog(seconds(commanded.times[sent]), joints, joint_states(commanded, len(joints))[sent], units),
        measured=JointLog(read_s, joints, states_at_one_time(measured, len(joints), start_ns, keep, read_s), units),
        stamps_ns=stamps_ns[keep],
        observations=read_observations(observed, columns, seen),
        frame_index=observed.index(FRAME)[seen],
        frame_ns=observed.times[seen] + start_ns,
        events=read_events(batches.get(EVENTS, ())),
        servos=read_servos(batches.get(SERVOS, ())),
        live_states=read_live_states(batches.get(LIVE_STATES, ())),
        pieces=tuple(pieces),
        notices=notices,
    )
