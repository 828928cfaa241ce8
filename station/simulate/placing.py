"""Where the parts of a moving tree are: PLACEOBJECTS of Algorithm 2, for many times and repeats at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray
from station.simulate.noise import PLANAR

# Dimensionless: how far an axis of a planar object may lean.
PLANAR_TOLERANCE = 1e-9


def place_objects(
    tree: KinematicTree, T_ref_root: FloatArray | Mapping[str, FloatArray], q: FloatArray
) -> dict[str, FloatArray]:
    """Poses of all bodies by chaining the joints from the roots on; PLACEOBJECTS of Algorithm 2.

    Args:
        tree: any.
        T_ref_root: (..., 4, 4) of the root; by its named part where there are several trees.
        q: (..., C) states, as the tree's `columns` say.

    Returns:
        `T_ref_body` (..., 4, 4) by named part.

    Raises:
        InvalidData: for a root without a pose, another number of columns.
    """
    roots = T_ref_root if isinstance(T_ref_root, Mapping) else {tree.root: T_ref_root}
    lost = [root for root in tree.tree_roots if root not in roots]
    if lost:
        raise InvalidData(f"no pose of the root {', '.join(lost)}; have {', '.join(roots)}")
    return {
        body: roots[root] @ T_root_body
        for root in tree.tree_roots
        for body, T_root_body in tree.forward(q, start=root).items()
    }


@dataclass(frozen=True, eq=False)
class Layout:
    """The true tree of what is watched, and which body each of its parts is on.

    Attributes:
        tree: rigid joints folded into rigid groups, as a fit tells them, and virtual trackers in these.
        body: (K,) index into `tree.bodies` of each part.
        mounts: (K, 4, 4) `T_body_part` where it is told: named parts, and bodies that a rigid joint holds.
        near: (K,) index of the part near which a part is mounted at random; its own where its mount is told.
    """

    tree: KinematicTree
    body: np.ndarray
    mounts: FloatArray
    near: np.ndarray

    @property
    def loose(self) -> np.ndarray:
        """(L,) parts that are mounted at random, each after the one that it is near."""
        return np.flatnonzero(self.near != np.arange(len(self.near)))

    def mounted(self, u: FloatArray, nearby_m: float, *, planar: bool) -> FloatArray:
        """(R, K, 4, 4) `T_body_part` for numbers u (R, L, 6) from -1 to 1 of the loose parts, in any orientation."""
        scale = np.repeat([nearby_m, np.pi], 3) * (PLANAR if planar else 1.0)
        v, w = np.split(u * scale, 2, axis=-1)
        T_near_part = se3.pose(se3.exp_so3(w), v)
        T_body_part = np.repeat(self.mounts[None], len(u), axis=0)
        for i, part in enumerate(self.loose):  # over parts: one may be near another
            T_body_part[:, part] = T_body_part[:, self.near[part]] @ T_near_part[:, i]
        return T_body_part


def layout(tree: KinematicTree, inflation: int = 0) -> Layout:
    """What is watched of a tree, with `inflation` virtual trackers near each of its parts (paper, IV-C).

    The members of a rigid group beside its named part are further trackers: where the tree doesn't tell their mounts,
    they too are near it at random. A virtual tracker of `door` is `door_v1`, or the next number that is free.
    """
    anchors, mounts = _anchors(tree)
    taken = set(tree.parts)
    parts, near, groups = list(tree.parts), list(range(len(tree.parts))), {body: [body] for body in anchors}
    body_of = {part: tree.body_of(part) for part in tree.parts}
    for k, part in enumerate(tree.parts):
        if part != body_of[part] and part not in tree.mounts:
            near[k] = tree.parts.index(body_of[part])
    for k, part in enumerate(tree.parts):
        for name in _free_names(part, inflation, taken):
            parts.append(name)
            near.append(k)
            body_of[name] = body_of[part]
    anchor_of = {part: anchors[body_of[part]] for part in parts}
    for part in parts:
        if part != anchor_of[part]:
            groups[anchor_of[part]].append(part)
    told = np.stack([mounts[body_of[part]] @ tree.mounts.get(part, np.eye(4)) for part in parts])
    folded = replace(
        tree,
        root=anchors[tree.root],
        parts=tuple(parts),
        rigid_groups=tuple(tuple(group) for body in tree.bodies if len(group := groups[body]) > 1),
        trees=tuple(tuple(body for body in bodies if anchors[body] == body) for bodies in tree.trees),
        joints=tuple(_folded(joint, anchors, mounts) for joint in tree.joints if joint.kind.states),
        mounts={part: told[k] for k, part in enumerate(parts) if near[k] == k and part != anchor_of[part]},
    )
    index = np.array([folded.bodies.index(anchor_of[part]) for part in parts])
    return Layout(folded, index, told, np.array(near))


def check_planar(tree: KinematicTree) -> None:
    """Raise InvalidData unless a tree moves in planes at right angles to its parts' z axes: a 2D object."""
    for joint in tree.joints:
        what = f"joint '{joint.name}' ({joint.type})"
        if joint.type not in ("rigid", "prismatic", "revolute"):
            raise InvalidData(f"{what} moves in space; a planar object has rigid, prismatic and revolute joints alone")
        if np.abs(joint.T_parent_child_zero[2, :2]).max() > PLANAR_TOLERANCE:
            raise InvalidData(f"{what}: the z axes of parent and child differ; those of a planar object are parallel")
        if joint.axis_parent is None:
            continue
        wrong = joint.axis_parent[:2] if joint.type == "revolute" else joint.axis_parent[2:]
        if np.abs(wrong).max() > PLANAR_TOLERANCE:
            want = "along z" if joint.type == "revolute" else "at right angles to z"
            raise InvalidData(f"{what}: its axis is {_told(joint.axis_parent)}; want one {want} for a planar object")


def _anchors(tree: KinematicTree) -> tuple[dict[str, str], dict[str, FloatArray]]:
    """Of each body the one that it is fixed to by rigid joints, and its pose there; else itself."""
    anchors = {root: root for root in tree.tree_roots}
    mounts = {root: np.eye(4) for root in tree.tree_roots}
    for root in tree.tree_roots:
        for joint in tree.outward(root):
            fixed = not joint.kind.states
            anchors[joint.child] = anchors[joint.parent] if fixed else joint.child
            mounts[joint.child] = mounts[joint.parent] @ joint.T_parent_child_zero if fixed else np.eye(4)
    return anchors, mounts


def _folded(joint: Joint, anchors: Mapping[str, str], mounts: Mapping[str, FloatArray]) -> Joint:
    """A joint told in the frame of the body that its parent is fixed to; the same where it is fixed to none."""
    anchor, T = anchors[joint.parent], mounts[joint.parent]
    if anchor == joint.parent:
        return joint
    point = joint.point_parent_m
    return replace(
        joint,
        parent=anchor,
        axis_parent=None if joint.axis_parent is None else T[:3, :3] @ joint.axis_parent,
        point_parent_m=None if point is None else T[:3, :3] @ point + T[:3, 3],
        T_parent_child_zero=T @ joint.T_parent_child_zero,
    )


def _free_names(part: str, count: int, taken: set[str]) -> list[str]:
    names: list[str] = []
    number = 1
    while len(names) < count:
        name = f"{part}_v{number}"
        if name not in taken:
            names.append(name)
            taken.add(name)
        number += 1
    return names


def _told(axis: FloatArray) -> str:
    return " ".join(f"{x:g}" for x in axis)
