"""Spherical: the child turns any way about a point of the parent, as a ball in its socket."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.kinematics.joints.base import (
    BALANCE_M,
    JointFrames,
    JointGeometry,
    JointType,
    mean_rotation,
    weighted_mean,
)
from station.kinematics.joints.closed_forms import SCATTER_FLOOR, round_fit
from station.logs import FloatArray

TURN = 2 * np.pi
# Directions that are opposite to within this have all turns between them about as well: it is rounding's square root.
OPPOSITE_RAD = 1e-8


class Spherical(JointType):
    """fk(r, c; q) = r exp(q) c: r a translation to the centre, q a rotation vector in the parent's axes [rad].

    Three numbers of r, and three of c: where the child's origin is at q = 0. Its orientation there is no parameter, as
    any other changes the states alone. Positions tell the centre and the radius; of the state they don't tell the turn
    about the arm.

    Rotation vectors longer than pi tell how a motion came there, as angles beyond a turn do. At a length of 2 pi all
    directions are one rotation, and small motions may need large changes of the vector: `moved` and the deviations that
    a fit works with are those of the rotation, exp(moved(q, dq)) = exp(q) exp(dq).
    """

    name = "spherical"
    parameters = 6
    position_parameters = 4
    paper_parameters = 9
    states = 3
    position_states = 2
    unit = "rad"
    has_axis = False
    has_point = True
    axis_freedoms = (0, 1, 2)
    child_freedoms = (0, 1, 2)
    usual = 0.1
    simpler = ("revolute",)

    def axis_motion(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 4, 4) rotation by the vector q (..., 3)."""
        return se3.pose(se3.exp_so3(q), np.zeros(3))

    def state_twists(self, form: FloatArray) -> FloatArray:
        """(..., 6, 3) about x, y and z."""
        return np.broadcast_to(np.eye(6)[:, 3:], (*np.shape(form)[:-1], 6, 3))

    def moved(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """(..., 3) log(exp(q) exp(dq)), by the full turn nearest q."""
        return self.nearest_turn(se3.log_so3(se3.exp_so3(q) @ se3.exp_so3(dq)), q)

    def axis_state(self, T_axis_child: FloatArray, zero: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 3) rotation vector, no longer than pi, that brings orientation and position nearest, both weighed."""
        R, p = T_axis_child[..., :3, :3], T_axis_child[..., :3, 3:]
        R_zero, p_zero = zero[..., :3, :3], zero[..., :3, 3:]
        both = BALANCE_M**2 * R @ np.swapaxes(R_zero, -1, -2) + p @ np.swapaxes(p_zero, -1, -2)
        return se3.log_so3(se3.project_to_so3(both))

    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 3) the smallest rotation that takes the direction of `zero_axis` to that of `p_axis`; zero for a
        position in the centre.
        """
        across = np.cross(zero_axis, p_axis)
        sine, cosine = np.linalg.norm(across, axis=-1), np.sum(zero_axis * p_axis, axis=-1)
        any_normal = np.cross(zero_axis, np.eye(3)[np.argmin(np.abs(zero_axis), axis=-1)])
        opposite = sine <= -OPPOSITE_RAD * cosine  # there the cross product's direction is rounding
        normal = np.where(opposite[..., None], any_normal, across)
        length = np.linalg.norm(normal, axis=-1)
        turn = np.arctan2(sine, cosine) / np.where(length > 0, length, 1.0)
        return turn[..., None] * normal

    def continuous(self, q: FloatArray) -> FloatArray:
        """(..., T, 3) the same rotations, each by the vector that goes on from the frame before, also beyond pi.

        A rotation has two quaternions; the one nearer to the last frame's is that of the shorter turn between them, and
        tells a vector up to 2 pi. Beyond, the direction turns round, and the signed angle jumps by two turns. Wrong
        frames may seem to lead through half a turn: if that way is longer than the way of vectors up to pi, it is not
        taken.
        """
        principal = se3.log_so3(se3.exp_so3(q))
        half = 0.5 * np.linalg.norm(q, axis=-1, keepdims=True)
        quaternion = np.concatenate([np.cos(half), 0.5 * q * np.sinc(half / np.pi)], axis=-1)
        lifted = quaternion * _flips(quaternion)
        w, v = lifted[..., :1], lifted[..., 1:]
        sine = np.linalg.norm(v, axis=-1, keepdims=True)
        direction = v / np.where(sine > 0, sine, 1.0)
        sign = _flips(direction)
        angle = np.unwrap(sign * 2 * np.arctan2(sine, w), axis=-2, period=2 * TURN)
        followed = angle * sign * direction
        shorter = _length(followed) <= _length(principal)
        return np.where(shorter, followed, principal)

    def nearest_turn(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """(..., 3) rotation vectors of the same rotations, nearest to other vectors (..., 3)."""
        angle = np.linalg.norm(q, axis=-1, keepdims=True)
        far = np.linalg.norm(near, axis=-1, keepdims=True)
        direction = np.where(angle > 0, q / np.where(angle > 0, angle, 1.0), near / np.where(far > 0, far, 1.0))
        turns = np.rint((np.sum(direction * near, axis=-1, keepdims=True) - angle) / TURN)
        return np.where(turns == 0, q, (angle + TURN * turns) * direction)

    def extent(self, q: FloatArray) -> FloatArray:
        """(...,) angle of the rotation vector, not negative."""
        return np.asarray(np.linalg.norm(q, axis=-1), dtype=np.float64)

    def reversed(
        self, frames: JointFrames, q: FloatArray, dq: FloatArray
    ) -> tuple[JointFrames, FloatArray, FloatArray]:
        """As for every type; exp(q) exp(dq) is undone by exp(-q) exp(-exp(q) dq)."""
        turned, back, _ = super().reversed(frames, q, dq)
        return turned, back, -se3.exp_so3(q) @ dq

    def upright(self, frames: JointFrames, q: FloatArray, dq: FloatArray) -> tuple[JointFrames, FloatArray, FloatArray]:
        """With the parent's axes at the centre, in which the states are then told."""
        T_parent_centre = se3.translation(frames.T_parent_axis[..., :3, 3])
        R = frames.T_parent_axis[..., :3, :3]
        T_centre_child = se3.pose(R, np.zeros(3)) @ frames.T_axis_child
        return JointFrames(T_parent_centre, T_centre_child, frames.form), (R @ q[..., None])[..., 0], R @ dq

    def from_zero(
        self, frames: JointFrames, q: FloatArray, dq: FloatArray, zero: FloatArray
    ) -> tuple[JointFrames, FloatArray, FloatArray]:
        """exp(q) exp(-zero) is the rotation since then."""
        R = se3.exp_so3(zero)
        moved, _, _ = super().from_zero(frames, q, dq, zero)
        return moved, se3.log_so3(se3.exp_so3(q) @ np.swapaxes(R, -1, -2)), R @ dq

    def column_changes(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """(..., 3, k) exp(q + change) = exp(q) exp(dq): by the inverse right Jacobian."""
        return se3.inverse_left_jacobian_so3(-q) @ dq

    def column_information(self, q: FloatArray, information: FloatArray) -> FloatArray:
        """(..., 3, 3) J^T information J with the right Jacobian J."""
        J = se3.left_jacobian_so3(-q)
        return np.swapaxes(J, -1, -2) @ information @ J

    def reversed_states(self, geometry: JointGeometry, q: FloatArray) -> FloatArray:
        """(..., 3) -R_child_parent(0) q: the rotation undone, in the child's axes at q = 0.

        Unlike an axis, a rotation vector can't turn round: minus the identity is no rotation.
        """
        return -q @ geometry.T_parent_child_zero[:3, :3]

    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """The centre by the turns, linear in it; and by a sphere through the positions."""
        R, p = T_parent_child[..., :3, :3], T_parent_child[..., :3, 3]
        share = (weights / weights.sum(axis=-1, keepdims=True))[..., None]
        R_mean, p_mean = np.einsum("...t,...tij->...ij", share[..., 0], R), weighted_mean(p, weights)
        p_child = (np.swapaxes(R, -1, -2) @ p[..., None])[..., 0]  # of the parent's origin, but for its sign
        p_child_mean = weighted_mean(p_child, weights)
        R_mean_t = np.swapaxes(R_mean, -1, -2)
        # p = centre + R arm: with the means taken off, (1 - R_mean^T R_mean) arm = mean(R^T p) - R_mean^T mean(p).
        spread = np.eye(3) - R_mean_t @ R_mean
        arm = _least_squares(spread, p_child_mean - (R_mean_t @ p_mean[..., None])[..., 0])
        centre = p_mean - (R_mean @ arm[..., None])[..., 0]
        R_child = mean_rotation(R, weights)
        by_sphere, _ = round_fit(p, weights)
        arm_of_sphere = p_child_mean - (R_mean_t @ by_sphere[..., None])[..., 0]
        return _frames(centre, R_child, arm), _frames(by_sphere, R_child, arm_of_sphere)

    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """A sphere through the positions; the zero is in the middle of them."""
        centre, radius = round_fit(p_parent, weights)
        middle = weighted_mean(p_parent, weights) - centre
        length = np.linalg.norm(middle, axis=-1, keepdims=True)
        direction = np.where(length > 0, middle / np.where(length > 0, length, 1.0), np.eye(3)[2])
        R_child = np.broadcast_to(np.eye(3), (*centre.shape[:-1], 3, 3))
        return (_frames(centre, R_child, radius[..., None] * direction),)


def _length(q: FloatArray) -> FloatArray:
    """(..., 1, 1) way of vectors (..., T, 3)."""
    return np.linalg.norm(np.diff(q, axis=-2), axis=-1).sum(axis=-1)[..., None, None]


def _flips(v: FloatArray) -> FloatArray:
    """(..., T, 1) signs with which each vector (..., T, n) is within a quarter turn of the one before."""
    against = np.sum(v[..., 1:, :] * v[..., :-1, :], axis=-1, keepdims=True) < 0
    turned = np.cumsum(against, axis=-2) % 2 == 1
    first = np.zeros_like(turned[..., :1, :], shape=(*v.shape[:-2], 1, 1))
    return np.where(np.concatenate([first, turned], axis=-2), -1.0, 1.0)


def _frames(centre: FloatArray, R_parent_child: FloatArray, arm_child: FloatArray) -> JointFrames:
    """Frames of a centre in the parent and an arm from there to the child in the child's axes, (..., 3)."""
    arm = (R_parent_child @ arm_child[..., None])[..., 0]
    return JointFrames.plain(se3.translation(centre), se3.pose(R_parent_child, arm))


def _least_squares(S: FloatArray, b: FloatArray) -> FloatArray:
    """(..., n) S^-1 b of symmetric S (..., n, n); nothing along directions that S does not tell."""
    values, vectors = np.linalg.eigh(S)
    inverse = np.where(values > SCATTER_FLOOR, 1 / np.maximum(values, SCATTER_FLOOR), 0.0)
    along = inverse[..., None] * (np.swapaxes(vectors, -1, -2) @ b[..., None])
    return (vectors @ along)[..., 0]
