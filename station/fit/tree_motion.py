"""Where a tree's parts are, and how they move with each of its numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.skeleton import Skeleton, TreeModel
from station.kinematics import se3
from station.logs import FloatArray

IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class TreePoses:
    """Poses of a tree over T frames.

    Attributes:
        bodies: T_ref_body (T, 4, 4) of each body.
        origins: T_ref_parent @ T_parent_axis of each joint: its axis frame before the motion.
        axes: the same after the motion.
        parts: T_ref_part (T, K, 4, 4).
    """

    bodies: tuple[FloatArray, ...]
    origins: tuple[FloatArray, ...]
    axes: tuple[FloatArray, ...]
    parts: FloatArray


def tree_poses(skeleton: Skeleton, model: TreeModel) -> TreePoses:
    """Poses of a tree's bodies, joints and parts."""
    poses = {0: model.T_ref_root}
    origins: list[FloatArray] = []
    axes: list[FloatArray] = []
    for j, (joint, f) in enumerate(zip(skeleton.joints, model.frames, strict=True)):  # the near ones come first
        M = joint.type.axis_motion(model.q[:, skeleton.state_columns(j)], f.form)
        if joint.turned:
            axis = poses[joint.child] @ se3.inverse(f.T_axis_child)
            origin = axis @ se3.inverse(M)
            poses[joint.parent] = origin @ se3.inverse(f.T_parent_axis)
        else:
            origin = poses[joint.parent] @ f.T_parent_axis
            axis = origin @ M
            poses[joint.child] = axis @ f.T_axis_child
        origins.append(origin)
        axes.append(axis)
    bodies = tuple(poses[body] for body in range(len(poses)))
    parts = np.stack([poses[body] for body in skeleton.body_of], axis=1) @ model.mounts
    return TreePoses(bodies, tuple(origins), tuple(axes), parts)


@dataclass(frozen=True, eq=False)
class Twists:
    """Twists of something by the numbers that move it, and where these are among the columns.

    They are along the reference's axes, about a point of each frame that is near the parts: far from the reference's
    origin their entries stay of one size.

    Attributes:
        by_parameters: (T, 6 + e, n), e numbers that all parts share behind the twist.
        by_states: (T, 6 + e, s).
        parameters: (n,) columns.
        states: (s,) columns.
    """

    by_parameters: FloatArray
    by_states: FloatArray
    parameters: IntArray
    states: IntArray

    def joined(self, other: Twists) -> Twists:
        """These, then the others."""
        return Twists(
            np.concatenate([self.by_parameters, other.by_parameters], axis=-1),
            np.concatenate([self.by_states, other.by_states], axis=-1),
            np.concatenate([self.parameters, other.parameters]),
            np.concatenate([self.states, other.states]),
        )


def root_twists(skeleton: Skeleton, poses: TreePoses, centre: FloatArray) -> Twists:
    """By the root's pose, if it moves, about `centre` (T, 3)."""
    states = np.arange(skeleton.joint_states, skeleton.states, dtype=np.intp)
    twists = _adjoint(poses.bodies[0], centre)[..., : len(states)]
    return Twists(twists[..., :0], twists, np.zeros(0, dtype=np.intp), states)


def joint_twists(skeleton: Skeleton, model: TreeModel, poses: TreePoses, j: int, centre: FloatArray) -> Twists:
    """By a joint's numbers, of all that hangs from it, about `centre` (T, 3).

    For T_parent_child = F M C:  F exp(xi), exp(xi) C and M exp(xi) move the child by Ad(T_ref_parent F),
    Ad(T_ref_child C^-1) and the same; with the child held they move the parent the other way.
    """
    joint, frames = skeleton.joints[j], model.frames[j]
    sign = -1.0 if joint.turned else 1.0
    before, after = sign * _adjoint(np.stack([poses.origins[j], poses.axes[j]]), centre)
    kind, q = joint.type, model.q[:, skeleton.state_columns(j)]
    columns = [before[..., list(kind.axis_freedoms)], after[..., list(kind.child_freedoms)]]
    if kind.form_freedoms:
        columns.append(after @ kind.form_twists(q, frames.form))
    state_twists = kind.state_twists(frames.form)
    by_states = (after.reshape(-1, 6) @ state_twists).reshape(*after.shape[:-1], kind.states)
    return Twists(
        np.concatenate(columns, axis=-1),
        by_states,
        _listed(skeleton.joint_columns(j)),
        _listed(skeleton.state_columns(j)),
    )


def mount_twists(skeleton: Skeleton, poses: TreePoses, part: int, centre: FloatArray) -> Twists:
    """By a part's mount, about `centre` (T, 3)."""
    twists = _adjoint(poses.parts[:, part], centre)
    return Twists(twists, twists[..., :0], _listed(skeleton.mount_columns(part)), np.zeros(0, dtype=np.intp))


def shared_twists(skeleton: Skeleton, frames: int) -> Twists:
    """What all parts share, by itself: it moves nothing, and is told behind the twist."""
    e = skeleton.shared
    by_itself = np.broadcast_to(np.concatenate([np.zeros((6, e)), np.eye(e)]), (frames, 6 + e, e))
    return Twists(by_itself, by_itself[..., :0], _listed(skeleton.shared_columns), np.zeros(0, dtype=np.intp))


def with_shared(twists: Twists, shared: int) -> Twists:
    """The same twists, with zeros for the numbers that all parts share."""
    if not shared:
        return twists

    def longer(of: FloatArray) -> FloatArray:
        return np.concatenate([of, np.zeros((len(of), shared, of.shape[-1]))], axis=1)

    return Twists(longer(twists.by_parameters), longer(twists.by_states), twists.parameters, twists.states)


def _listed(columns: slice) -> IntArray:
    return np.arange(columns.start, columns.stop, dtype=np.intp)


def _adjoint(T_ref_x: FloatArray, centre: FloatArray) -> FloatArray:
    """(..., T, 6, 6) twists about `centre` (T, 3) of right perturbations of poses (..., T, 4, 4)."""
    moved = T_ref_x.copy()
    moved[..., :3, 3] -= centre
    return se3.adjoint(moved)
