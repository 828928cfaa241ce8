"""TUM trajectories: `t x y z qx qy qz qw` a row; one file is one part.

Format: "File Formats" of the TUM RGB-D benchmark, Computer Vision Group, TU Munich.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from station.errors import InvalidData
from station.formats.pose_rows import (
    on_common_times,
    pose_log_of_rows,
    poses_of,
    read_positions,
    read_quaternions,
    slug_of_file,
)
from station.formats.table import parse_words
from station.kinematics import se3
from station.logs import PoseLog

COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def parse_tum(text: str, name: str) -> PoseLog:
    """Read the text of a TUM trajectory; blank lines and lines that begin with # are skipped.

    Args:
        text: the file's text.
        name: the file's name; its stem names the part, as in `slug_of_file`.

    Returns:
        A log of one part in `world`, with the file's own stamps and no covariance.

    Raises:
        InvalidFile: with the row, for another width than eight, for what is no finite number, for times that don't
            increase, and for a quaternion off unit length by more than 1e-3.
    """
    table = parse_words(text, name, (COLUMNS,))
    t_s = table.times("t", repeats=False)
    T_world_part = poses_of(read_positions(table, ("x", "y", "z")), read_quaternions(table, ("qw", "qx", "qy", "qz")))
    return pose_log_of_rows(table, t_s, [slug_of_file(name)] * len(t_s), T_world_part, None, "world")


def parse_tum_files(texts: Mapping[str, str], name: str) -> PoseLog:
    """Read several TUM trajectories of one recording: a part a file, on the union of their stamps.

    Args:
        texts: each file's name and its text, at least one.
        name: what they are together, for errors.

    Raises:
        InvalidFile: as `parse_tum`, and for two files that name the same part.
    """
    return on_common_times([parse_tum(text, file) for file, text in texts.items()], name)


def format_tum(log: PoseLog, part: str) -> str:
    """Text of one part's trajectory; times at which it wasn't seen have no row. Covariances are lost.

    Numbers read back to the same float64.

    Raises:
        InvalidData: the part's rotations weren't observed, which TUM can't tell.
    """
    k = log.parts.index(part)
    seen = log.seen[:, k]
    if log.covariance is not None and np.any(np.isinf(log.covariance[seen, k, 3:, 3:])):
        raise InvalidData(f"the rotations of '{part}' were not observed; TUM wants them: choose another format")
    xyz, wxyz = se3.to_xyz_wxyz(log.T_ref_part[seen, k])
    rows = np.column_stack([log.t_s[seen], xyz, wxyz[:, [1, 2, 3, 0]]]).tolist()
    lines = [f"# {' '.join(COLUMNS)}", *(" ".join(map(repr, row)) for row in rows)]
    return "\n".join(lines) + "\n"
