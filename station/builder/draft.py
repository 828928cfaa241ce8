"""A tree that is being drawn: always a valid tree, with markers and blocks on its parts. Edits make new ones."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from station.errors import InvalidData
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, check_slugs, frozen_floats
from station.perception.markers import DICTIONARY_SIZES, Marker, MarkerTable, check_dictionary
from station.simulate.scene import check_poses

COLOUR = re.compile(r"#[0-9a-fA-F]{6}")
DICTIONARY = "DICT_4X4_50"
# Metres. Nobody draws anything larger; what is typed beyond it is a slip, and would make numbers lose their digits.
FARTHEST_DRAWN_M = 1000.0
# Radians or metres by joint type, for a joint that nobody has limited; of a spherical one the angle of its rotation.
USUAL_LIMITS: Mapping[str, tuple[float, float]] = {
    "prismatic": (0.0, 0.15),
    "revolute": (-np.pi / 3, np.pi / 3),
    "screw": (-np.pi, np.pi),
    "spherical": (0.0, np.pi / 4),
}
# Radians. No drawn joint turns further to either side.
MOST_TURN_RAD = 100 * 2 * np.pi


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """A box on a part, for people to see.

    Attributes:
        part: that it is on.
        T_part_block: (4, 4) its frame, origin in its middle.
        size_m: (3,) full lengths of its edges.
        colour: "#rrggbb".

    Raises:
        InvalidData: for lengths that are not positive or absurd, another colour, a pose that is no rigid motion.
    """

    part: str
    T_part_block: FloatArray
    size_m: FloatArray
    colour: str

    def __post_init__(self) -> None:
        where = f"the box on '{self.part}'"
        for name in ("T_part_block", "size_m"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), where))
        size = self.size_m
        if size.shape != (3,) or not np.all((size > 0) & (size <= FARTHEST_DRAWN_M)):
            raise InvalidData(f"{where} is {size.tolist()} m; want three above 0, {FARTHEST_DRAWN_M:g} m at most")
        check_near(self.T_part_block, where)
        if not COLOUR.fullmatch(self.colour):
            raise InvalidData(f"{where} has the colour '{self.colour}'; want one such as #8a8f98")


@dataclass(frozen=True, eq=False, slots=True)
class Draft:
    """A drawn tree, checked.

    Attributes:
        name: a slug; of the object, and of the robot in URDF.
        tree: one tree, in which each joint that moves has limits; nothing in it was fitted.
        markers: each with its mount `T_part_marker`, on parts that are bodies of the tree.
        blocks: boxes on the tree's bodies; a part without any is drawn as `drawing` thinks fit.
        dictionary: that the markers are of.

    Raises:
        InvalidData: for anything else: several trees, limits that leave no room, markers or blocks on nothing, ids
            twice or beyond the dictionary, places farther away than FARTHEST_DRAWN_M.
    """

    name: str
    tree: KinematicTree
    markers: tuple[Marker, ...] = ()
    blocks: tuple[Block, ...] = ()
    dictionary: str = field(default=DICTIONARY)

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", tuple(self.markers))
        object.__setattr__(self, "blocks", tuple(self.blocks))
        check_slugs((self.name,), "draft")
        if len(self.tree.trees) != 1:
            trees = "; ".join(", ".join(names) for names in self.tree.trees)
            raise InvalidData(f"nothing connects {len(self.tree.trees)} trees ({trees}); want one tree")
        for joint in self.tree.joints:
            _check_joint(joint)
        self._check_markers()
        for block in self.blocks:
            self.check_part(block.part)

    def _check_markers(self) -> None:
        check_dictionary(self.dictionary)
        for marker in self.markers:
            self.check_part(marker.part)
            if marker.T_part_marker is None:
                raise InvalidData(f"marker {marker.id} has no place on '{marker.part}'; want its T_part_marker")
            check_near(marker.T_part_marker, f"marker {marker.id}")
        if self.markers:
            MarkerTable(self.dictionary, self.markers)

    @property
    def parts(self) -> tuple[str, ...]:
        """The bodies, in the order of the file."""
        return self.tree.bodies

    @property
    def joints(self) -> tuple[Joint, ...]:
        """All joints; each part but the root hangs from one."""
        return self.tree.joints

    def check_part(self, part: str) -> None:
        """Raise InvalidData unless there is a part of that name."""
        if part not in self.parts:
            raise InvalidData(f"there is no part '{part}'; have {', '.join(self.parts)}")

    def joint(self, name: str) -> Joint:
        """The joint of that name; raises InvalidData if there is none."""
        return self.tree.joint(name)

    def joint_above(self, part: str) -> Joint | None:
        """The joint that a part hangs from; None of the root."""
        self.check_part(part)
        return next((joint for joint in self.joints if joint.child == part), None)

    def below(self, part: str) -> tuple[str, ...]:
        """All parts that hang from a part, themselves or by others; not itself."""
        self.check_part(part)
        return tuple(joint.child for joint in self.tree.outward(part))

    def marker(self, marker_id: int) -> Marker:
        """The marker with that id; raises InvalidData if there is none."""
        for marker in self.markers:
            if marker.id == marker_id:
                return marker
        have = ", ".join(str(marker.id) for marker in self.markers) or "none"
        raise InvalidData(f"there is no marker {marker_id}; have {have}")

    def free_id(self) -> int:
        """The least id that no marker has; raises InvalidData where the dictionary has no more."""
        taken = {marker.id for marker in self.markers}
        size = DICTIONARY_SIZES[self.dictionary]
        free = next((candidate for candidate in range(size) if candidate not in taken), None)
        if free is None:
            raise InvalidData(f"all {size} markers of {self.dictionary} are in use; delete some first")
        return free

    def with_joint(self, joint: Joint) -> Draft:
        """The draft with a joint in the place of the one of the same name."""
        self.joint(joint.name)
        joints = tuple(joint if old.name == joint.name else old for old in self.joints)
        return replace(self, tree=replace(self.tree, joints=joints))

    def usual_states(self) -> dict[str, float]:
        """A state by column [rad or m], each as near to 0 as its limits allow."""
        return {
            column: 0.0 if joint.type == "spherical" else min(max(0.0, low), high)
            for joint in self.tree.movable
            for low, high in [limits_of(joint)]
            for column in joint.columns
        }

    def poses(self, states: Mapping[str, float]) -> dict[str, FloatArray]:
        """`T_root_part` (4, 4) by part, for a state of every column."""
        return self.tree.forward(np.array([states[column] for column in self.tree.columns], dtype=np.float64))


def blank(name: str = "draft", root: str = "base") -> Draft:
    """A draft of one part."""
    return Draft(name, KinematicTree(root=root, parts=(root,), rigid_groups=(), trees=((root,),), joints=()))


def drawn_tree(tree: KinematicTree) -> KinematicTree:
    """A tree as a draft has it: without what a fit found out, with limits of all joints.

    Where a tree has no limits the observed range takes their place, else a whole turn, or USUAL_LIMITS.
    """
    bodies = tuple(part for part in tree.parts if part in tree.bodies)
    trees = tree.trees if len(tree.trees) > 1 else (bodies,)
    return replace(tree, trees=trees, joints=tuple(drawn_joint(joint) for joint in tree.joints), method={}, warnings=())


def drawn_joint(joint: Joint) -> Joint:
    """A joint's name, ends, type, geometry and limits alone."""
    return Joint(
        name=joint.name,
        type=joint.type,
        parent=joint.parent,
        child=joint.child,
        axis_parent=joint.axis_parent,
        point_parent_m=joint.point_parent_m,
        T_parent_child_zero=joint.T_parent_child_zero,
        pitch_m_per_rad=joint.pitch_m_per_rad,
        limits=_known_limits(joint),
    )


def limits_of(joint: Joint) -> tuple[float, float]:
    """Limits of a drawn joint; (0, 0) of a rigid one."""
    return (0.0, 0.0) if joint.limits is None else joint.limits


def check_near(T: FloatArray, what: str) -> None:
    """Raise InvalidData unless `T` is a (4, 4) rigid motion to a place no farther away than FARTHEST_DRAWN_M."""
    if T.shape != (4, 4):
        raise InvalidData(f"{what}: the pose has shape {T.shape}; want (4, 4)")
    check_poses(T, what)
    check_close(T[:3, 3], what)


def check_close(p_m: FloatArray, what: str) -> None:
    """Raise InvalidData unless a point is three finite numbers, none farther away than FARTHEST_DRAWN_M."""
    if p_m.shape != (3,) or not np.all(np.abs(p_m) <= FARTHEST_DRAWN_M):
        raise InvalidData(f"{what}: the place is {p_m.tolist()} m; want three numbers up to {FARTHEST_DRAWN_M:g} m")


def _known_limits(joint: Joint) -> tuple[float, float] | None:
    if not joint.kind.states:
        return None
    seen = None if joint.state_min is None or joint.state_max is None else (joint.state_min, joint.state_max)
    for limits in (joint.limits, seen):
        if limits is not None and limits[0] < limits[1]:
            return limits
    return (-np.pi, np.pi) if joint.type == "revolute" else USUAL_LIMITS[joint.type]


def _check_joint(joint: Joint) -> None:
    what = f"joint '{joint.name}'"
    check_close(joint.T_parent_child_zero[:3, 3], what)
    if joint.point_parent_m is not None:
        check_close(joint.point_parent_m, what)
    if joint.pitch_m_per_rad is not None and abs(joint.pitch_m_per_rad) > FARTHEST_DRAWN_M:
        raise InvalidData(f"{what}: the pitch is {joint.pitch_m_per_rad:g} m/rad; want {FARTHEST_DRAWN_M:g} at most")
    if joint.kind.states:
        _check_limits(joint, what)


def _check_limits(joint: Joint, what: str) -> None:
    if joint.limits is None:
        raise InvalidData(f"{what} has no limits; want the least and the largest state of a drawn joint")
    low, high = joint.limits
    have = f"{what}: the limits are {_told(low, joint.unit)} to {_told(high, joint.unit)}"
    if low > high:
        raise InvalidData(f"{have}, the wrong way round; want the lower one first")
    if low == high:
        raise InvalidData(f"{have}, which leaves no room; make the joint rigid if it shall not move")
    if joint.type == "spherical" and low < 0:
        raise InvalidData(f"{have}; those of a ball are of the angle it is turned by, 0 or more")
    most = MOST_TURN_RAD if joint.unit == "rad" else FARTHEST_DRAWN_M
    if max(-low, high) > most:
        raise InvalidData(f"{have}; want {_told(most, joint.unit)} at most to either side")


def _told(value: float, unit: str) -> str:
    return f"{np.degrees(value):.6g} deg" if unit == "rad" else f"{1e3 * value:.6g} mm"


def unused(stem: str, taken: Sequence[str]) -> str:
    """`stem`, or with the first number from 2 on that makes it a new name."""
    names = set(taken)
    return next(name for name in (stem, *(f"{stem}_{n}" for n in range(2, len(names) + 3))) if name not in names)
