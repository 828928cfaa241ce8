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
)
from station.logs import FloatArray

# Share of the scatter: below this a circle's normal equations, or the spread of the angles, tell nothing.
SCATTER_FLOOR = 1e-12
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
        R = T_axis_child[..., :3, :3] @ np.swapaxes(zero[..., :3, :3], -1, -2)
        return np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1])[..., None]

    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) radians in (-pi, pi] between the two positions, seen along z."""
        turn = np.arctan2(p_axis[..., 1], p_axis[..., 0]) - np.arctan2(zero_axis[..., 1], zero_axis[..., 0])
        return np.arctan2(np.sin(turn), np.cos(turn))[..., None]

    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """Axis from the rotations with the point by a line or a circle fit; and plane and circle from the positions."""
        R, p = T_parent_child[..., :3, :3], T_parent_child[..., :3, 3]
        U, _, Vt = np.linalg.svd(np.einsum("...t,...tij->...ij", weights, R))
        R_axis_parent = np.swapaxes(se3.rotation_between(Z, U[..., :, 0]), -1, -2)
        R_axis_child = se3.rotation_between(Vt[..., 0, :], Z)
        turns = se3.pose(R_axis_parent[..., None, :, :] @ R, np.zeros(3))
        q = self.axis_state(turns, _at_origin(R_axis_child), np.zeros(0))[..., 0]
        p_axis = p @ np.swapaxes(R_axis_parent, -1, -2)
        by_turns = _frames(R_axis_parent, R_axis_child, *_centre_by_turns(p_axis, q, weights))
        centre, _ = _fit_circle(p_axis, weights)
        arm = weighted_mean(_turned_back(p_axis - centre[..., None, :], q), weights)
        return by_turns, _frames(R_axis_parent, R_axis_child, centre, arm), self._by_positions(p, R, weights)

    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """A circle in the plane of the two leading singular vectors of the positions."""
        return (self._by_positions(p_parent, None, weights),)

    def _by_positions(self, p: FloatArray, R: FloatArray | None, weights: FloatArray) -> JointFrames:
        _, directions = weighted_scatter(p, weights)
        R_axis_parent = np.swapaxes(se3.rotation_between(Z, directions[..., 2]), -1, -2)
        p_axis = p @ np.swapaxes(R_axis_parent, -1, -2)
        centre, radius = _fit_circle(p_axis, weights)
        p_axis = p_axis - centre[..., None, :]
        arm = np.stack([radius, 0 * radius, 0 * radius], axis=-1)
        if R is None:
            return _frames(R_axis_parent, R_axis_parent, centre, arm)
        q = np.arctan2(p_axis[..., 1], p_axis[..., 0])
        turned_back = np.swapaxes(se3.rotation_z(q)[..., :3, :3], -1, -2) @ R_axis_parent[..., None, :, :] @ R
        return _frames(R_axis_parent, mean_rotation(turned_back, weights), centre, arm)


def _at_origin(R: FloatArray) -> FloatArray:
    return se3.pose(R, np.zeros(3))[..., None, :, :]


def _frames(R_axis_parent: FloatArray, R_axis_child: FloatArray, centre: FloatArray, arm: FloatArray) -> JointFrames:
    """Frames of a joint whose centre and arm (..., 3) are given along the axis frame's directions."""
    R_parent_axis = np.swapaxes(R_axis_parent, -1, -2)
    T_parent_axis = se3.pose(R_parent_axis, (R_parent_axis @ centre[..., None])[..., 0])
    return JointFrames.plain(T_parent_axis, se3.pose(R_axis_child, arm))


def _turned_back(p: FloatArray, q: FloatArray) -> FloatArray:
    """Points (..., T, 3) turned by -q (..., T) about z."""
    c, s = np.cos(q), np.sin(q)
    return np.stack([c * p[..., 0] + s * p[..., 1], c * p[..., 1] - s * p[..., 0], p[..., 2]], axis=-1)


def _centre_by_turns(p: FloatArray, q: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre and arm (..., 3) with p = centre + R_z(q) arm in the least squares sense; linear, also for an arm of
    zero length.

    In the plane, with complex numbers: z = a + exp(i q) b, a line fit. Along z all goes to the centre.
    """
    z, turn = p[..., 0] + 1j * p[..., 1], np.exp(1j * q)
    share = weights / weights.sum(axis=-1, keepdims=True)
    z_mean, turn_mean = (share * z).sum(axis=-1), (share * turn).sum(axis=-1)
    d = turn - turn_mean[..., None]
    spread = np.maximum((share * np.abs(d) ** 2).sum(axis=-1), SCATTER_FLOOR)
    b = (share * np.conj(d) * (z - z_mean[..., None])).sum(axis=-1) / spread
    a = z_mean - b * turn_mean
    height = (share * p[..., 2]).sum(axis=-1)
    return np.stack([a.real, a.imag, height], axis=-1), np.stack([b.real, b.imag, 0 * height], axis=-1)


def _fit_circle(p: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (..., 3) and radius (...,) of a circle through points (..., T, 3) seen along z; centre's z is the mean.

    Hyper fit (Al-Sharadqah and Chernov, 2009), which has no bias to second order, so that short arcs keep their
    radius: the algebraic circle A r^2 + B x + C y + D = 0 by a generalised eigenvector, here as a linear problem
        solved in closed form.
    """
    mean = weighted_mean(p, weights)
    xy = (p - mean[..., None, :])[..., :2]
    share = weights / weights.sum(axis=-1, keepdims=True)
    square = np.sum(xy**2, axis=-1)
    scale = np.sqrt(np.maximum((share * square).sum(axis=-1), SCATTER_FLOOR))
    xy, square = xy / scale[..., None, None], square / scale[..., None] ** 2
    rows = np.stack([square, xy[..., 0], xy[..., 1], np.ones_like(square)], axis=-1)
    M: FloatArray = np.einsum("...t,...ti,...tj->...ij", share, rows, rows)
    N = np.zeros_like(M)
    N[..., 0, 0] = 8 * M[..., 0, 3]  # Hyper's constraint matrix, for points with zero mean
    N[..., 0, 3] = N[..., 3, 0] = 2.0
    N[..., 1, 1] = N[..., 2, 2] = 1.0
    # N a = (1 / eta) M a with the smallest eta > 0, made symmetric by M = L L^T: the last of the ascending eigenvalues.
    root = np.linalg.inv(np.linalg.cholesky(M + SCATTER_FLOOR * np.eye(4)))
    _, vectors = np.linalg.eigh(root @ N @ np.swapaxes(root, -1, -2))
    algebraic = (np.swapaxes(root, -1, -2) @ vectors[..., -1:])[..., 0]
    bend, B, C, D = (algebraic[..., i] for i in range(4))
    A = np.where(np.abs(bend) > SCATTER_FLOOR, bend, SCATTER_FLOOR)
    x, y = -B / (2 * A), -C / (2 * A)
    radius = np.sqrt(np.maximum(x**2 + y**2 - D / A, 0.0))
    centre = mean + scale[..., None] * np.stack([x, y, 0 * x], axis=-1)
    return centre, radius * scale
