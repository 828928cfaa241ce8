"""Marker poses of the ArUco library of 2013: `t_s,id,tx,ty,tz,rx,ry,rz`, with the angles of the paper's equation 26.

OpenCV gives rotation vectors instead: nothing else in the station converts angles in this way.
"""

from __future__ import annotations

import math

import numpy as np

from station.errors import InvalidFile
from station.formats.pose_rows import pose_log_of_rows, read_positions
from station.formats.table import Table, parse_csv
from station.kinematics import se3
from station.logs import FloatArray, PoseLog

COLUMNS = ("t_s", "id", "tx", "ty", "tz", "rx", "ry", "rz")


def rotation_of_angles(angles_rad: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of the library's angles (..., 3) r_x, r_y, r_z in radians (paper, 26).

    `R = R_z(pi/2) R_y(r_x) R_z(-pi/2) R_y(r_y) R_z(r_z)`, kept as printed. Its first three factors look like a misprint
    for R_x(r_x), but R_z(pi/2) takes the y axis to -x: together they are R_x(-r_x), the angle's sign turned.
    """
    turn = math.pi / 2 * np.array([0.0, 0.0, 1.0])
    about_x, about_y, about_z = (angles_rad[..., i, None] for i in range(3))
    y, z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    swapped_x = se3.exp_so3(turn) @ se3.exp_so3(about_x * y) @ se3.exp_so3(-turn)
    return swapped_x @ se3.exp_so3(about_y * y) @ se3.exp_so3(about_z * z)


def parse_legacy_aruco(text: str, name: str) -> PoseLog:
    """Read legacy marker rows: seconds, marker id, position in metres, angles in radians, under their header.

    Args:
        text: the file's text.
        name: the file's name, for errors.

    Returns:
        A log in `camera` with the parts `marker_<id>`, in the order of their first rows, without covariance.

    Raises:
        InvalidFile: for other columns and, with the row, for what is no finite number, falling times, an id that is no
            whole number from 0, a marker twice at one time.
    """
    table = parse_csv(text, name)
    if set(table.columns) != set(COLUMNS):
        raise InvalidFile(f"{name}: columns {','.join(table.columns)}; want {','.join(COLUMNS)}")
    t_s = table.times("t_s", repeats=True)
    R = rotation_of_angles(read_positions(table, ("rx", "ry", "rz")))
    T_camera_marker = se3.pose(R, read_positions(table, ("tx", "ty", "tz")))
    return pose_log_of_rows(table, t_s, _parts(table), T_camera_marker, None, "camera")


def _parts(table: Table) -> list[str]:
    ids = table.filled_floats("id")
    wrong = np.flatnonzero((ids < 0) | (ids != np.round(ids)))
    if wrong.size:
        raise table.refusal(int(wrong[0]), f"id is {table.columns['id'][wrong[0]]}; want a whole number from 0")
    return [f"marker_{int(i)}" for i in ids]
