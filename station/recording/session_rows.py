"""The rows of one piece of a recording: what is logged, as rerun's components, at times of the session's clock.

What a fit needs is kept as it was, in float64 and int64: joint states, corners, both pose solutions, stamps.
Transforms, meshes and lines beside them are for the viewer, which keeps float32.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from drivers.safety import ServoState
from station.errors import InvalidData
from station.formats.camera import parse_camera
from station.formats.markers import parse_markers
from station.logs import FloatArray
from station.perception.observations import MARKER_SHAPES, FrameMarkers
from station.recording import scene
from station.recording.layout import (
    COMMANDED,
    EVENTS,
    IMAGE,
    JOINT_STAMPS,
    LIVE_STATES,
    MEASURED,
    OBSERVATIONS,
    OVERLAY,
    PROPERTY,
    REPLY,
    REQUEST,
    SERVO_ID,
    SERVO_QUANTITIES,
    SERVOS,
    STATES_OF,
    STATES_STD,
    STATES_UNITS,
)
from station.recording.rrd_stream import RrdStream
from station.session import SESSION_SCHEMA, SessionDescription

EVENT_LEVELS = ("INFO", "WARN", "ERROR")


class SessionRows:
    """Logs a session's rows into a stream.

    Args:
        about: what the session is of.

    Raises:
        InvalidFile: the description's camera or markers can't be read.
    """

    def __init__(self, about: SessionDescription) -> None:
        self._about = about
        self._camera = parse_camera(about.camera, "camera.toml")
        self._markers = parse_markers(about.markers, "markers.toml")
        self._in_view = scene.MarkersInView(self._markers)
        self._servo_ids: tuple[int, ...] = ()
        self._states_of: tuple[str, ...] = ()

    def begin(self, stream: RrdStream, start_ns: int, shift_ns: int, first_frame: int) -> None:
        """Write into this stream from now on, whose stamps plus `shift_ns` are on the session's clock.

        Args:
            start_ns: the session's start on its clock.
            first_frame: what is added to the camera's numbers of the frames.
        """
        self._stream, self._start_ns, self._shift_ns, self._first_frame = stream, start_ns, shift_ns, first_frame

    def describe(self, name: str, recording_id: str) -> None:
        """The description, from which a reader knows a session's recording; `name` is what the viewer calls it."""
        columns = _description_columns(self._about, self._start_ns, recording_id)
        self._stream.raw.send_recording_name(name)
        self._stream.raw.send_property(PROPERTY, rr.AnyValues(**columns))

    def scene(self) -> None:
        """What doesn't change: the camera, the markers' frames, names and colours of the joints' series."""
        raw = self._stream.raw
        scene.log_camera(raw, self._camera)
        scene.log_marker_frames(raw, self._markers)
        for entity, values in self._in_view.begin():
            self._log(self._start_ns - self._shift_ns, entity, *values, frame=0)
        joints, units = self._about.joints, self._about.units
        if joints:
            raw.log(COMMANDED, scene.commanded_series(joints, units), static=True)
            raw.log(MEASURED, scene.measured_series(joints, units), static=True)

    def command(self, t_ns: int, q: ArrayLike) -> None:
        """As RecordingWriter.log_command."""
        states = _shape(q, (len(self._about.joints),), "a command")
        self._log(t_ns, COMMANDED, rr.Scalars(states))

    def reading(self, t_request_ns: int, t_reply_ns: int, q: ArrayLike, t_joint_ns: ArrayLike | None) -> None:
        """As RecordingWriter.log_reading."""
        states = _shape(q, (len(self._about.joints),), "a reading")
        middle_ns = (t_request_ns + t_reply_ns) // 2
        own_ns = np.full(len(states), middle_ns) if t_joint_ns is None else np.asarray(t_joint_ns, dtype=np.int64)
        stamps = {
            REQUEST: _integer(t_request_ns + self._shift_ns),
            REPLY: _integer(t_reply_ns + self._shift_ns),
            JOINT_STAMPS: pa.array(own_ns + self._shift_ns, pa.int64()),
        }
        self._log(middle_ns, MEASURED, rr.Scalars(states), rr.AnyValues(**stamps))

    def live_states(
        self, t_ns: int, q: ArrayLike, std: ArrayLike, columns: Sequence[str], units: Sequence[str]
    ) -> None:
        """As RecordingWriter.log_live_states."""
        if not self._states_of:
            self._states_of = tuple(columns)
            self._stream.raw.log(LIVE_STATES, scene.seen_series(columns, units), static=True)
        states, deviations = (_shape(values, (len(columns),), "seen joint states") for values in (q, std))
        told = {
            STATES_STD: pa.array(deviations),
            STATES_OF: pa.array([",".join(columns)]),
            STATES_UNITS: pa.array([",".join(units)]),
        }
        self._log(t_ns, LIVE_STATES, rr.Scalars(states), rr.AnyValues(**told))

    def servos(self, t_ns: int, states: Mapping[int, ServoState]) -> None:
        """As RecordingWriter.log_servos."""
        if not self._servo_ids:
            self._servo_ids = tuple(sorted(states))
            self._stream.raw.log(SERVOS, scene.servo_series(self._servo_ids), static=True)
        if strangers := states.keys() - set(self._servo_ids):
            raise InvalidData(f"servos {sorted(strangers)} are new; the session's are {list(self._servo_ids)}")
        values = [
            getattr(states[n], quantity) if n in states else np.nan
            for quantity in SERVO_QUANTITIES
            for n in self._servo_ids
        ]
        ids = rr.AnyValues(**{SERVO_ID: pa.array(self._servo_ids, pa.int64())})
        self._log(t_ns, SERVOS, rr.Scalars(values), ids)

    def event(self, t_ns: int, level: str, text: str) -> None:
        """As RecordingWriter.log_event."""
        if level not in EVENT_LEVELS:
            raise InvalidData(f"no event level '{level}'; want one of {', '.join(EVENT_LEVELS)}")
        self._log(t_ns, EVENTS, rr.TextLog(text, level=level))

    def frame(self, index: int, t_ns: int, image: bytes | NDArray[np.uint8] | None, markers: FrameMarkers) -> None:
        """As RecordingWriter.log_frame."""
        number = index + self._first_frame
        columns = {name: pa.array(getattr(markers, name).ravel()) for name in MARKER_SHAPES}
        observed = rr.AnyValues(count=_integer(len(markers)), **columns)
        self._log(t_ns, OBSERVATIONS, observed, frame=number)
        if image is not None:
            jpeg = rr.EncodedImage(contents=_encoded(image), media_type="image/jpeg")
            self._log(t_ns, IMAGE, jpeg, frame=number)
        self._log(t_ns, OVERLAY, *scene.outlines(self._markers, markers), frame=number)
        for entity, values in self._in_view.show(markers):
            self._log(t_ns, entity, *values, frame=number)

    def _log(self, t_ns: int, entity: str, *values: rr.AsComponents, frame: int | None = None) -> None:
        self._stream.log(t_ns, entity, *values, frame=frame)


def _integer(value: int) -> pa.Array:
    return pa.array([int(value)], pa.int64())


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
