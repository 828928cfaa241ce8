"""Normal equations of a tree: parameters, and each frame's states.

A joint moves all parts that hang from it by one twist, told about a common point. So with G_k the whitened derivative
of part k's residual by its twist, and X_a the twists (6, n_a) of the numbers of joint, root or mount a,

    H_ab = sum over frames of X_a^T [ sum of G_k^T G_k over the parts k that both move ] X_b

and the sum in brackets is that of the one that is farther out: zero unless one hangs from the other (the composite
rigid body algorithm; Featherstone, Rigid Body Dynamics Algorithms, chapter 6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.skeleton import Skeleton, TreeModel
from station.fit.tree_data import TreeData
from station.fit.tree_motion import (
    TreePoses,
    Twists,
    joint_twists,
    mount_twists,
    root_twists,
    shared_twists,
    tree_poses,
    with_shared,
)
from station.fit.tree_residuals import Measured, part_jacobians, tree_residuals
from station.logs import FloatArray


@dataclass(frozen=True, eq=False)
class Equations:
    """Second derivatives and gradients of half the weighted squared residuals of T frames.

    Attributes:
        H_pp: (n, n) by parameters, over all frames.
        g_p: (n,).
        H_sp: (T, s, n) by states and parameters.
        H_ss: (T, s, s).
        g_s: (T, s).
    """

    H_pp: FloatArray
    g_p: FloatArray
    H_sp: FloatArray
    H_ss: FloatArray
    g_s: FloatArray


@dataclass(frozen=True, eq=False)
class Moved:
    """What moves the parts of a tree.

    Attributes:
        poses: of the tree.
        centre: (T, 3) point that twists are about.
        joints: twists of each joint's own numbers.
        bodies: twists of each body by all numbers that move it, those of the joint that it hangs from last.
    """

    poses: TreePoses
    centre: FloatArray
    joints: list[Twists]
    bodies: dict[int, Twists]


def moved_by(skeleton: Skeleton, model: TreeModel) -> Moved:
    """Twists of all bodies at a model; what all parts share moves the root, and is told behind its twist."""
    poses = tree_poses(skeleton, model)
    centre = poses.parts[..., :3, 3].mean(axis=1)
    joints = [
        with_shared(joint_twists(skeleton, model, poses, j, centre), skeleton.shared)
        for j in range(len(skeleton.joints))
    ]
    bodies = {0: with_shared(root_twists(skeleton, poses, centre), skeleton.shared)}
    if skeleton.shared:
        bodies[0] = shared_twists(skeleton, len(centre)).joined(bodies[0])
    for joint, twists in zip(skeleton.joints, joints, strict=True):  # the near ones come first
        bodies[joint.far] = bodies[joint.near].joined(twists)
    return Moved(poses, centre, joints, bodies)


def equations(skeleton: Skeleton, model: TreeModel, data: TreeData, weights: FloatArray) -> Equations:
    """Equations at a model; what was measured counts by its weights (T, C)."""
    moved = moved_by(skeleton, model)
    of_parts = data.on_parts(moved.poses.parts, model.shared, moved.centre, weights)
    information, pull = of_parts.information, of_parts.pull
    (frames, K, d), n, s = pull.shape, skeleton.parameters, skeleton.states
    found = Equations(
        np.zeros((n, n)), np.zeros(n), np.zeros((frames, s, n)), np.zeros((frames, s, s)), np.zeros((frames, s))
    )
    root = moved.bodies[0]
    _add(found, root, root, information.sum(axis=1), pull.sum(axis=1))
    beyond = (skeleton.hanging @ information.reshape(frames, K, d * d)).reshape(frames, -1, d, d)
    pull_beyond = skeleton.hanging @ pull
    for j, joint in enumerate(skeleton.joints):
        _add(found, moved.bodies[joint.far], moved.joints[j], beyond[:, j], pull_beyond[:, j])
    for k in np.flatnonzero(skeleton.free_mount).tolist():
        mount = with_shared(mount_twists(skeleton, moved.poses, k, moved.centre), skeleton.shared)
        _add(found, moved.bodies[skeleton.body_of[k]].joined(mount), mount, information[:, k], pull[:, k])
    return found


def _add(found: Equations, all_of_it: Twists, own: Twists, information: FloatArray, pull: FloatArray) -> None:
    """Writes the rows and columns of one joint's, root's or mount's own numbers against all that move it.

    Args:
        found: equations that are being put together.
        all_of_it: twists of what it moves, by all numbers.
        own: by its own, the last of these.
        information: (T, 6 + e, 6 + e) of all the parts that it moves.
        pull: (T, 6 + e) gradient of the same.
    """
    P, S, p, s = all_of_it.by_parameters, all_of_it.by_states, all_of_it.parameters, all_of_it.states
    S_t = np.ascontiguousarray(np.swapaxes(S, -1, -2))
    if own.parameters.size:
        moved = information @ own.by_parameters
        block = P.reshape(-1, len(p)).T @ moved.reshape(-1, len(own.parameters))
        found.H_pp[p[:, None], own.parameters], found.H_pp[own.parameters[:, None], p] = block, block.T
        found.H_sp[:, s[:, None], own.parameters] = S_t @ moved
        found.g_p[own.parameters] = np.einsum("tij,ti->j", own.by_parameters, pull)
    if own.states.size:
        moved = information @ own.by_states
        block = S_t @ moved
        found.H_ss[:, s[:, None], own.states] = block
        found.H_ss[:, own.states[:, None], s] = np.swapaxes(block, -1, -2)
        found.H_sp[:, own.states[:, None], p] = np.ascontiguousarray(np.swapaxes(moved, -1, -2)) @ P
        found.g_s[:, own.states] = (np.swapaxes(own.by_states, -1, -2) @ pull[..., None])[..., 0]


def leverages(
    skeleton: Skeleton, model: TreeModel, measured: Measured, root: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals (T, K, 6), and which share of a unit error in each the frame's own states take up.

    The share is the diagonal of B H_ss^-1 B^T, with B the derivative by the states and R^T R = H_ss^-1, R (T, s, s).
    """
    moved = moved_by(skeleton, model)
    residuals = tree_residuals(measured, moved.poses.parts)
    by_twist = part_jacobians(measured, residuals, moved.poses.parts, moved.centre)
    taken = np.zeros(residuals.whitened.shape)
    for k, body in enumerate(skeleton.body_of):  # parts differ in what moves them
        twists = moved.bodies[body]
        B = by_twist[:, k] @ twists.by_states
        R_t = np.ascontiguousarray(np.swapaxes(root[..., twists.states], -1, -2))
        taken[:, k] = np.sum((B @ R_t) ** 2, axis=-1)
    return residuals.whitened, taken
