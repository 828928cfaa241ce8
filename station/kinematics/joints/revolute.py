"""Revolute: the child turns about an axis of the parent (paper, 22 and 23)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.kinematics import se3
from station.kinematics.joints.base import (
    JointFrames,
    JointType,
    Z,
    mean_rotation,
    weighted_mean,
    weighted_scatter,
    wrapped,
)
from station.kinematics.joints.closed_forms import (
    axis_by_turns,
    centre_by_turns,
    circle_about_z,
    frames_along_axis,
    turned_back,
    turns_about_z,
)
from station.logs import FloatArray

# A hinge this far off that turned by less than this is a straight slide, bent by the slide and by the tracker's
# systematic errors: on eight real drawers tracked to 2 mm, hinges fit at 3.9 m and beyond with up to 6.8 deg; real
# doors at 0.3-0.6 m.
FAR_HINGE_M = 1.5
STRAIGHT_TURN_RAD = np.radians(8.0)


class Revolute(JointType):
    """fk(c, r; q) = r R_z(q) c: twelve parameters, less a turn and a shift along z of r against c, and where zero is.

    Algorithm 1 (lines 12-16) starts from the circumcentre of three positions. That is the axis position in the
    parent, so with the order of (22) it starts r and not c, and it fails for a child on the axis; the starts here do
    not.
    """

    name = "revolute"
    parameters = 9
    position_parameters = 6
    paper_parameters = 12
    states = 1
    position_states = 1
    unit = "rad"
    has_axis = True
    has_point = True
    axis_freedoms = (0, 1, 3, 4)
    child_freedoms = (0, 1, 2, 3, 4)
    limit = "prismatic"

    def is_degenerate(self, frames: JointFrames, travel: FloatArray) -> NDArray[np.bool_]:
        """(...,) whether the arc is as good as straight."""
        radius = np.hypot(frames.T_axis_child[..., 0, 3], frames.T_axis_child[..., 1, 3])
        return (radius > FAR_HINGE_M) & (np.abs(travel) < STRAIGHT_TURN_RAD)

    def axis_motion(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 4, 4) rotation about z by q (..., 1) radians."""
        T = se3.identity(*np.shape(q)[:-1])
        T[..., 0, 0] = T[..., 1, 1] = np.cos(q[..., 0])
        T[..., 1, 0] = np.sin(q[..., 0])
        T[..., 0, 1] = -T[..., 1, 0]
        T[np.isnan(q[..., 0])] = np.nan
        return T

    def state_twists(self, form: FloatArray) -> FloatArray:
        """(..., 6, 1) about z."""
        return np.broadcast_to(np.eye(6)[:, 5:6], (*np.shape(form)[:-1], 6, 1))

    def axis_state(self, T_axis_child: FloatArray, zero: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) radians in (-pi, pi]: the turn about z nearest to the relative rotation (paper, 23)."""
        return turns_about_z(T_axis_child[..., :3, :3], zero[..., :3, :3])[..., None]

    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) radians in (-pi, pi] between the two positions, seen along z."""
        turn = np.arctan2(p_axis[..., 1], p_axis[..., 0]) - np.arctan2(zero_axis[..., 1], zero_axis[..., 0])
        return wrapped(turn)[..., None]

    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """Axis from the rotations with the point by a line or a circle fit; and plane and circle from the positions."""
        R, p = T_parent_child[..., :3, :3], T_parent_child[..., :3, 3]
        R_axis_parent, R_axis_child, q = axis_by_turns(R, weights)
        p_axis = p @ np.swapaxes(R_axis_parent, -1, -2)
        by_turns = frames_along_axis(R_axis_parent, R_axis_child, *centre_by_turns(p_axis, q, weights))
        centre, _ = circle_about_z(p_axis, weights)
        arm = weighted_mean(turned_back(p_axis - centre[..., None, :], q), weights)
        by_circle = frames_along_axis(R_axis_parent, R_axis_child, centre, arm)
        return by_turns, by_circle, self._by_positions(p, R, weights)

    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """A circle in the plane of the two leading singular vectors of the positions."""
        return (self._by_positions(p_parent, None, weights),)

    def _by_positions(self, p: FloatArray, R: FloatArray | None, weights: FloatArray) -> JointFrames:
        _, directions = weighted_scatter(p, weights)
        R_axis_parent = np.swapaxes(se3.rotation_between(Z, directions[..., 2]), -1, -2)
        p_axis = p @ np.swapaxes(R_axis_parent, -1, -2)
        centre, radius = circle_about_z(p_axis, weights)
        p_axis = p_axis - centre[..., None, :]
        arm = np.stack([radius, 0 * radius, 0 * radius], axis=-1)
        if R is None:
            return frames_along_axis(R_axis_parent, R_axis_parent, centre, arm)
        q = np.arctan2(p_axis[..., 1], p_axis[..., 0])
        back = np.swapaxes(se3.rotation_z(q)[..., :3, :3], -1, -2) @ R_axis_parent[..., None, :, :] @ R
        return frames_along_axis(R_axis_parent, mean_rotation(back, weights), centre, arm)
