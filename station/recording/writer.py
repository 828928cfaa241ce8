"""Writes a session's recording: commands, read-back, frames, markers and events, each at its stamp.

What a fit needs is kept as it was, in float64 and int64: joint states, corners, both pose solutions, stamps.
Transforms, meshes and lines beside them are for the viewer, which keeps float32.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import ArrayLike, NDArray
from rerun_bindings import flush_and_cleanup_orphaned_recordings

from station.errors import InvalidData, OutputExists, StationError
from station.formats.camera import parse_camera
from station.formats.markers import parse_markers
from station.logs import FloatArray
from station.perception.observations import MARKER_SHAPES, FrameMarkers
from station.recording import scene
from station.recording.layout import (
    APPLICATION,
    COMMANDED,
    ELAPSED,
    EVENTS,
    FRAME,
    IMAGE,
    JOINT_STAMPS,
    MEASURED,
    OBSERVATIONS,
    OVERLAY,
    PROPERTY,
    REPLY,
    REQUEST,
    TRANSFORMS,
)
from station.session import (
    MOTION_FILE,
    RECORDING_FILE,
    RIG_FILE,
    SESSION_SCHEMA,
    SessionDescription,
    SessionStatus,
    clear_session,
    write_status,
)

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

EVENT_LEVELS = ("INFO", "WARN", "ERROR")
# Between two flushes, s of the wall clock: a kill loses at most this much.
FLUSH_PERIOD_S = 1.0
# A flush that takes longer means that the disk or the viewer takes nothing any more, s.
FLUSH_TIMEOUT_S = 5.0
# Waiting for the end of a file that could not be written, s.
END_TIMEOUT_S = 2.0
# rerun's batcher writes an entity when it has this much, and all of them at each tick. Were images alone to reach the
# limit before each tick, nothing else would ever be written; hence far more than a tick's worth of images.
BATCH_BYTES = 64 << 20
BATCH_TICK_S = 0.5
SERVER_MEMORY = "256MiB"


def _check_port(port: int) -> None:
    """Raise StationError unless the port is free: rerun would say so only at each flush, without naming it."""
    with socket.socket() as probe:
        # As rerun's own server does; otherwise a port stays taken for a minute after the last session.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise StationError(f"port {port} of the live view can't be used: {error.strerror}; name another") from error


@contextmanager
def written(path: Path) -> Iterator[None]:
    """rerun's errors on writing, whose type goes by their cause, become StationError with the file's name."""
    try:
        yield
    except StationError:
        raise
    except Exception as error:
        free_mb = shutil.disk_usage(path.parent).free / 1e6
        raise StationError(f"{path} can't be written: {error}\n{free_mb:.1f} MB are free on its disk") from error


def open_stream(recording_id: str) -> rr.RecordingStream:
    """A stream of this recording in rerun's strict mode; raises StationError where RERUN=off disables it."""
    if os.environ.get("RERUN", "on").lower() in ("off", "0", "false"):
        raise StationError("RERUN=off is set in the environment, so nothing would be recorded; unset RERUN")
    rr.set_strict_mode(True)  # otherwise bad data is dropped with a warning
    batching = rr.ChunkBatcherConfig(flush_tick=BATCH_TICK_S, flush_num_bytes=BATCH_BYTES)
    stream = rr.RecordingStream(APPLICATION, recording_id=recording_id, batcher_config=batching)
    if not rr.is_enabled(stream):
        raise StationError("rerun is disabled, so nothing would be recorded; look for RERUN in the environment")
    return stream


def forget_ended_streams() -> None:
    """End the threads of streams that nothing refers to any more: rerun keeps two for each until it is told to."""
    flush_and_cleanup_orphaned_recordings()


def _shape(values: ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InvalidData(f"{what} has shape {array.shape}; want {shape}")
    return array


def _encoded(image: bytes | NDArray[np.uint8]) -> bytes:
    """The JPEG of a BGR (H, W, 3) or grey (H, W) image; bytes are a JPEG already."""
    if isinstance(image, bytes):
        return image
    from station.perception.jpeg import encode_jpeg

    return encode_jpeg(image)


class RecordingWriter:
    """Writes one session's recording.rrd and keeps its session.json true.

    Makes the folder, copies rig.toml and motion.toml, writes session.json with state "recording", then the description;
    from there on a kill loses at most what was logged in the last second. All times are ns on the session's clock. May
    be called from several threads. Leaving a `with` block without `close` closes it as interrupted.

    Args:
        folder: the session's folder; made if it isn't there.
        description: what the session is of.
        start_ns: the session's start on its clock; logs count their seconds from there.
        blueprint: the viewer's layout, kept in the file.
        viewer_port: serve a live view on this port of 127.0.0.1.
        force: replace an earlier session in the folder, its fit and its report.

    Raises:
        OutputExists: the folder has a recording, and `force` isn't given.
        StationError: RERUN=off in the environment, the port is taken, the file can't be written.
    """

    def __init__(
        self,
        folder: Path,
        description: SessionDescription,
        *,
        start_ns: int,
        blueprint: Blueprint | None = None,
        viewer_port: int | None = None,
        force: bool = False,
    ) -> None:
        self._folder = folder
        self._path = folder / RECORDING_FILE
        self._about = description
        self._camera = parse_camera(description.camera, "camera.toml")
        self._markers = parse_markers(description.markers, "markers.toml")
        self._shapes = scene.marker_shapes(self._markers)
        self._shown: set[int] = set()
        self._start_ns = start_ns
        self._counts = dict.fromkeys(("frames", "commands", "readings", "events"), 0)
        self._closed = False
        self._failure: StationError | None = None
        if self._path.exists() and not force:
            raise OutputExists(f"{self._path} exists and is kept\nrecord into another folder, or use --force")
        if viewer_port is not None:
            _check_port(viewer_port)
        self._stream = open_stream(uuid.uuid4().hex)
        self._status = SessionStatus(
            state="recording",
            recording_id=self._stream.get_recording_id(),
            started=description.started,
            seed=description.seed,
            versions=description.versions,
        )
        try:
            self._write_folder(force)
            self._open_file(blueprint, viewer_port)
        except BaseException:
            self._end_stream()
            raise

    @property
    def recording_id(self) -> str:
        """Names the recording in the viewer and in session.json."""
        return self._status.recording_id

    def log_command(self, t_ns: int, q: ArrayLike) -> None:
        """Log the joint states (J,) that were commanded (rad or m), at the stamp of sending."""
        states = _shape(q, (len(self._about.joints),), "a command")
        self._log(t_ns, COMMANDED, rr.Scalars(states))
        self._counts["commands"] += 1

    def log_reading(
        self, t_request_ns: int, t_reply_ns: int, q: ArrayLike, t_joint_ns: ArrayLike | None = None
    ) -> None:
        """Log the joint states (J,) that the servos reported (rad or m), with the stamps of request and reply.

        t_joint_ns (J,) are the joints' own stamps where they were asked one after the other; the midpoint if None.
        """
        states = _shape(q, (len(self._about.joints),), "a reading")
        middle_ns = (t_request_ns + t_reply_ns) // 2
        own_ns = np.full(len(states), middle_ns) if t_joint_ns is None else np.asarray(t_joint_ns, dtype=np.int64)
        stamps = {
            REQUEST: _integer(t_request_ns),
            REPLY: _integer(t_reply_ns),
            JOINT_STAMPS: pa.array(own_ns, pa.int64()),
        }
        self._log(middle_ns, MEASURED, rr.Scalars(states), rr.AnyValues(**stamps))
        self._counts["readings"] += 1

    def log_event(self, t_ns: int, level: str, text: str) -> None:
        """Log something that happened; level is INFO, WARN or ERROR."""
        if level not in EVENT_LEVELS:
            raise InvalidData(f"no event level '{level}'; want one of {', '.join(EVENT_LEVELS)}")
        self._log(t_ns, EVENTS, rr.TextLog(text, level=level))
        self._counts["events"] += 1

    def log_frame(self, index: int, t_ns: int, image: bytes | NDArray[np.uint8] | None, markers: FrameMarkers) -> None:
        """Log one frame and the markers detected in it.

        Args:
            index: the camera's number of the frame, increasing; dropped frames leave gaps.
            t_ns: stamp of its arrival, increasing.
            image: (H, W, 3) BGR or (H, W) grey, encoded here; or a JPEG's bytes; None leaves it out.
            markers: may be none.
        """
        columns = {name: pa.array(getattr(markers, name).ravel()) for name in MARKER_SHAPES}
        observed = rr.AnyValues(count=_integer(len(markers)), **columns)
        self._log(t_ns, OBSERVATIONS, observed, frame=index)
        if image is not None:
            jpeg = rr.EncodedImage(contents=_encoded(image), media_type="image/jpeg")
            self._log(t_ns, IMAGE, jpeg, frame=index)
        self._log(t_ns, OVERLAY, *scene.outlines(self._markers, markers), frame=index)
        self._log_poses(t_ns, index, dict(zip(markers.marker_id.tolist(), markers.T_cam_marker[:, 0], strict=True)))
        self._counts["frames"] += 1

    def flush(self, timeout_s: float = FLUSH_TIMEOUT_S) -> None:
        """Hand all that was logged to the operating system; raises StationError if it can't be written (disk full).

        Logging does so by itself each second of the wall clock.
        """
        if self._closed:
            return
        if self._failure is not None:  # rerun doesn't recover, and would make us wait again
            raise self._failure
        self._flushed_s = time.monotonic()
        try:
            with written(self._path):
                self._stream.flush(timeout_sec=timeout_s)
        except StationError as error:
            self._failure = error
            raise

    def close(self, state: str, counts: Mapping[str, int] | None = None) -> None:
        """Finish the file and session.json, with a state, "complete" or "interrupted", and counts to add; once.

        Raises StationError if what was logged can't all be written; session.json then says "interrupted".
        """
        if self._closed:
            return
        merged = {**self._counts, **(counts or {})}
        status = replace(self._status, state=state, ended=datetime.now(UTC), counts=merged)
        try:
            self.flush()
        finally:
            self._closed = True
            if self._failure is not None:
                status = replace(status, state="interrupted")
            self._end_stream()
            with written(self._path):
                _sync(self._path)
                write_status(self._folder, status)

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

    def _end_stream(self) -> None:
        """Finish the file, and serve no viewer any more.

        For a file that failed rerun may wait here for ever, and once more when the program ends: then a thread waits in
        our place, which keeps the stream, and rerun is not asked to finish anything at the end.
        """
        ending = threading.Thread(target=self._stream.disconnect, name="rerun disconnect", daemon=True)
        ending.start()
        ending.join(END_TIMEOUT_S if self._failure is not None else None)
        del self._stream
        if ending.is_alive():
            rr.unregister_shutdown()
        else:
            forget_ended_streams()

    def _write_folder(self, force: bool) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        if force:
            clear_session(self._folder)
        for name, text in ((RIG_FILE, self._about.rig), (MOTION_FILE, self._about.motion)):
            if text is not None:
                (self._folder / name).write_text(text, encoding="utf-8")
        write_status(self._folder, self._status)

    def _open_file(self, blueprint: Blueprint | None, viewer_port: int | None) -> None:
        sinks: list[Any] = [rr.FileSink(self._path)]
        if viewer_port is not None:
            sinks.append(rr.GrpcServerSink("127.0.0.1", viewer_port, server_memory_limit=SERVER_MEMORY))
        self._stream.set_sinks(*sinks, default_blueprint=blueprint)
        self._stream.send_recording_name(self._folder.resolve().name)
        self._stream.send_property(
            PROPERTY, rr.AnyValues(**_description_columns(self._about, self._start_ns, self.recording_id))
        )
        self.flush()
        self._log_scene()
        self.flush()

    def _log_scene(self) -> None:
        scene.log_camera(self._stream, self._camera)
        scene.log_marker_frames(self._stream, self._markers)
        for n in self._shapes:  # the viewer reports a frame without a pose as an error, though nothing is drawn in it
            self._log(self._start_ns, TRANSFORMS, scene.marker_pose(n, np.eye(4)), frame=0)
        joints, units = self._about.joints, self._about.units
        if joints:
            self._stream.log(COMMANDED, scene.commanded_series(joints, units), static=True)
            self._stream.log(MEASURED, scene.measured_series(joints, units), static=True)

    def _log(self, t_ns: int, entity: str, *values: rr.AsComponents, frame: int | None = None) -> None:
        if self._closed:
            raise StationError(f"{self._path} is closed; nothing more is logged")
        if time.monotonic() - self._flushed_s > FLUSH_PERIOD_S:
            self.flush()
        self._stream.reset_time()  # times are kept for each thread; `frame` must not stick to what follows
        self._stream.set_time(ELAPSED, duration=np.timedelta64(int(t_ns) - self._start_ns, "ns"))
        if frame is not None:
            self._stream.set_time(FRAME, sequence=int(frame))
        self._stream.log(entity, *values)

    def _log_poses(self, t_ns: int, index: int, T_cam_marker: Mapping[int, FloatArray]) -> None:
        """Show the table's markers where they are; those that are no longer seen disappear."""
        known = self._shapes.keys()
        seen = {n: T for n, T in T_cam_marker.items() if n in known and np.isfinite(T).all()}
        for n in self._shown - seen.keys():
            self._log(t_ns, scene.marker_entity(n), rr.Clear(recursive=False), frame=index)
        for n in seen.keys() - self._shown:
            self._log(t_ns, scene.marker_entity(n), *self._shapes[n], frame=index)
        # A call a marker: a row of this entity is the pose of one child frame.
        for n, T in seen.items():
            self._log(t_ns, TRANSFORMS, scene.marker_pose(n, T), frame=index)
        self._shown = set(seen)


def _integer(value: int) -> pa.Array:
    return pa.array([int(value)], pa.int64())


def _sync(path: Path) -> None:
    """Have the disk keep it before session.json calls it complete."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _description_columns(about: SessionDescription, start_ns: int, recording_id: str) -> dict[str, Any]:
    columns = {
        "schema": SESSION_SCHEMA,
        "recording_id": recording_id,
        "rig": about.rig,
        "motion": about.motion,
        "camera": about.camera,
        "markers": about.markers,
        "joints": pa.array(about.joints, pa.string()),
        "units": pa.array(about.units, pa.string()),
        "started": about.started.isoformat(),
        "start_ns": _integer(start_ns),
        "seed": None if about.seed is None else _integer(about.seed),
        "versions": json.dumps(dict(about.versions), sort_keys=True),
    }
    return {name: value for name, value in columns.items() if value is not None}
