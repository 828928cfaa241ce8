"""poses.csv: `t_s,part,x_m,y_m,z_m,qw,qx,qy,qz`, a row a seen part, optionally with `std_m,std_rad`.

A position without a rotation has blank quaternion cells: in the PoseLog its rotation is the identity with infinite
variance. A standard deviation that isn't given is NaN in the PoseLog's covariance, which says unknown; a log in which
every rotation is told and no standard deviation has no covariance at all.
"""

from __future__ import annotations

import csv
import io
import math

import numpy as np

from station.errors import InvalidFile
from station.formats.pose_rows import (
    diagonal_covariance,
    pose_log_of_rows,
    poses_of,
    read_positions,
    read_quaternions,
)
from station.formats.table import Table, parse_csv
from station.kinematics import se3
from station.logs import FARTHEST_M, SHARPEST, FloatArray, PoseLog

POSITION = ("x_m", "y_m", "z_m")
QUATERNION = ("qw", "qx", "qy", "qz")
COLUMNS = ("t_s", "part", *POSITION, *QUATERNION)
STD_COLUMNS = ("std_m", "std_rad")


def parse_poses_csv(text: str, name: str, *, reference: str = "world") -> PoseLog:
    """Read the text of a poses.csv; its columns may come in any order.

    Args:
        text: the file's text.
        name: the file's name, for errors.
        reference: the frame that the poses are in; the file doesn't say.

    Returns:
        A log with parts in the order of their first rows; its covariance has the same variance for each axis.

    Raises:
        InvalidFile: for missing and unknown columns and, with the row, NaN, falling times, a part twice at one time, a
            quaternion off unit length by more than 1e-3, names that are no slugs, deviations that aren't positive.
    """
    table = parse_csv(text, name)
    _check_columns(table)
    t_s = table.times("t_s", repeats=True)
    wxyz = read_quaternions(table, QUATERNION)
    T_ref_part = poses_of(read_positions(table, POSITION), wxyz)
    covariance = _covariance(table, np.isnan(wxyz[:, 0]))
    return pose_log_of_rows(table, t_s, table.columns["part"], T_ref_part, covariance, reference)


def format_poses_csv(log: PoseLog) -> str:
    """Text of a poses.csv, with standard deviations if the log has a covariance that is known anywhere.

    A deviation is the root of the mean variance of its three axes: directions and correlations are lost, and so is the
    name of the reference. Times at which no part was seen have no row.
    """
    rows, parts = np.nonzero(log.seen)
    xyz, wxyz = se3.to_xyz_wxyz(log.T_ref_part[rows, parts])
    std = _deviations(log, rows, parts)
    quaternions = _cells(wxyz)
    for i in np.flatnonzero(np.isinf(std[:, 1])):
        quaternions[int(i)] = [""] * 4
    with_std = bool(np.isfinite(std).any())
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow((*COLUMNS, *STD_COLUMNS) if with_std else COLUMNS)
    heads = [[repr(float(log.t_s[row])), log.parts[part]] for row, part in zip(rows, parts, strict=True)]
    tails = _cells(std) if with_std else [[]] * len(heads)
    for cells in zip(heads, _cells(xyz), quaternions, tails, strict=True):
        writer.writerow([cell for group in cells for cell in group])
    return out.getvalue()


def _check_columns(table: Table) -> None:
    missing = [column for column in COLUMNS if column not in table.columns]
    if missing:
        raise InvalidFile(f"{table.name}: no column {', '.join(missing)}; want {','.join(COLUMNS)}")
    unknown = [column for column in table.columns if column not in (*COLUMNS, *STD_COLUMNS)]
    if unknown:
        raise InvalidFile(
            f"{table.name}: unknown column {', '.join(unknown)}; want {','.join(COLUMNS)} "
            f"and, if they are known, {','.join(STD_COLUMNS)}"
        )
    if len(set(STD_COLUMNS) & set(table.columns)) == 1:
        raise InvalidFile(f"{table.name}: want both of the columns {' and '.join(STD_COLUMNS)}, or neither")


def _covariance(table: Table, position_only: np.ndarray) -> FloatArray | None:
    """(N, 6, 6), or None if no standard deviation is given and no rotation is missing."""
    has_std = STD_COLUMNS[0] in table.columns
    if not has_std and not position_only.any():
        return None
    unknown = np.full(len(position_only), np.nan)
    std_m, std_rad = (_read_std(table, column) for column in STD_COLUMNS) if has_std else (unknown, unknown)
    told = np.flatnonzero(position_only & ~np.isnan(std_rad))
    if told.size:
        raise table.refusal(int(told[0]), "std_rad of a row without a quaternion; leave both blank, or neither")
    return diagonal_covariance(std_m**2, np.where(position_only, np.inf, std_rad**2))


def _read_std(table: Table, column: str) -> FloatArray:
    std = table.floats(column)
    wrong = np.flatnonzero((std < SHARPEST) | (std > FARTHEST_M))
    if wrong.size:
        want = f"want more than 0 ({SHARPEST:g} to {FARTHEST_M:g}), or nothing if unknown"
        raise table.refusal(int(wrong[0]), f"{column} is {std[wrong[0]]:g}; {want}")
    return std


def _deviations(log: PoseLog, rows: np.ndarray, parts: np.ndarray) -> FloatArray:
    """(N, 2) standard deviations per axis in metres and radians; NaN where unknown."""
    if log.covariance is None:
        return np.full((len(rows), 2), np.nan)
    variances = np.diagonal(log.covariance[rows, parts], axis1=-2, axis2=-1)
    return np.sqrt(variances.reshape(-1, 2, 3).mean(axis=-1))


def _cells(values: FloatArray) -> list[list[str]]:
    """Rows of numbers as text that reads back to the same numbers; blank where not finite."""
    return [[repr(x) if math.isfinite(x) else "" for x in row] for row in values.tolist()]
