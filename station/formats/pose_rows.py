"""Tables with a pose a row to PoseLogs: quaternions checked, names slugged, rows sorted into times and parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

import numpy as np

from station.errors import InvalidFile
from station.formats.table import Table
from station.kinematics import se3
from station.logs import FARTHEST_M, SLUG, FloatArray, PoseLog

# Quaternions in files are rounded; a length off by more than this is no rotation but a fault, or another column order.
QUATERNION_TOLERANCE = 1e-3


def slug_of_file(name: str) -> str:
    """Part named by a file's stem: lower case, `_` for other characters, `track_` before anything but a letter."""
    stem = re.sub(r"[^a-z0-9_]", "_", PurePath(name).stem.lower())
    return stem if SLUG.fullmatch(stem) else f"track_{stem}"


def read_positions(table: Table, columns: Sequence[str]) -> FloatArray:
    """(N, 3) of three columns, none blank, none beyond `FARTHEST_M`; raises InvalidFile with the row."""
    positions = np.stack([table.filled_floats(column) for column in columns], axis=-1)
    far = np.argwhere(np.abs(positions) > FARTHEST_M)
    if len(far):
        i, axis = (int(index) for index in far[0])
        raise table.refusal(i, f"{columns[axis]} is {positions[i, axis]:g}; want metres, {FARTHEST_M:g} at most")
    return positions


def read_quaternions(table: Table, columns: Sequence[str]) -> FloatArray:
    """(N, 4) unit quaternions w x y z of four columns, in the order of `columns`; NaN where all four are blank.

    A length off 1 by at most `QUATERNION_TOLERANCE` is normalised.

    Raises:
        InvalidFile: with the row, for another length and for one to three blanks.
    """
    wxyz = np.stack([table.floats(column) for column in columns], axis=-1)
    blanks = np.isnan(wxyz).sum(axis=-1)
    torn = np.flatnonzero((blanks > 0) & (blanks < 4))
    if torn.size:
        raise table.refusal(int(torn[0]), "part of the quaternion is blank; want four numbers, or none (position only)")
    length = np.linalg.norm(np.clip(wxyz, -FARTHEST_M, FARTHEST_M), axis=-1)  # clipped, so that nothing overflows
    off = np.flatnonzero(np.abs(length - 1) > QUATERNION_TOLERANCE)
    if off.size:
        i = int(off[0])
        raise table.refusal(i, f"quaternion of length {length[i]:.6g}; want 1 within {QUATERNION_TOLERANCE:g}")
    return wxyz / length[:, None]


def poses_of(positions: FloatArray, wxyz: FloatArray) -> FloatArray:
    """(N, 4, 4) poses of positions (N, 3) in metres and quaternions (N, 4); identity rotation where one is NaN."""
    return se3.from_xyz_wxyz(positions, np.where(np.isnan(wxyz), (1.0, 0.0, 0.0, 0.0), wxyz))


def diagonal_covariance(variance_m2: FloatArray, variance_rad2: FloatArray) -> FloatArray:
    """(..., 6, 6) covariance with the same variance (...,) for each axis; infinite = not observed, NaN = unknown."""
    diagonal = np.stack([variance_m2] * 3 + [variance_rad2] * 3, axis=-1)
    covariance = np.zeros((*diagonal.shape, 6))
    covariance[..., np.arange(6), np.arange(6)] = diagonal
    return covariance


def pose_log_of_rows(
    table: Table,
    t_s: FloatArray,
    parts: Sequence[str],
    T_ref_part: FloatArray,
    covariance: FloatArray | None,
    reference: str,
) -> PoseLog:
    """PoseLog of rows that each tell one part's pose at one time; parts in the order of their first rows.

    Args:
        table: where the rows came from, for errors.
        t_s: (N,) seconds that never fall.
        parts: N names.
        T_ref_part: (N, 4, 4).
        covariance: (N, 6, 6), or None if unknown.
        reference: the frame that the poses are in.

    Raises:
        InvalidFile: with the row, for a name that is no slug and for a part twice at one time.
    """
    names = tuple(dict.fromkeys(parts))
    for name in names:
        if not SLUG.fullmatch(name):
            raise table.refusal(list(parts).index(name), f"'{name}' is no part's name; names match [a-z][a-z0-9_]*")
    index = {name: k for k, name in enumerate(names)}
    k = np.array([index[name] for name in parts])
    is_new = np.concatenate([[True], t_s[1:] > t_s[:-1]])
    row = np.cumsum(is_new) - 1
    _check_no_part_twice(table, row * len(names) + k, t_s, parts)
    shape = (int(row[-1]) + 1, len(names))
    poses = np.full((*shape, 4, 4), np.nan)
    poses[row, k] = T_ref_part
    if covariance is None:
        return PoseLog(t_s[is_new], reference, names, poses)
    covariances = np.full((*shape, 6, 6), np.nan)
    covariances[row, k] = covariance
    return PoseLog(t_s[is_new], reference, names, poses, covariances)


def _check_no_part_twice(table: Table, key: np.ndarray, t_s: FloatArray, parts: Sequence[str]) -> None:
    """Raise InvalidFile for the first row whose key, (time, part) as one number, was there before."""
    order = np.argsort(key, kind="stable")
    again = order[1:][np.diff(key[order]) == 0]
    if again.size:
        i = int(again.min())
        raise table.refusal(i, f"part '{parts[i]}' is there twice at t = {t_s[i]:.15g} s; want one pose a time")


def on_common_times(logs: Sequence[PoseLog], name: str) -> PoseLog:
    """One PoseLog of several on the union of their times; a part is NaN at the times that its own log lacks.

    Args:
        logs: logs in one reference, without covariances.
        name: what the logs came from, for errors.

    Raises:
        InvalidFile: for a part that is in two logs.
    """
    parts = [part for log in logs for part in log.parts]
    if len(set(parts)) != len(parts):
        twice = sorted({part for part in parts if parts.count(part) > 1})
        raise InvalidFile(f"{name}: more than one file names the part {', '.join(twice)}; rename the files")
    t_s = np.unique(np.concatenate([log.t_s for log in logs]))
    columns = [np.full((len(t_s), len(log.parts), 4, 4), np.nan) for log in logs]
    for column, log in zip(columns, logs, strict=True):
        column[np.searchsorted(t_s, log.t_s)] = log.T_ref_part
    return PoseLog(t_s, logs[0].reference, tuple(parts), np.concatenate(columns, axis=1))
