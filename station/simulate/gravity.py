"""What gravity does to the joints of a mechanism."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray

GRAVITY_M_S2 = 9.80665  # CODATA, standard acceleration of gravity
UP = (0.0, 0.0, 1.0)


def gravity_torques(
    tree: KinematicTree,
    q: Mapping[str, ArrayLike],
    masses_kg: Mapping[str, float],
    centres_m: Mapping[str, ArrayLike],
    up: ArrayLike = UP,
) -> dict[str, FloatArray]:
    """Generalised force of gravity on each joint, `-dU/dq`: N m, of a prismatic joint N; (...,) each.

    Of a revolute joint it is the sum of `axis x (c - p) . m g` over the bodies that hang from it, of a prismatic one
    that of `axis . m g`, in the root's frame.

    Args:
        tree: of revolute and prismatic joints; one tree.
        q: joint states (...,) [rad or m] by name, broadcast against each other.
        masses_kg: by body; a body that isn't there weighs nothing.
        centres_m: (3,) centre of mass in the body's own frame, of each body with a mass.
        up: (3,) against gravity, in the root's frame; of unit length.
    """
    poses = tree.forward(q)
    centres = {body: _moved(poses[body], centres_m[body]) for body in tree.bodies if masses_kg.get(body)}
    below, torques = _below(tree), dict[str, FloatArray]()
    for joint in tree.joints:
        torque = np.zeros(poses[joint.parent].shape[:-2])
        for body in sorted(below[joint.child] & centres.keys()):
            force = -masses_kg[body] * GRAVITY_M_S2 * np.asarray(up, np.float64)
            torque = torque + _lever(joint, poses[joint.parent], centres[body]) @ force
        torques[joint.name] = torque
    return torques


def _moved(T: FloatArray, point: ArrayLike) -> FloatArray:
    """(..., 3) a point (3,) in the frame that `T` (..., 4, 4) leads to."""
    return T[..., :3, :3] @ np.asarray(point, np.float64) + T[..., :3, 3]


def _lever(joint: Joint, T_root_parent: FloatArray, centre_m: FloatArray) -> FloatArray:
    """(..., 3) how a point moves with the joint's state, in the root's frame."""
    axis = T_root_parent[..., :3, :3] @ np.asarray(joint.axis_parent)
    if joint.type == "prismatic" or joint.point_parent_m is None:
        return axis
    return np.cross(axis, centre_m - _moved(T_root_parent, joint.point_parent_m))


def _below(tree: KinematicTree) -> dict[str, set[str]]:
    """Each body with all that hang from it."""
    below = {body: {body} for body in tree.bodies}
    for joint in reversed(tuple(tree.outward(tree.root))):
        below[joint.parent] |= below[joint.child]
    return below
