"""What of a tree stays fixed while it is fitted, and the numbers that are fitted.

The pose of part k of body b in frame t is

    T_ref_part = T_ref_root(t) @ prod over the joints from the root to b of F_j M_j(q_jt) C_j  @ T_body_part

A joint is told from its parent to its child, as it is named; where the way from the root goes from the child to the
parent, its motion enters inverted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from station.fit.pair_model import frame_twists, moved_frames
from station.kinematics import se3
from station.kinematics.joints import JointFrames, JointType
from station.logs import FloatArray

IntArray = NDArray[np.intp]


def indices(slices: Sequence[slice]) -> IntArray:
    """The numbers in some slices, one slice after another."""
    return np.array([i for piece in slices for i in range(piece.start, piece.stop)], dtype=np.intp)


@dataclass(frozen=True)
class TreeJoint:
    """A joint between two bodies; `turned` if the child is nearer to the root than the parent."""

    parent: int
    child: int
    type: JointType
    turned: bool = False

    @property
    def near(self) -> int:
        """Body towards the root."""
        return self.child if self.turned else self.parent

    @property
    def far(self) -> int:
        """Body that hangs from the joint."""
        return self.parent if self.turned else self.child

    @property
    def parameters(self) -> int:
        """Numbers that are fitted, the same for all frames."""
        return len(self.type.axis_freedoms) + len(self.type.child_freedoms) + self.type.form_freedoms


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints from the root outward, and the body of each part.

    Columns of parameters: the joints', each in the order of `stepped_frames`, then the mounts', then what all parts
    share. Columns of states: the joints', then the root's pose.

    Attributes:
        joints: each hangs from the root or from one before it; body 0 is the root.
        body_of: K bodies.
        free_mount: (K,) whether T_body_part is estimated; the part that gives a body its frame is not.
        root_moves: whether the root has a pose in each frame, or the identity throughout.
        shared: numbers that everything measured depends on, such as those of the camera that measured it.
    """

    joints: tuple[TreeJoint, ...]
    body_of: tuple[int, ...]
    free_mount: tuple[bool, ...]
    root_moves: bool
    shared: int = 0

    @cached_property
    def paths(self) -> tuple[tuple[int, ...], ...]:
        """Joints between the root and each body, from the root."""
        found: dict[int, tuple[int, ...]] = {0: ()}
        for j, joint in enumerate(self.joints):
            found[joint.far] = (*found[joint.near], j)
        return tuple(found[body] for body in range(len(found)))

    @cached_property
    def hanging(self) -> FloatArray:
        """(J, K) 1 for the parts that a joint moves, else 0."""
        found = np.zeros((len(self.joints), len(self.body_of)))
        for k, body in enumerate(self.body_of):
            found[list(self.paths[body]), k] = 1.0
        return found

    def joint_columns(self, j: int) -> slice:
        """Columns of a joint's parameters."""
        sizes = [joint.parameters for joint in self.joints]
        return slice(sum(sizes[:j]), sum(sizes[: j + 1]))

    def mount_columns(self, part: int) -> slice:
        """Columns of a part's mount; none if it is not estimated."""
        start = self.joint_columns(len(self.joints)).start + 6 * sum(self.free_mount[:part])
        return slice(start, start + 6 * self.free_mount[part])

    @property
    def shared_columns(self) -> slice:
        """Columns of what all parts share."""
        return slice(self.parameters - self.shared, self.parameters)

    def state_columns(self, j: int) -> slice:
        """Columns of a joint's states."""
        sizes = [joint.type.states for joint in self.joints]
        return slice(sum(sizes[:j]), sum(sizes[: j + 1]))

    @cached_property
    def coupled(self) -> tuple[tuple[slice, IntArray], ...]:
        """States of each joint, and the parameters of joints and mounts that they are coupled to: of the joints between
        it and the root, of what hangs from it, and what all share. Then the root's pose with all parameters, if it
        moves.
        """
        found = [(self.state_columns(j), self._coupled(j)) for j in range(len(self.joints))]
        if self.root_moves:
            found.append((slice(self.joint_states, self.states), np.arange(self.parameters)))
        return tuple(found)

    def _coupled(self, j: int) -> IntArray:
        inward = self.paths[self.joints[j].far]
        outward = [i for i, joint in enumerate(self.joints) if j in self.paths[joint.far][:-1]]
        mounts = [self.mount_columns(k) for k in np.flatnonzero(self.hanging[j]).tolist()]
        joints = [self.joint_columns(i) for i in sorted((*inward, *outward))]
        return indices([*joints, *mounts, self.shared_columns])

    @cached_property
    def outermost_first(self) -> IntArray:
        """(s,) order of the states: of joints from the outermost inward, then the root's pose."""
        joints = [self.state_columns(j) for j in reversed(range(len(self.joints)))]
        return indices([*joints, slice(self.joint_states, self.states)])

    @property
    def joint_states(self) -> int:
        """Numbers of joints' states in a frame."""
        return self.state_columns(len(self.joints)).start

    @property
    def parameters(self) -> int:
        """Number of columns of parameters."""
        return self.joint_columns(len(self.joints)).start + 6 * sum(self.free_mount) + self.shared

    @property
    def states(self) -> int:
        """Numbers that each frame has of its own: joints' states, then the root's pose."""
        return self.joint_states + 6 * self.root_moves


@dataclass(frozen=True, eq=False)
class TreeModel:
    """Parameters and states.

    Attributes:
        T_ref_root: (T, 4, 4).
        frames: of each joint.
        q: (T, joint states).
        mounts: (K, 4, 4).
        shared: (e,) what all parts share.
    """

    T_ref_root: FloatArray
    frames: tuple[JointFrames, ...]
    q: FloatArray
    mounts: FloatArray
    shared: FloatArray = field(default_factory=lambda: np.zeros(0))

    def take(self, rows: slice | IntArray) -> TreeModel:
        """Some of the frames."""
        return replace(self, T_ref_root=self.T_ref_root[rows], q=self.q[rows])

    def with_states(self, rows: slice | IntArray, other: TreeModel) -> TreeModel:
        """The model with the states of another one in some of the frames."""
        T_ref_root, q = self.T_ref_root.copy(), self.q.copy()
        T_ref_root[rows], q[rows] = other.T_ref_root, other.q
        return replace(self, T_ref_root=T_ref_root, q=q)


def with_parameters(skeleton: Skeleton, model: TreeModel, step: FloatArray) -> TreeModel:
    """The model with its parameters moved by (n,)."""
    steps = [step[skeleton.joint_columns(j)] for j in range(len(skeleton.joints))]
    twists = [frame_twists(joint.type, own) for joint, own in zip(skeleton.joints, steps, strict=True)]
    free = np.flatnonzero(skeleton.free_mount)
    of_mounts = [step[skeleton.mount_columns(k)][None] for k in free.tolist()]
    motions = se3.exp(np.concatenate([np.zeros((0, 6)), *twists, *of_mounts]))  # one call costs as much as one motion
    frames = tuple(
        moved_frames(joint.type, f, motions[2 * j : 2 * j + 2], steps[j])
        for j, (joint, f) in enumerate(zip(skeleton.joints, model.frames, strict=True))
    )
    mounts = model.mounts.copy()
    mounts[free] = mounts[free] @ motions[2 * len(frames) :]
    return replace(model, frames=frames, mounts=mounts, shared=model.shared + step[skeleton.shared_columns])


def with_moved_states(skeleton: Skeleton, model: TreeModel, step: FloatArray) -> TreeModel:
    """The model with its states moved by (T, s)."""
    q = model.q.copy()
    for j, joint in enumerate(skeleton.joints):
        columns = skeleton.state_columns(j)
        q[:, columns] = joint.type.moved(model.q[:, columns], step[:, columns])
    root = model.T_ref_root
    if skeleton.root_moves:
        root = root @ se3.exp(step[:, skeleton.joint_states :])
    return replace(model, T_ref_root=root, q=q)


@dataclass(frozen=True, eq=False)
class Branch:
    """A part of a tree that shares no number with the rest: which joints and parts of the tree, and its skeleton."""

    joints: tuple[int, ...]
    parts: tuple[int, ...]
    skeleton: Skeleton

    def model(self, whole: Skeleton, model: TreeModel) -> TreeModel:
        """The branch's share of the whole tree's numbers."""
        frames = tuple(model.frames[j] for j in self.joints)
        return TreeModel(
            model.T_ref_root, frames, model.q[:, self.state_columns(whole)], model.mounts[list(self.parts)]
        )

    def columns(self, whole: Skeleton) -> IntArray:
        """Where the branch's parameters are among the whole tree's."""
        slices = [whole.joint_columns(j) for j in self.joints] + [whole.mount_columns(k) for k in self.parts]
        return indices(slices)

    def state_columns(self, whole: Skeleton) -> IntArray:
        """Where the states of the branch's joints are among the whole tree's."""
        return indices([whole.state_columns(j) for j in self.joints])


def branches(skeleton: Skeleton) -> tuple[Branch, ...]:
    """What hangs from each joint at a root that stands still, and the root's own parts; one that moves ties all."""
    if skeleton.root_moves:
        return (Branch(tuple(range(len(skeleton.joints))), tuple(range(len(skeleton.body_of))), skeleton),)
    firsts = [j for j, joint in enumerate(skeleton.joints) if joint.near == 0]
    found = [_branch(skeleton, first) for first in firsts]
    at_root = tuple(k for k, body in enumerate(skeleton.body_of) if body == 0)
    if at_root:
        free = tuple(skeleton.free_mount[k] for k in at_root)
        found.append(Branch((), at_root, Skeleton((), (0,) * len(at_root), free, root_moves=False)))
    return tuple(found)


def _branch(skeleton: Skeleton, first: int) -> Branch:
    joints = tuple(j for j, joint in enumerate(skeleton.joints) if first in skeleton.paths[joint.far])
    number = {0: 0} | {skeleton.joints[j].far: i for i, j in enumerate(joints, start=1)}
    parts = tuple(k for k, body in enumerate(skeleton.body_of) if first in skeleton.paths[body])
    inner = tuple(
        replace(skeleton.joints[j], parent=number[skeleton.joints[j].parent], child=number[skeleton.joints[j].child])
        for j in joints
    )
    bodies = tuple(number[skeleton.body_of[k]] for k in parts)
    free = tuple(skeleton.free_mount[k] for k in parts)
    return Branch(joints, parts, Skeleton(inner, bodies, free, root_moves=False))
