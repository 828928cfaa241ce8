"""Edits of a draft's parts and joints: each gives a new draft, or raises InvalidData and nothing has changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from station.builder.draft import USUAL_LIMITS, Draft, drawn_joint, unused
from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint, KinematicTree
from station.logs import SLUG, FloatArray

# Of a part that nobody has named, and of the joint above a part.
NEW_PART = "part"
JOINT_SUFFIX = "_joint"
# Metres. New parts stand beside their parent's other children: above it, then to its sides in turn, then farther out.
SPACING_M = 0.25
PLACES = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0))
USUAL_PITCH_M_PER_RAD = 0.01
Z = np.array([0.0, 0.0, 1.0])


def unused_name(draft: Draft, stem: str = NEW_PART) -> str:
    """A name for a new part that no part has yet."""
    return unused(stem, draft.tree.parts)


def add_part(draft: Draft, name: str | None = None, parent: str | None = None, type: str = "revolute") -> Draft:
    """The draft with a new part.

    Args:
        draft: that it joins.
        name: a slug; a new one if None.
        parent: that it hangs from; the root if None.
        type: of its joint, about or along z, named after the part.

    Raises:
        InvalidData: for a name that is taken or no slug, a parent that isn't there, an unknown type.
    """
    part = unused_name(draft) if name is None else name
    above = draft.tree.root if parent is None else parent
    check_new_name(part, draft.tree.parts, "part")
    draft.check_part(above)
    joint = unused(part + JOINT_SUFFIX, [each.name for each in draft.joints])
    new = _typed(Joint(joint, "rigid", above, part, None, None, se3.translation(_free_place(draft, above))), type)
    tree = draft.tree
    trees = ((*draft.parts, part),)
    return replace(draft, tree=replace(tree, parts=(*tree.parts, part), trees=trees, joints=(*tree.joints, new)))


def rename_part(draft: Draft, part: str, new: str) -> Draft:
    """The draft with another name for a part; a joint still named after it follows.

    Raises:
        InvalidData: for a part that isn't there, a name that is taken or no slug.
    """
    draft.check_part(part)
    if new == part:
        return draft
    check_new_name(new, draft.tree.parts, "part")

    def named(name: str) -> str:
        return new if name == part else name

    tree = _renamed(draft.tree, named)
    above, joint = draft.joint_above(part), new + JOINT_SUFFIX
    if above is not None and above.name == part + JOINT_SUFFIX and joint not in [each.name for each in tree.joints]:
        tree = _with_joint_name(tree, above.name, joint)
    markers = tuple(replace(marker, part=named(marker.part)) for marker in draft.markers)
    blocks = tuple(replace(block, part=named(block.part)) for block in draft.blocks)
    return replace(draft, tree=tree, markers=markers, blocks=blocks)


def rename_joint(draft: Draft, joint: str, new: str) -> Draft:
    """The draft with another name for a joint.

    Raises:
        InvalidData: for a joint that isn't there, a name that is taken or no slug.
    """
    draft.joint(joint)
    if new == joint:
        return draft
    check_new_name(new, [each.name for each in draft.joints], "joint")
    return replace(draft, tree=_with_joint_name(draft.tree, joint, new))


def delete_part(draft: Draft, part: str) -> Draft:
    """The draft without a part, its markers and its boxes; its children hang on its parent and stay where they are.

    They stay at the place that they have with all joints at 0.

    Raises:
        InvalidData: for a part that isn't there, and for the root.
    """
    above = _above(draft, part, "delete")
    orphans = [joint.child for joint in draft.joints if joint.parent == part]
    for orphan in orphans:
        draft = set_parent(draft, orphan, above.parent)
    return _without(draft, (part,))


def delete_branch(draft: Draft, part: str) -> Draft:
    """The draft without a part and all that hangs from it.

    Raises:
        InvalidData: for a part that isn't there, and for the root.
    """
    _above(draft, part, "delete")
    return _without(draft, (part, *draft.below(part)))


def set_parent(draft: Draft, part: str, parent: str) -> Draft:
    """The draft with a part on another parent; it and its axis stay where they are with all joints at 0.

    Raises:
        InvalidData: for parts that aren't there, the root, and a parent that hangs from the part itself: a loop.
    """
    draft.check_part(parent)
    above = _above(draft, part, "hang on another")
    if parent == above.parent:
        return draft
    if parent == part:
        raise InvalidData(f"'{part}' can't hang from itself; choose another part")
    if parent in draft.below(part):
        raise InvalidData(
            f"'{part}' can't hang from '{parent}', which hangs from '{part}': that is a loop; choose a part above it"
        )
    T_root = draft.tree.forward(np.zeros(len(draft.tree.columns)))
    T_new_old = se3.inverse(T_root[parent]) @ T_root[above.parent]
    return draft.with_joint(moved_joint(replace(above, parent=parent), T_new_old))


def set_root(draft: Draft, part: str) -> Draft:
    """The draft told from another part: the joints on the way there are turned round, all moves as before.

    Raises:
        InvalidData: for a part that isn't there.
    """
    draft.check_part(part)
    tree = draft.tree.rerooted(part)
    return replace(draft, tree=replace(tree, joints=tuple(drawn_joint(joint) for joint in tree.joints)))


def set_type(draft: Draft, joint: str, type: str) -> Draft:
    """The draft with another type of a joint. What the new type has, and the old one had, stays: axis, point, limits.

    A joint without an axis gets the child's z, one without a point the child's place with the joint at 0.

    Raises:
        InvalidData: for a joint that isn't there and an unknown type.
    """
    old = draft.joint(joint)
    return draft if type == old.type else draft.with_joint(_typed(old, type))


def set_limits(draft: Draft, joint: str, low: float, high: float) -> Draft:
    """The draft with other limits [rad or m] of a joint; of a spherical one, of the angle that it is turned by.

    Raises:
        InvalidData: for a joint that isn't there or doesn't move, and limits that are reversed, leave no room or are no
            numbers.
    """
    old = draft.joint(joint)
    if not old.kind.states:
        raise InvalidData(f"joint '{joint}' is rigid: it doesn't move and has no limits; choose another type first")
    if not np.all(np.isfinite([low, high])):
        raise InvalidData(f"joint '{joint}': limits from {low} to {high}; want two numbers")
    if low > high:
        raise InvalidData(f"joint '{joint}': the lower limit is above the upper one; enter the smaller number first")
    return draft.with_joint(replace(old, limits=(float(low), float(high))))


def set_pitch(draft: Draft, joint: str, pitch_m_per_rad: float) -> Draft:
    """The draft with another pitch of a screw; raises InvalidData for any other joint and what is no number."""
    old = draft.joint(joint)
    if old.type != "screw":
        raise InvalidData(f"joint '{joint}' is {old.type}; only a screw has a pitch")
    return draft.with_joint(replace(old, pitch_m_per_rad=float(pitch_m_per_rad)))


def moved_joint(joint: Joint, T_new_old: FloatArray) -> Joint:
    """A joint, axis and zero pose alike, taken to another frame of its parent, or moved within it."""
    axis = None if joint.axis_parent is None else T_new_old[:3, :3] @ joint.axis_parent
    point = None if joint.point_parent_m is None else T_new_old[:3, :3] @ joint.point_parent_m + T_new_old[:3, 3]
    return replace(
        joint,
        axis_parent=None if axis is None else axis / np.linalg.norm(axis),
        point_parent_m=point,
        T_parent_child_zero=upright(T_new_old @ joint.T_parent_child_zero),
    )


def upright(T: FloatArray) -> FloatArray:
    """A (4, 4) pose freed of the rounding of many edits: its rotation is one again, its last row 0 0 0 1."""
    return se3.pose(se3.project_to_so3(T[:3, :3]), T[:3, 3])


def check_new_name(name: str, taken: Sequence[str], what: str) -> None:
    """Raise InvalidData for a name that is no slug or is taken."""
    if not SLUG.fullmatch(name):
        example = f", such as '{_slug(name)}'" if _slug(name) else ""
        raise InvalidData(f"'{name}' is no name for a {what}; want lower case letters, digits and _{example}")
    if name in taken:
        raise InvalidData(f"there is a {what} '{name}' already; choose another name")


def _slug(name: str) -> str:
    letters = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name.lower())
    return letters.lstrip("_0123456789").rstrip("_")


def _above(draft: Draft, part: str, what: str) -> Joint:
    """The joint that a part hangs from; raises InvalidData for the root, which has none."""
    joint = draft.joint_above(part)
    if joint is None:
        raise InvalidData(
            f"'{part}' is the root, all else hangs from it; to {what} it, make another part the root first"
        )
    return joint


def _without(draft: Draft, gone: Sequence[str]) -> Draft:
    """The draft without some parts, further trackers on them, and what is on them; no joint of others may need them."""
    tree = draft.tree
    lost = {*gone, *(name for group in tree.rigid_groups if set(gone) & set(group) for name in group)}
    kept = replace(
        tree,
        parts=tuple(name for name in tree.parts if name not in lost),
        rigid_groups=tuple(group for group in tree.rigid_groups if not set(group) & lost),
        trees=(tuple(name for name in draft.parts if name not in lost),),
        joints=tuple(joint for joint in tree.joints if joint.child not in lost),
        mounts={name: T for name, T in tree.mounts.items() if name not in lost},
    )
    markers = tuple(marker for marker in draft.markers if marker.part not in lost)
    return replace(
        draft, tree=kept, markers=markers, blocks=tuple(block for block in draft.blocks if block.part not in lost)
    )


def _renamed(tree: KinematicTree, named: Callable[[str], str]) -> KinematicTree:
    return replace(
        tree,
        root=named(tree.root),
        parts=tuple(map(named, tree.parts)),
        rigid_groups=tuple(tuple(map(named, group)) for group in tree.rigid_groups),
        trees=tuple(tuple(map(named, names)) for names in tree.trees),
        joints=tuple(replace(joint, parent=named(joint.parent), child=named(joint.child)) for joint in tree.joints),
        mounts={named(name): T for name, T in tree.mounts.items()},
    )


def _with_joint_name(tree: KinematicTree, old: str, new: str) -> KinematicTree:
    return replace(
        tree, joints=tuple(replace(joint, name=new) if joint.name == old else joint for joint in tree.joints)
    )


def _free_place(draft: Draft, parent: str) -> FloatArray:
    """(3,) where none of the parent's children is yet, in its frame."""
    siblings = sum(joint.parent == parent for joint in draft.joints)
    rounds, place = divmod(siblings, len(PLACES))
    return SPACING_M * (1 + rounds) * np.array(PLACES[place])


def _typed(joint: Joint, type: str) -> Joint:
    """The joint as another type: what both have stays, what only the new one has is as usual."""
    if type not in JOINT_TYPES:
        raise InvalidData(f"'{type}' is no type of joint; choose one of {', '.join(JOINT_TYPES)}")
    kind = JOINT_TYPES[type]
    zero = joint.T_parent_child_zero
    axis = zero[:3, :3] @ Z if joint.axis_parent is None else joint.axis_parent
    point = zero[:3, 3] if joint.point_parent_m is None else joint.point_parent_m
    # A ball's limits are of an angle that is never negative: another thing than those of a hinge.
    same = kind.unit == joint.kind.unit and kind.states == joint.kind.states
    return Joint(
        name=joint.name,
        type=type,
        parent=joint.parent,
        child=joint.child,
        axis_parent=axis / np.linalg.norm(axis) if kind.has_axis else None,
        point_parent_m=point if kind.has_point else None,
        T_parent_child_zero=zero,
        pitch_m_per_rad=USUAL_PITCH_M_PER_RAD if kind.form_freedoms else None,
        limits=(joint.limits if same else USUAL_LIMITS[type]) if kind.states else None,
    )
