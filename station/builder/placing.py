"""Where joints and parts are: by numbers in the parent's frame, or by a gizmo's pose in the root's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from station.builder.draft import Draft, check_close
from station.builder.edits import moved_joint, upright
from station.errors import InvalidData
from station.formats.urdf_links import roll_pitch_yaw, rotation
from station.kinematics import se3
from station.kinematics.tree import Joint
from station.logs import FloatArray

# An axis shorter than this, and a quaternion, has no direction.
SHORTEST_AXIS = 1e-9
Numbers = tuple[float, ...]


def set_axis(draft: Draft, joint: str, axis: ArrayLike, point_m: ArrayLike | None = None) -> Draft:
    """The draft with another axis of a joint; the child stays where it is with the joint at 0.

    Args:
        draft: of the joint.
        joint: its name.
        axis: (3,) direction in the parent's frame, of any length but zero; ignored for a ball, which has none.
        point_m: (3,) a point of it there, or a ball's centre; the old one if None; ignored for a type without one.

    Raises:
        InvalidData: for a joint that isn't there or is rigid, an axis without direction, what is no number.
    """
    old = draft.joint(joint)
    if not old.kind.states:
        raise InvalidData(f"joint '{joint}' is rigid and has no axis; choose another type first")
    point = old.point_parent_m
    if point is not None and point_m is not None:
        point = np.asarray(point_m, dtype=np.float64)
        check_close(point, f"joint '{joint}'")
    direction = _direction(axis, joint) if old.kind.has_axis else None
    return draft.with_joint(replace(old, axis_parent=direction, point_parent_m=point))


def axis_gizmo(draft: Draft, joint: str, states: Mapping[str, float]) -> tuple[Numbers, Numbers]:
    """Quaternion (w, x, y, z) and place [m] in the root's frame of a gizmo on a joint: its z is the axis.

    Raises:
        InvalidData: for a joint that isn't there.
    """
    placed = draft.joint(joint)
    return to_gizmo(draft.poses(states)[placed.parent] @ placed.geometry.T_parent_axis)


def place_axis(draft: Draft, joint: str, wxyz: ArrayLike, xyz: ArrayLike, states: Mapping[str, float]) -> Draft:
    """The draft with a joint's axis where a gizmo is, its z along it; see `set_axis`.

    Args:
        draft: of the joint.
        joint: its name.
        wxyz: quaternion in the root's frame.
        xyz: (3,) place there [m].
        states: of all columns, at which the gizmo is seen.
    """
    T_root_gizmo = from_gizmo(wxyz, xyz)
    T_parent_gizmo = se3.inverse(draft.poses(states)[draft.joint(joint).parent]) @ T_root_gizmo
    return set_axis(draft, joint, T_parent_gizmo[:3, 2], T_parent_gizmo[:3, 3])


def part_gizmo(draft: Draft, part: str, states: Mapping[str, float]) -> tuple[Numbers, Numbers]:
    """Quaternion (w, x, y, z) and place [m] of a part in the root's frame; raises InvalidData if it isn't there."""
    draft.check_part(part)
    return to_gizmo(draft.poses(states)[part])


def place_part(draft: Draft, part: str, wxyz: ArrayLike, xyz: ArrayLike, states: Mapping[str, float]) -> Draft:
    """The draft with a part where a gizmo is. Its joint and all that hangs from it go along.

    Args:
        draft: of the part.
        part: its name; the root can't be moved, for all is told in its frame.
        wxyz: quaternion in the root's frame.
        xyz: (3,) place there [m].
        states: of all columns, at which the gizmo is seen.

    Raises:
        InvalidData: for a part that isn't there, the root, and a place that is none.
    """
    joint = _moved_with(draft, part)
    poses = draft.poses(states)
    T_parent_new = se3.inverse(poses[joint.parent]) @ from_gizmo(wxyz, xyz)
    T_parent_old = se3.inverse(poses[joint.parent]) @ poses[part]
    # A motion of the whole joint by D takes T(q) to D T(q), at every state.
    return draft.with_joint(moved_joint(joint, T_parent_new @ se3.inverse(T_parent_old)))


def zero_numbers(draft: Draft, part: str) -> tuple[Numbers, Numbers]:
    """A part's place [m] in its parent with its joint at 0, and roll, pitch, yaw [rad] there, as URDF has them.

    Raises:
        InvalidData: for a part that isn't there, and the root.
    """
    T = _moved_with(draft, part).T_parent_child_zero
    return _numbers(T[:3, 3]), tuple(float(angle) for angle in roll_pitch_yaw(T[:3, :3]))


def set_zero(draft: Draft, part: str, xyz_m: ArrayLike, rpy_rad: ArrayLike) -> Draft:
    """The draft with a part at a place in its parent's frame with its joint at 0; its joint goes along.

    Args:
        draft: of the part.
        part: its name; not the root.
        xyz_m: (3,).
        rpy_rad: roll, pitch, yaw.

    Raises:
        InvalidData: for a part that isn't there, the root, and what is no number.
    """
    joint = _moved_with(draft, part)
    place, angles = np.asarray(xyz_m, dtype=np.float64), np.asarray(rpy_rad, dtype=np.float64)
    check_close(place, f"part '{part}'")
    if angles.shape != (3,) or not np.all(np.isfinite(angles)):
        raise InvalidData(f"part '{part}': roll, pitch, yaw are {angles.tolist()}; want three numbers")
    T_new = se3.pose(rotation(*angles.tolist()), place)
    return draft.with_joint(moved_joint(joint, T_new @ se3.inverse(joint.T_parent_child_zero)))


def to_gizmo(T_root_x: FloatArray) -> tuple[Numbers, Numbers]:
    """Quaternion (w, x, y, z) and place [m] of a (4, 4) pose."""
    xyz, wxyz = se3.to_xyz_wxyz(T_root_x)
    return _numbers(wxyz), _numbers(xyz)


def from_gizmo(wxyz: ArrayLike, xyz: ArrayLike) -> FloatArray:
    """(4, 4) pose of a quaternion of any length but zero and a place [m]; raises InvalidData for what is none."""
    q, place = np.asarray(wxyz, dtype=np.float64), np.asarray(xyz, dtype=np.float64)
    check_close(place, "the gizmo")
    if q.shape != (4,) or not np.all(np.isfinite(q)) or not np.linalg.norm(q) > SHORTEST_AXIS:
        raise InvalidData(f"the gizmo is turned by the quaternion {q.tolist()}; want four numbers, not all of them 0")
    return upright(se3.from_xyz_wxyz(place, q))


def _moved_with(draft: Draft, part: str) -> Joint:
    joint = draft.joint_above(part)
    if joint is None:
        raise InvalidData(f"'{part}' is the root, in whose frame all is told; move the others, or choose another root")
    return joint


def _direction(axis: ArrayLike, joint: str) -> FloatArray:
    """(3,) of unit length."""
    values = np.asarray(axis, dtype=np.float64)
    if values.shape != (3,) or not np.all(np.isfinite(values)):
        raise InvalidData(f"joint '{joint}': the axis is {values.tolist()}; want three numbers")
    largest = float(np.abs(values).max())
    if largest < SHORTEST_AXIS:
        raise InvalidData(f"joint '{joint}': the axis is zero and points nowhere; want a direction such as 0, 0, 1")
    scaled = values / largest  # first: squares of large numbers would overflow
    return scaled / np.linalg.norm(scaled)


def _numbers(values: FloatArray) -> Numbers:
    return tuple(float(value) for value in values)
