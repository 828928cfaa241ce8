"""Reads the elements of a URDF into a KinematicTree; `urdf` says how joints are told there."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

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
    rotation,
    turned_link,
)
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint, KinematicTree, connected_bodies
from station.logs import SLUG, FloatArray

TYPE_OF_URDF = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "rigid"}


def read_robot(robot: ET.Element, name: str) -> KinematicTree:
    """The tree of a <robot>; `name` is the file's, for errors. Raises InvalidFile."""
    if robot.tag != "robot":
        raise InvalidFile(f"{name} holds a <{robot.tag}>; want a <robot>")
    reader = _Reader(name)
    try:
        return _tree([reader.text(link, "name") for link in robot.findall("link")], reader.edges(robot))
    except InvalidData as error:
        raise InvalidFile(f"{name}: {error}") from None


@dataclass(frozen=True, eq=False, slots=True)
class _Edge:
    """A joint as it stands in the file: `T_parent_child(q) = origin @ motion about or along axis @ after`.

    `type` is that of the tree's joint. A screw has a pitch. `floats` marks the joint of a tree that nothing connects,
    `follows` one that mimics another, by so much.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: FloatArray
    axis: FloatArray
    limits: tuple[float, float] | None
    after: FloatArray
    floats: bool = False
    follows: tuple[str, float] | None = None
    pitch_m_per_rad: float | None = None

    def stands_in(self, other: _Edge) -> bool:
        """Whether it moves about or along the very axis of the joint before it, on that joint's link."""
        at_it = bool(np.all(self.origin == np.eye(4)) and np.all(self.axis == other.axis))
        return at_it and self.parent == other.child


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
        floats = urdf_type == "floating" and name.endswith(FLOATING_SUFFIX)
        if urdf_type not in TYPE_OF_URDF and not floats:
            raise InvalidFile(f"{self.name}: {where} is {urdf_type}; can read {', '.join(TYPE_OF_URDF)}")
        origin = element.find("origin")
        xyz = self.numbers(origin, "xyz", (0, 0, 0), where)
        rpy = self.numbers(origin, "rpy", (0, 0, 0), where)
        axis = self.numbers(element.find("axis"), "xyz", (1, 0, 0), where)  # the default is URDF's
        if not np.any(axis):
            raise InvalidFile(f"{self.name}: {where}: the axis has no direction")
        return _Edge(
            name=name,
            type=TYPE_OF_URDF.get(urdf_type, "rigid"),
            parent=self.end(element, "parent", where),
            child=self.end(element, "child", where),
            origin=se3.pose(rotation(*rpy), xyz),
            axis=_unit(axis),
            limits=self.limits(element, urdf_type, where),
            after=np.eye(4),
            floats=floats,
            follows=self.follows(element, where),
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

    def follows(self, element: ET.Element, where: str) -> tuple[str, float] | None:
        """Which joint it mimics, and by how much; with an offset it is no screw's."""
        mimic = element.find("mimic")
        if mimic is None:
            return None
        multiplier = float(self.numbers(mimic, "multiplier", (1,), where)[0])
        offset = float(self.numbers(mimic, "offset", (0,), where)[0])
        return ("" if offset else self.text(mimic, "joint")), multiplier


def _unit(axis: FloatArray) -> FloatArray:
    """The axis at unit length; untouched if it is as near to that as rounding allows."""
    length = float(np.linalg.norm(axis))
    return axis if abs(length - 1) < 4 * np.finfo(float).eps else axis / length


def _tree(links: Sequence[str], edges: Sequence[_Edge]) -> KinematicTree:
    """The tree of links and joints, the helpers of `to_urdf` folded away."""
    edges, helpers = _folded(edges)
    for edge in edges:
        if edge.follows is not None:
            raise InvalidData(f"joint '{edge.name}' mimics another; a tree's joints move by themselves")
    slugs = _slugs([link for link in links if link not in helpers])
    mounts = [edge for edge in edges if edge.type == "rigid" and edge.name == edge.child + MOUNT_SUFFIX]
    loose = [edge for edge in edges if edge.floats]
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
        mounts={slugs[edge.child]: edge.origin for edge in mounts},
    )


def _folded(edges: Sequence[_Edge]) -> tuple[list[_Edge], set[str]]:
    """Joints with their helpers taken in up to the fixed one before the child, and the links that this saves."""
    by_name = {edge.name: edge for edge in edges}
    below = Counter(edge.parent for edge in edges)
    instead: dict[str, _Edge] = {}
    taken: set[str] = set()
    saved: set[str] = set()
    for zero in edges:
        chain = _chain(zero, by_name)
        links = [edge.child for edge in chain]
        if chain and zero.type == "rigid" and zero.parent == links[-1] and all(below[link] == 1 for link in links):
            instead[chain[0].name] = replace(_whole(chain), child=zero.child, after=zero.origin)
            taken |= {edge.name for edge in (*chain[1:], zero)}
            saved |= set(links)
    return [instead.get(edge.name, edge) for edge in edges if edge.name not in taken], saved


def _chain(zero: _Edge, by_name: Mapping[str, _Edge]) -> list[_Edge]:
    """The joints of `to_urdf` before the fixed one that it ends with; none if it is not such a chain."""
    if not zero.name.endswith(ZERO_SUFFIX):
        return []
    name = zero.name.removesuffix(ZERO_SUFFIX)
    turns = [by_name.get(f"{name}-{angle}") for angle in BALL_AXES]
    ball = [turn for turn in turns if turn is not None]
    if len(ball) == len(BALL_AXES) and _is_ball(name, ball):
        return ball
    joint, advance = by_name.get(name), by_name.get(name + ADVANCE_SUFFIX)
    if joint is None or joint.child != name + AXIS_SUFFIX:
        return []
    if advance is not None and _is_advance(joint, advance):
        return [joint, advance]
    return [joint]


def _is_ball(name: str, turns: Sequence[_Edge]) -> bool:
    joined = all(after.parent == before.child for before, after in pairwise(turns))
    in_centre = all(np.all(turn.origin == np.eye(4)) for turn in turns[1:])
    plain = all(turn.type == "revolute" and turn.limits is None and turn.follows is None for turn in turns)
    about = all(
        turn.child == turned_link(name, angle) and np.all(turn.axis == BALL_AXES[angle])
        for turn, angle in zip(turns, BALL_AXES, strict=True)
    )
    return joined and in_centre and plain and about


def _is_advance(joint: _Edge, advance: _Edge) -> bool:
    follows = advance.follows is not None and advance.follows[0] == joint.name
    kinds = (joint.type, advance.type) == ("revolute", "prismatic") and joint.follows is None
    return follows and kinds and advance.stands_in(joint) and advance.child == advanced_link(joint.name)


def _whole(chain: Sequence[_Edge]) -> _Edge:
    """The one joint that a chain stands for."""
    first, last = chain[0], chain[-1]
    if len(chain) == len(BALL_AXES):
        return replace(first, name=first.name.removesuffix(f"-{next(iter(BALL_AXES))}"), type="spherical")
    if last.follows is not None:
        return replace(first, type="screw", pitch_m_per_rad=last.follows[1])
    return first


def _root(bodies: Sequence[str], below: set[str]) -> str:
    roots = [body for body in bodies if body not in below]
    if len(roots) != 1:
        raise InvalidData(f"{len(roots)} links have no joint above them ({', '.join(roots) or 'a loop'}); want one")
    return roots[0]


def _joint(edge: _Edge, name: str, slugs: Mapping[str, str]) -> Joint:
    """The joint of `origin @ motion(q) @ after`: axis and point in the parent's frame are those of the origin."""
    kind = JOINT_TYPES[edge.type]
    return Joint(
        name=name,
        type=edge.type,
        parent=slugs[edge.parent],
        child=slugs[edge.child],
        axis_parent=_unit(edge.origin[:3, :3] @ edge.axis) if kind.has_axis else None,
        point_parent_m=edge.origin[:3, 3] if kind.has_point else None,
        T_parent_child_zero=edge.origin @ edge.after,
        pitch_m_per_rad=edge.pitch_m_per_rad,
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
