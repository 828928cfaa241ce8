"""Reads a session's recording: joint states, observations and events at once, frames only when they are asked for."""

from __future__ import annotations

import json
import tempfile
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rerun.chunk import LazyChunkStream, RrdReader
from rerun.error_utils import RerunWarning

from station.errors import InvalidData, InvalidFile
from station.logs import FloatArray, JointLog
from station.perception.observations import MARKER_SHAPES, ObservationLog
from station.recording.layout import (
    BLOB,
    COMMANDED,
    ELAPSED,
    EVENTS,
    FRAME,
    IMAGE,
    JOINT_STAMPS,
    LEVEL,
    MEASURED,
    OBSERVATIONS,
    PROPERTY_ENTITY,
    REPLY,
    REQUEST,
    SCALARS,
    TEXT,
)
from station.recording.rrd_files import Framing, Rows, copy_whole, scan_framing
from station.session import RECORDING_FILE, SESSION_SCHEMA, SessionDescription

IntArray = NDArray[np.int64]
T = TypeVar("T")
Batches = Mapping[str, Sequence[pa.RecordBatch]]

NS_PER_S = 1e9
# float64 holds every whole number below this.
EXACT_NS = 1 << 53
READ_SCHEMAS = (SESSION_SCHEMA,)


@dataclass(frozen=True)
class Event:
    """Something that happened, `t_s` after the session's start; level is INFO, WARN or ERROR."""

    t_s: float
    level: str
    text: str


@dataclass(frozen=True, eq=False)
class Recording:
    """What was recorded in a session; times are seconds since its start, on its own clock.

    Attributes:
        path: the .rrd.
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
        notices: what was wrong with the file and how it was read nevertheless.
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
    notices: tuple[str, ...] = field(default=())

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read a session folder or an .rrd; frames are not read.

        A recording that was not closed, or was cut, is read up to its last whole message, with a notice.

        Raises:
            InvalidFile: missing, empty, damaged, no session's recording, or of a schema that isn't read.
        """
        path = path / RECORDING_FILE if path.is_dir() else path
        if not path.is_file():
            raise InvalidFile(f"{path} is missing; a session folder has its recording there")
        return _read(path, lambda stream, notices: _assembled(path, _batches(stream), notices))

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.frame_ns)

    def frame_jpeg(self, row: int) -> bytes:
        """The JPEG of the frame in this row of `observations.t_s`.

        Raises:
            InvalidData: no such row.
            InvalidFile: the recording lost that image.
        """
        if not 0 <= row < self.frames:
            raise InvalidData(f"{self.path} has no frame {row}; its {self.frames} frames count from 0")
        elapsed_ns = int(self.frame_ns[row]) - self.start_ns
        jpeg = _read(self.path, lambda stream, _: _find_image(stream, elapsed_ns))
        if jpeg is None:
            raise InvalidFile(f"{self.path} has no image of frame {row}; its markers are there")
        return jpeg

    def frame_jpegs(self) -> Iterator[tuple[int, bytes]]:
        """Each frame that is kept, in order: nanoseconds since the session's start, and its JPEG.

        Raises:
            InvalidFile: the file is damaged.
        """
        framing = scan_framing(self.path)
        with _rerun_errors(self.path), _readable(self.path, framing) as source:
            yield from _images(_stream(source, framing))

    def frame_image(self, row: int) -> NDArray[np.uint8]:
        """The frame in this row of `observations.t_s`, decoded: (H, W, 3) BGR."""
        import cv2

        image = cv2.imdecode(np.frombuffer(self.frame_jpeg(row), np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise InvalidFile(f"{self.path}: the image of frame {row} can't be decoded")
        return np.asarray(image, np.uint8)


def _read(path: Path, read: Callable[[LazyChunkStream, tuple[str, ...]], T]) -> T:
    """What `read` makes of the file's chunks and the notices on it; without the index if that is damaged."""
    framing = scan_framing(path)
    try:
        return _read_framed(path, framing, _notices(path, framing), read)
    except InvalidFile:
        if not framing.complete:
            raise
    notice = f"{path.name} was read without its index, which is damaged"
    return _read_framed(path, framing.without_index(), (notice,), read)


def _read_framed(
    path: Path, framing: Framing, notices: tuple[str, ...], read: Callable[[LazyChunkStream, tuple[str, ...]], T]
) -> T:
    with _rerun_errors(path), _readable(path, framing) as source:
        return read(_stream(source, framing), notices)


@contextmanager
def _rerun_errors(path: Path) -> Iterator[None]:
    """Whatever rerun or Arrow raise on a damaged file, a panic included, becomes InvalidFile."""
    try:
        yield
    except InvalidFile as error:
        raise error if str(path) in str(error) else InvalidFile(f"{path}: {error}") from error
    except InvalidData as error:
        raise InvalidFile(f"{path} is damaged: {error}") from error
    except BaseException as error:
        # rerun's panics derive from BaseException, like an interrupt, which must pass.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InvalidFile(f"{path} is damaged and can't be read: {reason:.200}\nrestore it or record again") from error


@contextmanager
def _readable(path: Path, framing: Framing) -> Iterator[Path]:
    """The file itself, or for as long as it is read a copy without its torn end."""
    if not framing.messages:
        raise InvalidFile(f"{path} was cut before anything was recorded in it; nothing can be read")
    if not framing.torn:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="station-") as folder:
        target = Path(folder) / path.name
        copy_whole(path, framing.whole, target)
        yield target


def _stream(source: Path, framing: Framing) -> LazyChunkStream:
    """All chunks; of a complete file, only those that are asked for are read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RerunWarning)  # that there is no index; the framing has told us
        reader = RrdReader(source)
    return reader.store().stream() if framing.complete else reader.stream()


def _find_image(stream: LazyChunkStream, elapsed_ns: int) -> bytes | None:
    for chunk in stream.filter(content=f"/{IMAGE}", is_static=False, components=BLOB):
        batch = chunk.to_record_batch()
        hits = np.flatnonzero(batch.column(ELAPSED).cast(pa.int64()).to_numpy() == elapsed_ns)
        if hits.size:
            return _blob(batch.column(BLOB)[int(hits[0])])
    return None


def _images(stream: LazyChunkStream) -> Iterator[tuple[int, bytes]]:
    """Time since the start (ns) and JPEG of each frame, as the chunks have them: in the order of writing."""
    for chunk in stream.filter(content=f"/{IMAGE}", is_static=False, components=BLOB):
        batch = chunk.to_record_batch()
        times = batch.column(ELAPSED).cast(pa.int64()).to_pylist()
        for row, elapsed_ns in enumerate(times):
            yield elapsed_ns, _blob(batch.column(BLOB)[row])


def _batches(stream: LazyChunkStream) -> Batches:
    """The rows that a fit needs, by entity; static rows only of the description."""
    paths = [PROPERTY_ENTITY, *(f"/{entity}" for entity in (COMMANDED, MEASURED, OBSERVATIONS, EVENTS))]
    batches: dict[str, list[pa.RecordBatch]] = defaultdict(list)
    for chunk in stream.filter(content=paths):
        if chunk.is_static == (chunk.entity_path == PROPERTY_ENTITY):
            batches[chunk.entity_path.lstrip("/")].append(chunk.to_record_batch())
    return batches


def _assembled(path: Path, batches: Batches, notices: tuple[str, ...]) -> Recording:
    recording_id, start_ns, description = _description(batches.get(PROPERTY_ENTITY.lstrip("/"), ()))
    joints, units = description.joints, description.units
    commanded = Rows(batches.get(COMMANDED, ()), ELAPSED, [SCALARS])
    measured = Rows(batches.get(MEASURED, ()), ELAPSED, [SCALARS, REQUEST, REPLY, JOINT_STAMPS])
    rows = batches.get(OBSERVATIONS, ())
    present = {name for batch in rows for name in batch.schema.names}
    columns = [name for name in MARKER_SHAPES if name in present or name not in ADDED]
    observed = Rows(rows, ELAPSED, [FRAME, "count", *columns])
    stamps_ns = _stamps(measured)
    keep = _last_of_equal(stamps_ns.sum(axis=1))
    read_s = _seconds((stamps_ns[keep] - start_ns).sum(axis=1)) / 2
    sent = _last_of_equal(commanded.times)
    return Recording(
        path=path,
        recording_id=recording_id,
        description=description,
        start_ns=start_ns,
        commanded=JointLog(_seconds(commanded.times[sent]), joints, _states(commanded, len(joints))[sent], units),
        measured=JointLog(read_s, joints, _at_one_time(measured, len(joints), start_ns, keep, read_s), units),
        stamps_ns=stamps_ns[keep],
        observations=_observations(observed, columns),
        frame_index=observed.index(FRAME),
        frame_ns=observed.times + start_ns,
        events=_events(batches.get(EVENTS, ())),
        notices=notices,
    )


# Recordings made before 0.1.0 lack these; their values are NaN then.
ADDED = ("corner_covariance_px2",)


def _seconds(nanoseconds: IntArray) -> FloatArray:
    """Seconds to the last digit, also since 1970: beyond 2^53 ns, whole seconds and the rest are converted apart."""
    whole, rest = np.divmod(nanoseconds, int(NS_PER_S))
    exact = np.abs(nanoseconds) < EXACT_NS
    return np.where(exact, nanoseconds / NS_PER_S, whole + rest / NS_PER_S)


def _description(batches: Sequence[pa.RecordBatch]) -> tuple[str, int, SessionDescription]:
    columns: dict[str, list[Any]] = {}
    for batch in batches:
        for name in batch.schema.names:
            if pa.types.is_list(batch.column(name).type):
                columns[name] = batch.column(name)[0].as_py() or []
    if "schema" not in columns:
        raise InvalidFile("it has no session's description: made by another program, or cut at its start")
    have = columns["schema"][0]
    if have not in READ_SCHEMAS:
        raise InvalidFile(f"its schema is '{have}'; this station reads {', '.join(READ_SCHEMAS)}")

    def one(name: str) -> Any:
        return columns[name][0] if columns.get(name) else None

    about = SessionDescription(
        camera=one("camera"),
        markers=one("markers"),
        joints=tuple(columns["joints"]),
        units=tuple(columns["units"]),
        rig=one("rig"),
        motion=one("motion"),
        started=datetime.fromisoformat(one("started")),
        seed=one("seed"),
        versions=json.loads(one("versions")),
    )
    return one("recording_id"), int(one("start_ns")), about


def _states(rows: Rows, joints: int) -> FloatArray:
    """(T, J) joint states; each row has one value a joint."""
    return rows.floats(SCALARS, np.ones(len(rows), np.int64), (joints,))


def _stamps(rows: Rows) -> IntArray:
    ones = np.ones(len(rows), np.int64)
    return np.stack([rows.integers(REQUEST, ones), rows.integers(REPLY, ones)], axis=1)


def _at_one_time(rows: Rows, joints: int, start_ns: int, keep: NDArray[np.bool_], read_s: FloatArray) -> FloatArray:
    """(T, J) states at the rows' times, interpolated between each joint's own stamps.

    Servos without a group read are asked one after the other, some milliseconds apart.
    """
    states = _states(rows, joints)[keep]
    own_s = _seconds(rows.integers(JOINT_STAMPS, np.full(len(rows), 1), (joints,))[keep] - start_ns)
    if not len(read_s):
        return states
    interpolated = np.stack([np.interp(read_s, own_s[:, j], states[:, j]) for j in range(joints)], axis=1)
    as_read = np.abs(own_s - read_s[:, None]) < 1 / NS_PER_S  # a midpoint may lie between two nanoseconds
    return np.where(as_read, states, interpolated)


def _last_of_equal(times: IntArray) -> NDArray[np.bool_]:
    """Whether each row is the last of those at its time: what was logged last is what counts."""
    return np.append(np.diff(times) > 0, True)[: len(times)]


def _observations(rows: Rows, present: Sequence[str]) -> ObservationLog:
    counts = rows.integers("count", np.ones(len(rows), np.int64))
    total = int(counts.sum())
    columns = {name: np.full((total, *shape), np.nan) for name, shape in MARKER_SHAPES.items()}
    for name in present:
        read = rows.integers if name == "marker_id" else rows.floats
        columns[name] = read(name, counts, MARKER_SHAPES[name])
    return ObservationLog(_seconds(rows.times), np.repeat(np.arange(len(rows)), counts), **columns)


def _events(batches: Sequence[pa.RecordBatch]) -> tuple[Event, ...]:
    rows = Rows(batches, ELAPSED, [LEVEL, TEXT])
    triples = zip(_seconds(rows.times).tolist(), rows.texts(LEVEL), rows.texts(TEXT), strict=True)
    return tuple(Event(t_s, level, text) for t_s, level, text in triples)


def _notices(path: Path, framing: Framing) -> tuple[str, ...]:
    if framing.complete:
        return ()
    if not framing.torn:
        return (f"{path.name} was not closed: what was logged after its last flush is lost",)
    return (f"{path.name} was cut: read up to its last whole message, {framing.size - framing.whole} bytes left out",)


def _blob(cell: Any) -> bytes:
    """The bytes of one image: a list of one list of bytes, however Arrow keeps them."""
    value = cell.values[0]
    return value.as_py() if isinstance(value, pa.BinaryScalar) else value.values.to_numpy().tobytes()
