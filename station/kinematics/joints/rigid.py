"""Rigid: the child is fixed to the parent (paper, 18 and 19)."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.kinematics.joints.base import JointFrames, JointType, mean_rotation, weighted_mean
from station.logs import FloatArray


class Rigid(JointType):
    """fk(o) = o, six parameters, no state."""

    name = "rigid"
    parameters = 6
    position_parameters = 3
    paper_parameters = 6
    states = 0
    position_states = 0
    unit = None
    has_axis = False
    has_point = False
    axis_freedoms = ()
    child_freedoms = (0, 1, 2, 3, 4, 5)

    def axis_motion(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 4, 4) identities."""
        return se3.identity(*np.shape(q)[:-1])

    def moved_axes(self, R_axis: FloatArray, q: FloatArray, form: FloatArray) -> tuple[FloatArray, FloatArray]:
        """R_axis M, entries first: R_axis."""
        R = np.empty((3, 3, *q.shape[:-1]))
        R[...] = R_axis[..., None]
        return R, np.zeros((3, *q.shape[:-1]))

    def state_twists(self, form: FloatArray) -> FloatArray:
        """(..., 6, 0)."""
        return np.zeros((*np.shape(form)[:-1], 6, 0))

    def axis_state(self, T_axis_child: FloatArray, zero: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 0): none (paper, 19)."""
        return np.zeros((*np.broadcast_shapes(T_axis_child.shape, zero.shape)[:-2], 0))

    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 0): none."""
        return np.zeros((*np.broadcast_shapes(p_axis.shape, zero_axis.shape)[:-1], 0))

    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """The mean pose: chordal mean of the rotations, mean of the translations."""
        R = mean_rotation(T_parent_child[..., :3, :3], weights)
        t = weighted_mean(T_parent_child[..., :3, 3], weights)
        return (JointFrames.plain(se3.identity(*t.shape[:-1]), se3.pose(R, t)),)

    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """The mean position."""
        t = weighted_mean(p_parent, weights)
        return (JointFrames.plain(se3.identity(*t.shape[:-1]), se3.translation(t)),)
