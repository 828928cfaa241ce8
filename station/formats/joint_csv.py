"""joint_states.csv and commands.csv: `t_s`, a column a joint (rad or m; three of a ball), maybe `<joint>_std` ones."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Mapping

import numpy as np

from station.errors import InvalidData, InvalidFile
from station.formats.table import Table, parse_csv
from station.logs import SLUG, FloatArray, JointLog

STD_SUFFIX = "_std"


def format_joint_states(log: JointLog) -> str:
    """Text of a joint_states.csv: the log's own stamps, a row for each; blank where a state is NaN.

    Numbers read back to the same float64. There are columns of standard deviations only if the log has any. Units
    aren't in the file: kinematics.json tells them.

    Raises:
        InvalidData: for a joint named like another's column of standard deviations.
    """
    clash = [joint for joint in log.joints if _is_std(joint, log.joints)]
    if clash:
        raise InvalidData(f"joint '{clash[0]}' is named like the standard deviation of another joint; rename it")
    header = ["t_s", *log.joints]
    columns = [log.t_s[:, None], log.q]
    if log.std is not None:
        header += [joint + STD_SUFFIX for joint in log.joints]
        columns.append(log.std)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    rows = (np.concatenate(columns, axis=1) + 0.0).tolist()  # -0.0 + 0.0 is 0.0
    writer.writerows([repr(x) if math.isfinite(x) else "" for x in row] for row in rows)
    return out.getvalue()


def parse_joint_states(text: str, name: str, units: Mapping[str, str] | None = None) -> JointLog:
    """Read the text of a joint_states.csv.

    Args:
        text: the file's text.
        name: the file's name, for errors.
        units: "rad" or "m" by joint; joints that aren't in it are in rad.

    Returns:
        A log with NaN where a cell is blank; `std` is None if there is no `<joint>_std` column.

    Raises:
        InvalidFile: for columns that are no joints' names and, with the row, for times that don't increase and for what
            is no finite number.
    """
    table = _table(text, name, least_joints=0)  # a tree without joints has no states, at the times of its log
    joints = [c for c in table.columns if c != "t_s" and not _is_std(c, table.columns)]
    deviations = [joint + STD_SUFFIX for joint in joints]
    has_std = any(column in table.columns for column in deviations)
    t_s = table.times("t_s", repeats=False)
    std = _deviations(table, deviations) if has_std else None
    return JointLog(t_s, tuple(joints), _columns(table, joints), _units(joints, units), std)


def parse_commands(text: str, name: str, units: Mapping[str, str] | None = None) -> JointLog:
    """Read the text of a commands.csv: `t_s`, then a column a joint; arguments and errors as `parse_joint_states`.

    Every column is a joint here, whatever its name ends in.
    """
    table = _table(text, name, least_joints=1)
    joints = [column for column in table.columns if column != "t_s"]
    return JointLog(table.times("t_s", repeats=False), tuple(joints), _columns(table, joints), _units(joints, units))


def _table(text: str, name: str, *, least_joints: int) -> Table:
    table = parse_csv(text, name)
    columns = list(table.columns)
    if columns[0] != "t_s" or len(columns) < 1 + least_joints:
        raise InvalidFile(f"{name}: columns {','.join(columns)}; want t_s, then a column for each joint")
    for column in columns[1:]:
        if not SLUG.fullmatch(column):
            raise InvalidFile(f"{name}: column '{column}' is no joint's name; names match [a-z][a-z0-9_]*")
    return table


def _is_std(column: str, columns: Collection[str]) -> bool:
    return column.endswith(STD_SUFFIX) and column.removesuffix(STD_SUFFIX) in columns


def _columns(table: Table, names: list[str]) -> FloatArray:
    """(N, len(names)); NaN for blanks and for columns that aren't there."""
    columns = np.full((len(table.rows), len(names)), np.nan)
    for i, name in enumerate(names):
        if name in table.columns:
            columns[:, i] = table.floats(name)
    return columns


def _deviations(table: Table, names: list[str]) -> FloatArray:
    std = _columns(table, names)
    wrong = np.argwhere(std < 0)
    if len(wrong):
        i, j = (int(index) for index in wrong[0])
        raise table.refusal(i, f"{names[j]} is {std[i, j]:g}; want 0 or more, or nothing if unknown")
    return std


def _units(joints: list[str], units: Mapping[str, str] | None) -> tuple[str, ...]:
    return tuple((units or {}).get(joint, "rad") for joint in joints)
