"""URDF (the robot description of ROS) of a KinematicTree and back.

In URDF the frame of a link is the frame of its joint, so a child whose frame isn't on the axis needs a link between:

    parent --joint (origin at the point, parent's directions)--> `<joint>-axis` --fixed--> child

The dash keeps these links apart from parts, whose names are slugs; reading back folds them away. The fixed origin is
`translation(-point) @ T_parent_child_zero`, so that the whole is `motion(q) @ T_parent_child_zero`. Trees that nothing
connects hang from the root by `floating` joints. Format: http://wiki.ros.org/urdf/XML.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from station.errors import InvalidData, InvalidFile
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree, connected_bodies
from station.logs import SLUG, FloatArray

AXIS_SUFFIX = "-axis"  # the link on a joint's axis
ZERO_SUFFIX = "-zero"  # the fixed joint from there to the child
MOUNT_SUFFIX = "-mount"  # the fixed joint of a further tracker
FLOATING_SUFFIX = "-floating"  # the joint of a tree that nothing connects
# URDF demands a range of a prismatic joint; beyond this one there is none.
UNBOUNDED_M = 1000.0
# URDF demands these of a joint with limits; a tree knows neither forces nor speeds.
EFFORT_AND_VELOCITY = {"effort": "1", "velocity": "1"}
TYPE_OF_URDF = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "rigid"}


def to_urdf(tree: KinematicTree, name: str, mounts: Mapping[str, FloatArray] | None = None) -> str:
    """URDF text of a tree; a reader's forward kinematics is the tree's.

    Limits are the joint's, or else its observed range; a revolute joint with neither is `continuous`.

    Args:
        tree: joints of the types rigid, prismatic and revolute.
        name: the robot's name.
        mounts: `T_body_part` (4, 4) of further trackers by part, `body` being the named part of their rigid group.
            Those without a mount are left out and named in a comment.

    Raises:
        InvalidData: for joints that URDF has no type for, and mounts of parts that are no further trackers.
    """
    mounts = mounts or {}
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


def from_urdf(text: str, name: str) -> KinematicTree:
    """Read the text of a URDF: its links become parts, its joints the tree's.

    Names are lower-cased and slugged. Limits are kept; visuals, collisions, inertias and dynamics are not read. Fixed
    joints become rigid joints, but for the mounts that `to_urdf` writes: these become rigid groups.

    Args:
        text: the file's text.
        name: the file's name, for errors.

    Raises:
        InvalidFile: for what is no XML or no robot, unknown links, planar, floating (but those of `to_urdf`) and mimic
            joints, numbers that can't be read, links that form no tree.
    """
    try:
        robot = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise InvalidFile(f"{name} is no XML: {error}") from None
    if robot.tag != "robot":
        raise InvalidFile(f"{name} holds a <{robot.tag}>; want a <robot>")
    reader = _Reader(name)
    try:
        return _tree([reader.text(link, "name") for link in robot.findall("link")], reader.edges(robot))
    except InvalidData as error:
        raise InvalidFile(f"{name}: {error}") from None


def _add_joint(robot: ET.Element, joint: Joint) -> None:
    ends = (joint.parent, joint.child)
    if joint.type == "rigid":
        _add_link_joint(robot, joint.name, "fixed", ends, joint.T_parent_child_zero)
        return
    if joint.type not in TYPE_OF_URDF.values() or joint.axis_parent is None:
        raise InvalidData(f"joint '{joint.name}': URDF has no {joint.type} joint; it has {', '.join(TYPE_OF_URDF)}")
    T_parent_axis = se3.translation(np.zeros(3) if joint.point_parent_m is None else joint.point_parent_m)
    on_axis = joint.name + AXIS_SUFFIX
    limits = _limits(joint)
    urdf_type = joint.type if limits is not None else "continuous"
    ET.SubElement(robot, "link", name=on_axis)
    element = _add_link_joint(robot, joint.name, urdf_type, (joint.parent, on_axis), T_parent_axis)
    ET.SubElement(element, "axis", xyz=_numbers(joint.axis_parent))
    if limits is not None:
        low, high = (_number(x) for x in limits)
        ET.SubElement(element, "limit", {"lower": low, "upper": high, **EFFORT_AND_VELOCITY})
    T_axis_child = se3.inverse(T_parent_axis) @ joint.T_parent_child_zero
    _add_link_joint(robot, joint.name + ZERO_SUFFIX, "fixed", (on_axis, joint.child), T_axis_child)


def _add_link_joint(
    robot: ET.Element, name: str, urdf_type: str, ends: tuple[str, str], T_parent_child: FloatArray
) -> ET.Element:
    element = ET.SubElement(robot, "joint", name=name, type=urdf_type)
    xyz, rpy = T_parent_child[:3, 3], _roll_pitch_yaw(T_parent_child[:3, :3])
    ET.SubElement(element, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    ET.SubElement(element, "parent", link=ends[0])
    ET.SubElement(element, "child", link=ends[1])
    return element


def _limits(joint: Joint) -> tuple[float, float] | None:
    """Limits, else the observed range, else none for a revolute joint and a wide range for a prismatic one."""
    if joint.limits is not None:
        return joint.limits
    if joint.state_min is not None and joint.state_max is not None:
        return joint.state_min, joint.state_max
    return None if joint.type == "revolute" else (-UNBOUNDED_M, UNBOUNDED_M)


def _roll_pitch_yaw(R: FloatArray) -> tuple[float, float, float]:
    """Angles with `R = Rz(yaw) Ry(pitch) Rx(roll)`; exact to rounding also where pitch is a quarter turn.

    The first column tells the yaw; R turned back by it tells the others, so that the roll makes up for a yaw that
    rounding determines.
    """
    yaw = math.atan2(R[1, 0], R[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    forward, left = c * R[0] + s * R[1], c * R[1] - s * R[0]  # rows of Rz(-yaw) @ R
    return math.atan2(-left[2], left[1]), math.atan2(-R[2, 0], forward[0]), yaw


def _rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    x, y, z = se3.exp_so3(np.diag([roll, pitch, yaw]))
    return z @ y @ x


def _number(x: float) -> str:
    return repr(float(x) + 0.0)  # no -0.0


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(_number(x) for x in values)


@dataclass(frozen=True, eq=False, slots=True)
class _Edge:
    """A joint as it stands in the file: `T_parent_child(q) = origin @ motion about or along axis @ after`."""

    name: str
    urdf_type: str
    parent: str
    child: str
    origin: FloatArray
    axis: FloatArray
    limits: tuple[float, float] | None
    after: FloatArray


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reads elements of the file `name`, which errors name."""

    name: str

    def text(self, element: ET.Element, attribute: str) -> str:
        value = element.get(attribute)
        if not value:
            raise InvalidFile(f"{self.name}: a <{element.tag}> has no {attribute}")
        return value

    def numbers(self, element: ET.Element | None, attribute: str, otherwise: Sequence[float], where: str) -> FloatArray:
        text = None if element is None else element.get(attribute)
        if text is None:
            return np.array(otherwise, dtype=np.float64)
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.array([math.nan])
        if len(values) != len(otherwise) or not np.all(np.isfinite(values)):
            raise InvalidFile(f"{self.name}: {where}: {attribute} is '{text}'; want {len(otherwise)} finite numbers")
        return values

    def edges(self, robot: ET.Element) -> list[_Edge]:
        edges = [self.edge(element) for element in robot.findall("joint")]
        links = {self.text(link, "name") for link in robot.findall("link")}
        for edge in edges:
            for link in (edge.parent, edge.child):
                if link not in links:
                    raise InvalidFile(f"{self.name}: joint '{edge.name}' names the link '{link}', which isn't there")
        return edges

    def edge(self, element: ET.Element) -> _Edge:
        name, urdf_type = self.text(element, "name"), self.text(element, "type")
        where = f"joint '{name}'"
        if urdf_type not in TYPE_OF_URDF and not (urdf_type == "floating" and name.endswith(FLOATING_SUFFIX)):
            raise InvalidFile(f"{self.name}: {where} is {urdf_type}; can read {', '.join(TYPE_OF_URDF)}")
        if element.find("mimic") is not None:
            raise InvalidFile(f"{self.name}: {where} mimics another; a tree's joints move by themselves")
        origin = element.find("origin")
        xyz = self.numbers(origin, "xyz", (0, 0, 0), where)
        rpy = self.numbers(origin, "rpy", (0, 0, 0), where)
        axis = self.numbers(element.find("axis"), "xyz", (1, 0, 0), where)  # the default is URDF's
        if not np.any(axis):
            raise InvalidFile(f"{self.name}: {where}: the axis has no direction")
        return _Edge(
            name=name,
            urdf_type=urdf_type,
            parent=self.end(element, "parent", where),
            child=self.end(element, "child", where),
            origin=se3.pose(_rotation(*rpy), xyz),
            axis=_unit(axis),
            limits=self.limits(element, urdf_type, where),
            after=np.eye(4),
        )

    def end(self, element: ET.Element, end: str, where: str) -> str:
        found = element.find(end)
        if found is None:
            raise InvalidFile(f"{self.name}: {where} has no <{end}>")
        return self.text(found, "link")

    def limits(self, element: ET.Element, urdf_type: str, where: str) -> tuple[float, float] | None:
        limit = element.find("limit")
        if limit is None or urdf_type not in ("revolute", "prismatic"):
            return None
        low = float(self.numbers(limit, "lower", (0,), where)[0])
        high = float(self.numbers(limit, "upper", (0,), where)[0])
        return None if urdf_type == "prismatic" and (low, high) == (-UNBOUNDED_M, UNBOUNDED_M) else (low, high)


def _unit(axis: FloatArray) -> FloatArray:
    """The axis at unit length; untouched if it is as near to that as rounding allows."""
    length = float(np.linalg.norm(axis))
    return axis if abs(length - 1) < 4 * np.finfo(float).eps else axis / length


def _tree(links: Sequence[str], edges: Sequence[_Edge]) -> KinematicTree:
    """The tree of links and joints, the helpers of `to_urdf` folded away."""
    edges, helpers = _folded(edges)
    slugs = _slugs([link for link in links if link not in helpers])
    mounts = [edge for edge in edges if edge.urdf_type == "fixed" and edge.name == edge.child + MOUNT_SUFFIX]
    loose = [edge for edge in edges if edge.urdf_type == "floating"]
    others = [edge for edge in edges if edge not in mounts and edge not in loose]
    names = _slugs([edge.name for edge in others])
    joints = [_joint(edge, names[edge.name], slugs) for edge in others]
    groups: dict[str, list[str]] = {}
    for edge in mounts:
        groups.setdefault(edge.parent, [slugs[edge.parent]]).append(slugs[edge.child])
    trackers = {edge.child for edge in mounts}
    bodies = [slug for link, slug in slugs.items() if link not in trackers]
    return KinematicTree(
        root=_root(bodies, {joint.child for joint in joints} | {slugs[edge.child] for edge in loose}),
        parts=tuple(slugs.values()),
        rigid_groups=tuple(tuple(group) for group in groups.values()),
        trees=connected_bodies(bodies, joints),
        joints=tuple(joints),
    )


def _folded(edges: Sequence[_Edge]) -> tuple[list[_Edge], set[str]]:
    """Joints with the fixed joint behind their `-axis` link taken in, and the links that this saves."""
    below = Counter(edge.parent for edge in edges)
    zeros = {edge.parent: edge for edge in edges if edge.urdf_type == "fixed" and below[edge.parent] == 1}
    folded: list[_Edge] = []
    taken: list[_Edge] = []
    for edge in edges:
        zero = zeros.get(edge.child)
        if zero is not None and (edge.child, zero.name) == (edge.name + AXIS_SUFFIX, edge.name + ZERO_SUFFIX):
            edge = replace(edge, child=zero.child, after=zero.origin)
            taken.append(zero)
        folded.append(edge)
    return [edge for edge in folded if edge not in taken], {zero.parent for zero in taken}


def _root(bodies: Sequence[str], below: set[str]) -> str:
    roots = [body for body in bodies if body not in below]
    if len(roots) != 1:
        raise InvalidData(f"{len(roots)} links have no joint above them ({', '.join(roots) or 'a loop'}); want one")
    return roots[0]


def _joint(edge: _Edge, name: str, slugs: Mapping[str, str]) -> Joint:
    """The joint of `origin @ motion(q) @ after`: axis and point in the parent's frame are those of the origin."""
    kind = TYPE_OF_URDF[edge.urdf_type]
    return Joint(
        name=name,
        type=kind,
        parent=slugs[edge.parent],
        child=slugs[edge.child],
        axis_parent=None if kind == "rigid" else _unit(edge.origin[:3, :3] @ edge.axis),
        point_parent_m=edge.origin[:3, 3] if kind == "revolute" else None,
        T_parent_child_zero=edge.origin @ edge.after,
        limits=edge.limits,
    )


def _slugs(names: Sequence[str]) -> dict[str, str]:
    """Slug of each name; raises InvalidData where two names share one."""
    slugs: dict[str, str] = {}
    for name in names:
        slug = re.sub(r"[^a-z0-9_]", "_", name.lower())
        slug = slug if SLUG.fullmatch(slug) else f"n_{slug}"
        if name in slugs or slug in slugs.values():
            raise InvalidData(f"'{name}' is named '{slug}' here, and so is another; want distinct names")
        slugs[name] = slug
    return slugs
