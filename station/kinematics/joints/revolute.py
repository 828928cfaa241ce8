"""Revolute: the child turns about an axis of the parent (paper, 22 and 23)."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.kinematics.joints.base import (
    BALANCE_M,
    JointFrames,
    JointType,
    Z,
    mean_rotation,
    weighted_mean,
    weighted_scatter,
    wrapped,
)
from station.kinematics.joints.closed_forms import (
    SCATTER_FLOOR,
    axis_by_turns,
    centre_by_turns,
    circle_about_z,
    frames_along_axis,
    turned_back,
)
from station.logs import FloatArray

# Of a line that is as good as straight.
LEAST_BEND_PER_M = 1e-3


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

    def axis_motion(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 4, 4) rotation about z by q (..., 1) radians."""
        return se3.rotation_z(q[..., 0])

    def moved_axes(self, R_axis: FloatArray, q: FloatArray, form: FloatArray) -> tuple[FloatArray, FloatArray]:
        """R_axis M, entries first; x and y turn, z stays."""
        x, y, z = R_axis[:, 0, :, None], R_axis[:, 1, :, None], R_axis[:, 2, :, None]
        cosine, sine = np.cos(q[..., 0]), np.sin(q[..., 0])
        R = np.empty((3, 3, *q.shape[:-1]))
        R[:, 0], R[:, 1], R[:, 2] = cosine * x + sine * y, cosine * y - sine * x, z
        return R, np.zeros((3, *q.shape[:-1]))

    def state_twists(self, form: FloatArray) -> FloatArray:
        """(..., 6, 1) about z."""
        return np.broadcast_to(np.eye(6)[:, 5:6], (*np.shape(form)[:-1], 6, 1))

    def axis_state(self, T_axis_child: FloatArray, zero: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) radians in (-pi, pi]: the turn about z that brings orientation and position nearest, both weighed.

        Equation 23 takes the orientation alone, which tells the turn badly where the arm is long.
        """
        turn = T_axis_child[..., :3, :3] @ np.swapaxes(zero[..., :3, :3], -1, -2)
        p, p_zero = T_axis_child[..., :2, 3], zero[..., :2, 3]
        across = (
            BALANCE_M**2 * (turn[..., 1, 0] - turn[..., 0, 1]) + p_zero[..., 0] * p[..., 1] - p_zero[..., 1] * p[..., 0]
        )
        along = BALANCE_M**2 * (turn[..., 0, 0] + turn[..., 1, 1]) + np.sum(p_zero * p, axis=-1)
        return np.arctan2(across, along)[..., None]

    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) radians in (-pi, pi] between the two positions, seen along z."""
        turn = np.arctan2(p_axis[..., 1], p_axis[..., 0]) - np.arctan2(zero_axis[..., 1], zero_axis[..., 0])
        return wrapped(turn)[..., None]

    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """Axis from the rotations with the point by a line or a circle fit; plane and circle from the positions; the
        line through the positions, bent by how the rotations change along it.
        """
        R, p = T_parent_child[..., :3, :3], T_parent_child[..., :3, 3]
        R_axis_parent, R_axis_child, q = axis_by_turns(R, weights)
        p_axis = p @ np.swapaxes(R_axis_parent, -1, -2)
        by_turns = frames_along_axis(R_axis_parent, R_axis_child, *centre_by_turns(p_axis, q, weights))
        centre, _ = circle_about_z(p_axis, weights)
        arm = weighted_mean(turned_back(p_axis - centre[..., None, :], q), weights)
        by_circle = frames_along_axis(R_axis_parent, R_axis_child, centre, arm)
        line = weighted_scatter(p, weights)
        return by_turns, by_circle, _by_positions(p, line[1], R, weights), _by_bent_line(p, line, R, weights)

    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """A circle in the plane of the two leading singular vectors of the positions."""
        return (_by_positions(p_parent, weighted_scatter(p_parent, weights)[1], None, weights),)


def _by_positions(p: FloatArray, directions: FloatArray, R: FloatArray | None, weights: FloatArray) -> JointFrames:
    """A circle in the plane of the first two principal directions (..., 3, 3) of positions (..., T, 3)."""
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


def _by_bent_line(
    p: FloatArray, line: tuple[FloatArray, FloatArray], R: FloatArray, weights: FloatArray
) -> JointFrames:
    """An arc that positions don't tell from a line: its curvature is that of the rotations over the way along it.

    With u along the line, s the way and w = d(rotation vector) / ds across u, the radius is 1 / |w|, the axis along w,
    and its point, from u = w x (p - c), at c = p - u x w / |w|^2. `line` is the positions' mean and principal
    directions.
    """
    p_mean, directions = line
    u = directions[..., 0]
    s = np.einsum("...ti,...i->...t", p - p_mean[..., None, :], u)
    R_mean = mean_rotation(R, weights)
    turn = se3.log_so3(R @ np.swapaxes(R_mean, -1, -2)[..., None, :, :])
    way = np.maximum(np.einsum("...t,...t->...", weights, s**2), SCATTER_FLOOR)
    w = np.einsum("...t,...ti->...i", weights * s, turn) / way[..., None]
    w = w - u * np.sum(w * u, axis=-1, keepdims=True)
    bend = np.linalg.norm(w, axis=-1, keepdims=True)
    axis = np.where(bend > LEAST_BEND_PER_M, w / np.maximum(bend, LEAST_BEND_PER_M), directions[..., 2])
    bend = np.maximum(bend, LEAST_BEND_PER_M)
    R_axis_parent = np.swapaxes(se3.rotation_between(Z, axis), -1, -2)
    arm = np.cross(u, axis) / bend
    centre, arm = (np.einsum("...ij,...j->...i", R_axis_parent, x) for x in (p_mean - arm, arm))
    return frames_along_axis(R_axis_parent, R_axis_parent @ R_mean, centre, arm)
