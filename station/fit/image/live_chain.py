"""A known tree as one frame after another is fitted to it: its fixed numbers, and states to start from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.image.corner_data import CornerData
from station.fit.image.views import SOLUTIONS
from station.fit.skeleton import Skeleton, TreeJoint, TreeModel
from station.fit.tree_motion import tree_poses
from station.kinematics import se3
from station.kinematics.joints import JointFrames
from station.kinematics.joints.base import BALANCE_M
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Chain:
    """One tree of a forest; states, of joints from the root outward, then the root's pose.

    Attributes:
        parts: that carry markers.
        skeleton: its joints, bodies and parts; nothing but states is free.
        frames: of the joints.
        mounts: (K, 4, 4) of the parts.
        columns: of the whole tree's states, those of this chain in its order.
    """

    parts: tuple[str, ...]
    skeleton: Skeleton
    frames: tuple[JointFrames, ...]
    mounts: FloatArray
    columns: IntArray

    def model(self, T_ref_root: FloatArray, q: FloatArray) -> TreeModel:
        """The tree in one frame, its root at (4, 4), its states (s,)."""
        return TreeModel(T_ref_root[None], self.frames, q[None], self.mounts)

    def told(self, bodies: set[int]) -> BoolArray:
        """(s,) states of the joints of which both bodies are among these."""
        joints = self.skeleton.joints
        both = [joint.near in bodies and joint.far in bodies for joint in joints]
        return np.repeat(np.array(both, dtype=bool), [joint.type.states for joint in joints])

    def changes(self, q: FloatArray) -> FloatArray:
        """(s, s) changes of the numbers (s,) themselves by changes of the states as `JointType.moved` takes them."""
        found = np.eye(len(q))
        for j, joint in enumerate(self.skeleton.joints):
            own = self.skeleton.state_columns(j)
            found[own, own] = joint.type.column_changes(q[own], found[own, own])
        return found

    def nearest_turn(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """(s,) states told by the full turns that bring them nearest to others."""
        found = q.copy()
        for j, joint in enumerate(self.skeleton.joints):
            own = self.skeleton.state_columns(j)
            found[own] = joint.type.nearest_turn(q[own], near[own])
        return found

    def starts(self, data: CornerData, T_ref_root: FloatArray | None, q: FloatArray) -> Iterator[TreeModel]:
        """Models to start from, by the poses that each marker alone has.

        Args:
            data: of one frame.
            T_ref_root: (4, 4) of a root that is known; None if it isn't.
            q: (s,) states of joints of which nothing is seen.
        """
        solutions = self._solutions(data)
        for root in self._roots(solutions, q) if T_ref_root is None else [T_ref_root]:
            yield self.model(root, self._states(solutions, root, q))

    def _solutions(self, data: CornerData) -> dict[int, FloatArray]:
        """By body that is seen: its poses (n, 4, 4) by the solutions of all its markers, the likelier ones first."""
        found: dict[int, list[FloatArray]] = {}
        for solution in range(SOLUTIONS):
            for marker, T in zip(data.views.marker, data.views.T_ref_part[:, solution], strict=True):
                k = data.part[marker]
                if np.isfinite(T).all():
                    found.setdefault(self.skeleton.body_of[k], []).append(T @ se3.inverse(self.mounts[k]))
        return {body: np.stack(poses) for body, poses in found.items()}

    def _roots(self, solutions: dict[int, FloatArray], q: FloatArray) -> list[FloatArray]:
        """Poses (4, 4) of the root by its own markers; else by the body that is nearest to it."""
        if not solutions:
            return []
        body = min(solutions, key=lambda body: len(self.skeleton.paths[body]))
        at_rest = tree_poses(self.skeleton, self.model(np.eye(4), q)).bodies[body][0]
        return list((solutions[body] @ se3.inverse(at_rest))[:SOLUTIONS])

    def _states(self, solutions: dict[int, FloatArray], root: FloatArray, q: FloatArray) -> FloatArray:
        """(s,) by the solution of each body that its joint comes nearest to; those of bodies unseen stay."""
        bodies, found = {0: root}, q.copy()
        for j, (joint, f) in enumerate(zip(self.skeleton.joints, self.frames, strict=True)):
            columns = self.skeleton.state_columns(j)
            if joint.far in solutions:
                T_axis_child = se3.inverse(bodies[joint.near] @ f.T_parent_axis) @ solutions[joint.far]
                states = joint.type.axis_state(T_axis_child, f.T_axis_child, f.form)
                off = se3.log(se3.inverse(joint.type.axis_motion(states, f.form) @ f.T_axis_child) @ T_axis_child)
                nearest = np.argmin(np.sum(off[:, :3] ** 2, axis=-1) + BALANCE_M**2 * np.sum(off[:, 3:] ** 2, axis=-1))
                found[columns] = joint.type.nearest_turn(states[nearest], q[columns])
            moved = joint.type.axis_motion(found[columns], f.form)
            bodies[joint.far] = bodies[joint.near] @ f.T_parent_axis @ moved @ f.T_axis_child
        return found


def chains_of(tree: KinematicTree, parts: Sequence[str]) -> tuple[Chain, ...]:
    """A tree's chains that have parts with markers; parts whose place on their body nobody knows are left out."""
    known = [part for part in parts if part in tree.bodies or part in tree.mounts]
    found = (_chain(tree, root, known) for root in tree.tree_roots)
    return tuple(chain for chain in found if chain.parts)


def _chain(tree: KinematicTree, root: str, parts: Sequence[str]) -> Chain:
    joints = tuple(tree.outward(root))
    number = {root: 0} | {joint.child: i for i, joint in enumerate(joints, start=1)}
    own = tuple(part for part in parts if tree.body_of(part) in number)
    skeleton = Skeleton(
        joints=tuple(TreeJoint(number[joint.parent], number[joint.child], joint.kind) for joint in joints),
        body_of=tuple(number[tree.body_of(part)] for part in own),
        free_mount=(False,) * len(own),
        root_moves=True,
    )
    columns = [tree.columns.index(column) for joint in joints for column in joint.columns]
    return Chain(
        parts=own,
        skeleton=skeleton,
        frames=tuple(joint.kind.frames(joint.geometry) for joint in joints),
        mounts=np.array([tree.mounts.get(part, np.eye(4)) for part in own]).reshape(-1, 4, 4),
        columns=np.array(columns, dtype=np.intp),
    )
