"""Prismatic: the child slides along a direction of the parent (paper, 20 and 21)."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.kinematics.joints.base import JointFrames, JointType, Z, mean_rotation, turned, weighted_scatter
from station.logs import FloatArray


class Prismatic(JointType):
    """fk(o, u; q) = T(q u) o: six parameters of o, two of u, less one for where zero is.

    The state is u . (t_x - t_o). The paper's (21) takes the translation of x o^-1, which is the same for a pose on
    the joint's manifold but lets an error of orientation, times the distance to the parent's origin, into the state
    of a noisy one.
    """

    name = "prismatic"
    parameters = 7
    position_parameters = 4
    paper_parameters = 9
    states = 1
    position_states = 1
    unit = "m"
    has_axis = True
    has_point = False
    axis_freedoms = (3, 4)
    child_freedoms = (0, 1, 3, 4, 5)

    def axis_motion(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 4, 4) translation along z by q (..., 1) metres."""
        T = se3.identity(*np.shape(q)[:-1])
        T[..., 2, 3] = q[..., 0]
        T[np.isnan(q[..., 0])] = np.nan
        return T

    def moved_axes(self, R_axis: FloatArray, q: FloatArray, form: FloatArray) -> tuple[FloatArray, FloatArray]:
        """R_axis M, entries first; it moves along z and does not turn."""
        R = np.empty((3, 3, *q.shape[:-1]))
        R[...] = R_axis[..., None]
        return R, R_axis[:, 2, :, None] * q[..., 0]

    def state_twists(self, form: FloatArray) -> FloatArray:
        """(..., 6, 1) along z."""
        return np.broadcast_to(np.eye(6)[:, 2:3], (*np.shape(form)[:-1], 6, 1))

    def axis_state(self, T_axis_child: FloatArray, zero: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) metres along z from `zero`."""
        return (T_axis_child[..., 2, 3] - zero[..., 2, 3])[..., None]

    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) metres along z from `zero_axis`."""
        return (p_axis[..., 2] - zero_axis[..., 2])[..., None]

    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """The mean rotation, and the line through the translations along their leading singular vector."""
        (line,) = self.position_starts(T_parent_child[..., :3, 3], weights)
        R = mean_rotation(T_parent_child[..., :3, :3], weights)
        return (JointFrames.plain(line.T_parent_axis, se3.pose(turned(line.T_parent_axis) @ R, np.zeros(3))),)

    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """The line through the mean position along the leading singular vector of the positions."""
        centre, directions = weighted_scatter(p_parent, weights)
        T_parent_axis = se3.pose(se3.rotation_between(Z, directions[..., 0]), centre)
        return (JointFrames.plain(T_parent_axis, se3.pose(turned(T_parent_axis), np.zeros(3))),)
