"""Logs as Parquet: a row a pose, a row a time of joint states, a row a marker; float64 to the last bit.

NaN is null. Units and the frame of the poses are in the file's metadata, under the keys `unit` and `reference`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from station.formats.joint_csv import STD_SUFFIX
from station.formats.poses_csv import POSITION, QUATERNION
from station.kinematics import se3
from station.logs import FloatArray, JointLog, PoseLog
from station.perception.observations import MARKER_SHAPES, ObservationLog


def write_poses(log: PoseLog, file: BinaryIO) -> None:
    """`t_s, part, x_m ... qz` and `covariance`, its 36 numbers row by row (null where unknown), a row a seen part."""
    rows, parts = np.nonzero(log.seen)
    xyz, wxyz = se3.to_xyz_wxyz(log.T_ref_part[rows, parts])
    columns: dict[str, pa.Array] = {"t_s": _floats(log.t_s[rows]), "part": pa.array(np.array(log.parts)[parts])}
    columns |= {name: _floats(xyz[:, i]) for i, name in enumerate(POSITION)}
    columns |= {name: _floats(wxyz[:, i]) for i, name in enumerate(QUATERNION)}
    if log.covariance is not None:
        columns["covariance"] = _lists(log.covariance[rows, parts])
    _write(columns, {"reference": log.reference}, file)


def write_states(log: JointLog, file: BinaryIO) -> None:
    """`t_s`, a column a joint and, where they are known, `<joint>_std`: the columns of joint_states.csv."""
    columns = {"t_s": _floats(log.t_s)} | {joint: _floats(log.q[:, j]) for j, joint in enumerate(log.joints)}
    if log.std is not None:
        columns |= {joint + STD_SUFFIX: _floats(log.std[:, j]) for j, joint in enumerate(log.joints)}
    _write(columns, {f"unit:{joint}": unit for joint, unit in zip(log.joints, log.units, strict=True)}, file)


def write_observations(log: ObservationLog, file: BinaryIO) -> None:
    """`t_s, frame` and what was seen of a marker, a row a marker of a frame; arrays as lists, row by row."""
    columns = {"t_s": _floats(log.t_s[log.frame]), "frame": pa.array(log.frame)}
    for name, shape in MARKER_SHAPES.items():
        values = getattr(log, name)
        columns[name] = _lists(values) if shape else pa.array(values)
    _write(columns, {name: str(list(shape)) for name, shape in MARKER_SHAPES.items() if shape}, file)


def _write(columns: Mapping[str, pa.Array], metadata: Mapping[str, str], file: BinaryIO) -> None:
    table = pa.table(dict(columns)).replace_schema_metadata(dict(metadata))
    pq.write_table(table, file)


def _floats(values: FloatArray) -> pa.Array:
    return pa.array(np.ascontiguousarray(values), from_pandas=True)


def _lists(values: FloatArray) -> pa.Array:
    """(N, ...) as N lists of all numbers of each."""
    count = len(values)
    flat = values.reshape(count, -1) if count else np.zeros((0, 1))
    return pa.FixedSizeListArray.from_arrays(_floats(flat.ravel()), flat.shape[1])
