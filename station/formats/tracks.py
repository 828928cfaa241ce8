"""Plain track logs: `x y z [qx qy qz qw]` a row, metres, without stamps; one file is one part moving against `world`.

The tracks of doors and drawers recorded for the `articulation` ROS stack (J. Sturm) have this form.
"""

from __future__ import annotations

import numpy as np

from station.formats.pose_rows import (
    diagonal_covariance,
    pose_log_of_rows,
    poses_of,
    read_positions,
    read_quaternions,
    slug_of_file,
)
from station.formats.table import parse_words
from station.logs import PoseLog

POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")


def parse_track(text: str, name: str) -> PoseLog:
    """Read the text of a plain track; blank lines and lines that begin with # are skipped.

    Args:
        text: the file's text; every row has three numbers, or every row has seven.
        name: the file's name; its stem names the part, as in `slug_of_file`.

    Returns:
        A log of one part in `world`. `t_s` counts the rows of data from 0: they have no stamps. Without quaternions the
        rotations are the identity with infinite variance, and the variance of the positions is unknown (NaN).

    Raises:
        InvalidFile: with the row, for other widths, for what is no finite number, and for a quaternion off unit length
            by more than 1e-3.
    """
    table = parse_words(text, name, (POSITION, (*POSITION, *QUATERNION)))
    positions = read_positions(table, POSITION)
    count = len(positions)
    wxyz, covariance = np.full((count, 4), np.nan), None
    if "qw" in table.columns:
        wxyz = read_quaternions(table, ("qw", "qx", "qy", "qz"))
    else:
        covariance = diagonal_covariance(np.full(count, np.nan), np.full(count, np.inf))
    parts = [slug_of_file(name)] * count
    return pose_log_of_rows(table, np.arange(float(count)), parts, poses_of(positions, wxyz), covariance, "world")
