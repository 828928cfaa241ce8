"""What the rows of a recording say: joint states, observations, servos, events, and the session's description."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from station.errors import InvalidFile
from station.logs import FloatArray, JointLog
from station.perception.observations import MARKER_SHAPES, ObservationLog
from station.recording.layout import (
    ELAPSED,
    JOINT_STAMPS,
    LEVEL,
    REPLY,
    REQUEST,
    SCALARS,
    SERVO_ID,
    SERVO_QUANTITIES,
    STATES_OF,
    STATES_STD,
    STATES_UNITS,
    TEXT,
)
from station.recording.rows import Rows
from station.session import SESSION_SCHEMA, SessionDescription

IntArray = NDArray[np.int64]

NS_PER_S = 1e9
# float64 holds every whole number below this.
EXACT_NS = 1 << 53
READ_SCHEMAS = (SESSION_SCHEMA,)
# Recordings made before 0.1.0 lack these; their values are NaN then.
ADDED = ("corner_covariance_px2",)


@dataclass(frozen=True)
class Event:
    """Something that happened, `t_s` after the session's start; level is INFO, WARN or ERROR."""

    t_s: float
    level: str
    text: str


@dataclass(frozen=True, eq=False)
class ServoLog:
    """What the servos said of themselves, in the order of time; arrays are read-only, NaN where one said nothing.

    Attributes:
        t_s: (T,) seconds since the session's start.
        ids: S servos.
        temperature_c: (T, S).
        voltage_v: (T, S).
        load: (T, S) torque or current as a share of the most that the model has, with its sign.
        speed_rad_s: (T, S) of the shaft.
    """

    t_s: FloatArray
    ids: tuple[int, ...]
    temperature_c: FloatArray
    voltage_v: FloatArray
    load: FloatArray
    speed_rad_s: FloatArray


def seconds(nanoseconds: IntArray) -> FloatArray:
    """Seconds to the last digit, also since 1970: beyond 2^53 ns, whole seconds and the rest are converted apart."""
    whole, rest = np.divmod(nanoseconds, int(NS_PER_S))
    exact = np.abs(nanoseconds) < EXACT_NS
    return np.where(exact, nanoseconds / NS_PER_S, whole + rest / NS_PER_S)


def read_description(batches: Sequence[pa.RecordBatch]) -> tuple[str, int, SessionDescription]:
    """Recording id, the session's start on its clock (ns), and what it is of; InvalidFile for another schema."""
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


def joint_states(rows: Rows, joints: int) -> FloatArray:
    """(T, J) joint states; each row has one value a joint."""
    return rows.floats(SCALARS, np.ones(len(rows), np.int64), (joints,))


def read_stamps(rows: Rows) -> IntArray:
    """(T, 2) request and reply of each reading, ns on the session's clock."""
    ones = np.ones(len(rows), np.int64)
    return np.stack([rows.integers(REQUEST, ones), rows.integers(REPLY, ones)], axis=1)


def states_at_one_time(
    rows: Rows, joints: int, start_ns: int, keep: NDArray[np.bool_], read_s: FloatArray
) -> FloatArray:
    """(T, J) states at the rows' times, interpolated between each joint's own stamps.

    Servos without a group read are asked one after the other, some milliseconds apart.
    """
    states = joint_states(rows, joints)[keep]
    own_s = seconds(rows.integers(JOINT_STAMPS, np.full(len(rows), 1), (joints,))[keep] - start_ns)
    if not len(read_s):
        return states
    interpolated = np.stack([np.interp(read_s, own_s[:, j], states[:, j]) for j in range(joints)], axis=1)
    as_read = np.abs(own_s - read_s[:, None]) < 1 / NS_PER_S  # a midpoint may lie between two nanoseconds
    return np.where(as_read, states, interpolated)


def last_of_equal(times: IntArray) -> NDArray[np.bool_]:
    """Whether each row is the last of those at its time: what was logged last is what counts."""
    return np.append(np.diff(times) > 0, True)[: len(times)]


def read_observations(rows: Rows, present: Sequence[str], keep: NDArray[np.bool_]) -> ObservationLog:
    """The markers of the frames to `keep` (T,); columns that aren't `present` are NaN."""
    counts = rows.integers("count", np.ones(len(rows), np.int64))
    kept = np.repeat(keep, counts)
    columns = {}
    for name, shape in MARKER_SHAPES.items():
        read = rows.integers if name == "marker_id" else rows.floats
        missing = name not in present
        column = np.full((int(counts.sum()), *shape), np.nan) if missing else read(name, counts, shape)
        columns[name] = column if kept.all() else column[kept]
    return ObservationLog(seconds(rows.times[keep]), np.repeat(np.arange(keep.sum()), counts[keep]), **columns)


def read_events(batches: Sequence[pa.RecordBatch]) -> tuple[Event, ...]:
    """The events, in the order of time."""
    rows = Rows(batches, ELAPSED, [LEVEL, TEXT])
    triples = zip(seconds(rows.times).tolist(), rows.texts(LEVEL), rows.texts(TEXT), strict=True)
    return tuple(Event(t_s, level, text) for t_s, level, text in triples)


def read_live_states(batches: Sequence[pa.RecordBatch]) -> JointLog:
    """States that were detected while it was recorded; those by another tree than the last one are left out."""
    rows = Rows(batches, ELAPSED, [SCALARS, STATES_STD, STATES_OF, STATES_UNITS])
    if not len(rows):
        return JointLog(np.zeros(0), (), np.zeros((0, 0)), ())
    of = rows.texts(STATES_OF)
    columns, units = (tuple(text.split(",")) for text in (of[-1], rows.texts(STATES_UNITS)[-1]))
    counts = rows.lengths(SCALARS)
    kept = np.array([text == of[-1] for text in of]) & last_of_equal(rows.times)
    q, std = (
        rows.floats(name, counts)[np.repeat(kept, counts)].reshape(-1, len(columns)) for name in (SCALARS, STATES_STD)
    )
    return JointLog(seconds(rows.times[kept]), columns, q, units, std)


def read_servos(batches: Sequence[pa.RecordBatch]) -> ServoLog:
    """From the rows of the servos; a program that went on with the session may have had others."""
    rows = Rows(batches, ELAPSED, [SCALARS, SERVO_ID])
    counts = rows.lengths(SERVO_ID)
    ids, column = np.unique(rows.integers(SERVO_ID, counts), return_inverse=True)
    values = rows.floats(SCALARS, counts, (len(SERVO_QUANTITIES),)).ravel()
    row = np.repeat(np.arange(len(rows)), counts)
    within = np.arange(len(row)) - (np.cumsum(counts) - counts)[row]  # place of the servo in its row
    first = len(SERVO_QUANTITIES) * (np.cumsum(counts) - counts)[row] + within
    tables = {}
    for k, quantity in enumerate(SERVO_QUANTITIES):
        tables[quantity] = np.full((len(rows), len(ids)), np.nan)
        tables[quantity][row, column] = values[first + k * counts[row]]
        tables[quantity].setflags(write=False)
    t_s = seconds(rows.times)
    t_s.setflags(write=False)
    return ServoLog(t_s, tuple(ids.tolist()), **tables)
