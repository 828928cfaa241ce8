"""URDF (the robot description of ROS) of a KinematicTree and back.

In URDF the frame of a link is the frame of its joint, so a child whose frame isn't on the axis needs a link between:

    parent --joint (origin at the point, parent's directions)--> `<joint>-axis` --fixed--> child

The dash keeps these links apart from parts, whose names are slugs; reading back folds them away. The fixed origin is
`translation(-point) @ T_parent_child_zero`, so that the whole is `motion(q) @ T_parent_child_zero`. URDF has neither
screws nor balls; they are made of its own joints:

    screw: parent --joint--> `<joint>-axis` --`<joint>-advance`, prismatic, mimics the joint by the pitch--> ... child
    ball:  parent --`<joint>-yaw` about z--> --`<joint>-pitch` about y--> --`<joint>-roll` about x--> ... child

so that the three angles of a ball are those of `Rz(yaw) Ry(pitch) Rx(roll)` and not its rotation vector: `urdf_values`
tells them. Trees that nothing connects hang from the root by `floating` joints. Format: http://wiki.ros.org/urdf/XML.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from station.errors import InvalidData, InvalidFile
from station.formats.urdf_links import (
    ADVANCE_SUFFIX,
    AXIS_SUFFIX,
    BALL_AXES,
    FLOATING_SUFFIX,
    MOUNT_SUFFIX,
    UNBOUNDED_M,
    ZERO_SUFFIX,
    advanced_link,
    roll_pitch_yaw,
    turned_link,
)
from station.formats.urdf_reading import TYPE_OF_URDF, read_robot
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray

# URDF demands these of a joint with limits; a tree knows neither forces nor speeds.
EFFORT_AND_VELOCITY = {"effort": "1", "velocity": "1"}


def to_urdf(tree: KinematicTree, name: str, mounts: Mapping[str, FloatArray] | None = None) -> str:
    """URDF text of a tree; a reader's forward kinematics is the tree's.

    Limits are the joint's, or else its observed range; a revolute joint or a screw with neither is `continuous`, and so
    are the three of a ball: URDF can't limit its angle.

    Args:
        tree: any.
        name: the robot's name.
        mounts: `T_body_part` (4, 4) of further trackers by part, in place of the tree's own. Those without a mount are
            left out and named in a comment.

    Raises:
        InvalidData: for mounts of parts that are no further trackers.
    """
    mounts = {**tree.mounts, **(mounts or {})}
    trackers = [part for part in tree.parts if part not in tree.bodies]
    strange = [part for part in mounts if part not in trackers]
    if strange:
        raise InvalidData(f"mount of '{strange[0]}', which is no further tracker; have {', '.join(trackers) or 'none'}")
    robot = ET.Element("robot", name=name)
    robot.append(ET.Comment(" effort and velocity are placeholders: URDF demands them, the tree knows neither "))
    for part in tree.parts:
        if part in trackers and part not in mounts:
            robot.append(ET.Comment(f" {part} is also on {tree.body_of(part)}; its mount is not known "))
        else:
            ET.SubElement(robot, "link", name=part)
    for joint in tree.joints:
        _add_joint(robot, joint)
    for part, T_body_part in mounts.items():
        _add_link_joint(robot, part + MOUNT_SUFFIX, "fixed", (tree.body_of(part), part), T_body_part)
    for other in tree.tree_roots:
        if other != tree.root:
            _add_link_joint(robot, other + FLOATING_SUFFIX, "floating", (tree.root, other), np.eye(4))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=False) + "\n"


def urdf_values(tree: KinematicTree, q: ArrayLike) -> dict[str, FloatArray]:
    """Values (...,) of the joints of `to_urdf` by name, at states q (..., C) as the tree's `columns` say.

    A screw's mimicking joint moves by itself and is not among them.
    """
    columns = np.asarray(q, dtype=np.float64)
    found: dict[str, FloatArray] = {}
    end = 0
    for joint in tree.movable:
        start, end = end, end + joint.kind.states
        state = columns[..., start:end]
        if joint.type == "spherical":
            roll, pitch, yaw = roll_pitch_yaw(se3.exp_so3(state))
            found |= {f"{joint.name}-yaw": yaw, f"{joint.name}-pitch": pitch, f"{joint.name}-roll": roll}
        else:
            found[joint.name] = state[..., 0]
    return found


def from_urdf(text: str, name: str) -> KinematicTree:
    """Read the text of a URDF: its links become parts, its joints the tree's.

    Names are lower-cased and slugged. Limits are kept; visuals, collisions, inertias and dynamics are not read. Fixed
    joints become rigid joints, but for the mounts that `to_urdf` writes: these become rigid groups. So do its chains of
    joints become screws and balls again.

    Args:
        text: the file's text.
        name: the file's name, for errors.

    Raises:
        InvalidFile: for what is no XML or no robot, unknown links, planar, floating and mimic joints (but those of
            `to_urdf`), numbers that can't be read, links that form no tree.
    """
    try:
        robot = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise InvalidFile(f"{name} is no XML: {error}") from None
    return read_robot(robot, name)


def _add_joint(robot: ET.Element, joint: Joint) -> None:
    ends = (joint.parent, joint.child)
    if joint.type == "rigid":
        _add_link_joint(robot, joint.name, "fixed", ends, joint.T_parent_child_zero)
        return
    T_parent_axis = se3.translation(np.zeros(3) if joint.point_parent_m is None else joint.point_parent_m)
    if joint.type == "spherical":
        last = _add_ball(robot, joint, T_parent_axis)
    elif joint.axis_parent is not None and joint.type in (*TYPE_OF_URDF.values(), "screw"):
        last = _add_axis(robot, joint, joint.axis_parent, T_parent_axis)
        if joint.pitch_m_per_rad is not None:
            last = _add_advance(robot, joint, joint.axis_parent, joint.pitch_m_per_rad)
    else:
        raise InvalidData(f"joint '{joint.name}': a {joint.type} joint can't be told in URDF")
    T_axis_child = se3.inverse(T_parent_axis) @ joint.T_parent_child_zero
    _add_link_joint(robot, joint.name + ZERO_SUFFIX, "fixed", (last, joint.child), T_axis_child)


def _add_axis(robot: ET.Element, joint: Joint, axis: FloatArray, T_parent_axis: FloatArray) -> str:
    """The joint itself; returns the link on its axis."""
    on_axis = joint.name + AXIS_SUFFIX
    limits = _limits(joint)
    urdf_type = "continuous" if limits is None else "prismatic" if joint.type == "prismatic" else "revolute"
    _add_moving_joint(robot, joint.name, urdf_type, (joint.parent, on_axis), T_parent_axis, axis, limits)
    return on_axis


def _add_advance(robot: ET.Element, joint: Joint, axis: FloatArray, pitch: float) -> str:
    """The advance of a screw; returns the link that it moves."""
    limits = _limits(joint)
    low, high = (-UNBOUNDED_M, UNBOUNDED_M) if limits is None else sorted(pitch * x for x in limits)
    ends = (joint.name + AXIS_SUFFIX, advanced_link(joint.name))
    name = joint.name + ADVANCE_SUFFIX
    element = _add_moving_joint(robot, name, "prismatic", ends, np.eye(4), axis, (low, high))
    ET.SubElement(element, "mimic", joint=joint.name, multiplier=_number(pitch), offset="0")
    return ends[1]


def _add_ball(robot: ET.Element, joint: Joint, T_parent_centre: FloatArray) -> str:
    """Three joints in the centre; returns the link that they move."""
    parent, origin = joint.parent, T_parent_centre
    for angle, axis in BALL_AXES.items():
        child = turned_link(joint.name, angle)
        _add_moving_joint(robot, f"{joint.name}-{angle}", "continuous", (parent, child), origin, np.array(axis), None)
        parent, origin = child, np.eye(4)
    return parent


def _add_moving_joint(
    robot: ET.Element,
    name: str,
    urdf_type: str,
    ends: tuple[str, str],
    origin: FloatArray,
    axis: FloatArray,
    limits: tuple[float, float] | None,
) -> ET.Element:
    """A joint to a link of its own, which is added as well."""
    ET.SubElement(robot, "link", name=ends[1])
    element = _add_link_joint(robot, name, urdf_type, ends, origin)
    ET.SubElement(element, "axis", xyz=_numbers(axis))
    if limits is not None:
        low, high = (_number(x) for x in limits)
        ET.SubElement(element, "limit", {"lower": low, "upper": high, **EFFORT_AND_VELOCITY})
    return element


def _add_link_joint(
    robot: ET.Element, name: str, urdf_type: str, ends: tuple[str, str], T_parent_child: FloatArray
) -> ET.Element:
    element = ET.SubElement(robot, "joint", name=name, type=urdf_type)
    xyz, rpy = T_parent_child[:3, 3], roll_pitch_yaw(T_parent_child[:3, :3])
    ET.SubElement(element, "origin", xyz=_numbers(xyz), rpy=_numbers([float(angle) for angle in rpy]))
    ET.SubElement(element, "parent", link=ends[0])
    ET.SubElement(element, "child", link=ends[1])
    return element


def _limits(joint: Joint) -> tuple[float, float] | None:
    """Limits, else the observed range, else none, or for a prismatic joint a wide range."""
    if joint.limits is not None:
        return joint.limits
    if joint.state_min is not None and joint.state_max is not None:
        return joint.state_min, joint.state_max
    return (-UNBOUNDED_M, UNBOUNDED_M) if joint.type == "prismatic" else None


def _number(x: float) -> str:
    return repr(float(x) + 0.0)  # no -0.0


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(_number(x) for x in values)
