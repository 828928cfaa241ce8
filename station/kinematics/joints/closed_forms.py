"""Closed forms that several joint types start from: circles, spheres, an axis told by turns, a centre told by turns."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.kinematics.joints.base import JointFrames, Z, weighted_mean
from station.logs import FloatArray

# Share of the scatter: below this a circle's normal equations, or the spread of the angles, tell nothing.
SCATTER_FLOOR = 1e-12


def axis_by_turns(R: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The axis about which rotations R_parent_child (..., T, 3, 3) turn, by the mean rotation matrix.

    R_t = R_parent_axis R_z(q_t) R_axis_child: the mean leaves the axis alone, which so has the leading singular value.

    Returns:
        R_axis_parent (..., 3, 3), R_axis_child (..., 3, 3) and the turns q (..., T) in (-pi, pi].
    """
    U, _, Vt = np.linalg.svd(np.einsum("...t,...tij->...ij", weights, R))
    R_axis_parent = np.swapaxes(se3.rotation_between(Z, U[..., :, 0]), -1, -2)
    R_axis_child = se3.rotation_between(Vt[..., 0, :], Z)
    return R_axis_parent, R_axis_child, turns_about_z(R_axis_parent[..., None, :, :] @ R, R_axis_child[..., None, :, :])


def turns_about_z(R: FloatArray, zero: FloatArray) -> FloatArray:
    """(...,) radians in (-pi, pi]: the turn about z that brings `zero` (..., 3, 3) nearest R (..., 3, 3); paper, 23."""
    relative = R @ np.swapaxes(zero, -1, -2)
    return np.arctan2(relative[..., 1, 0] - relative[..., 0, 1], relative[..., 0, 0] + relative[..., 1, 1])


def turned_back(p: FloatArray, q: FloatArray) -> FloatArray:
    """Points (..., T, 3) turned by -q (..., T) about z."""
    c, s = np.cos(q), np.sin(q)
    return np.stack([c * p[..., 0] + s * p[..., 1], c * p[..., 1] - s * p[..., 0], p[..., 2]], axis=-1)


def frames_along_axis(
    R_axis_parent: FloatArray,
    R_axis_child: FloatArray,
    centre: FloatArray,
    arm: FloatArray,
    form: FloatArray | None = None,
) -> JointFrames:
    """Frames of a joint whose centre and arm (..., 3) are given along the axis frame's directions."""
    R_parent_axis = np.swapaxes(R_axis_parent, -1, -2)
    T_parent_axis = se3.pose(R_parent_axis, (R_parent_axis @ centre[..., None])[..., 0])
    plain = JointFrames.plain(T_parent_axis, se3.pose(R_axis_child, arm))
    return plain if form is None else JointFrames(plain.T_parent_axis, plain.T_axis_child, form)


def centre_by_turns(p: FloatArray, q: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
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


def circle_about_z(p: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (..., 3) and radius (...,) of a circle through points (..., T, 3) seen along z; centre's z is the mean."""
    centre, radius = round_fit(p[..., :2], weights)
    return np.concatenate([centre, weighted_mean(p[..., 2:], weights)], axis=-1), radius


def round_fit(p: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (..., d) and radius (...,) of a circle (d = 2) or sphere (d = 3) through points (..., T, d).

    Hyper fit (Al-Sharadqah and Chernov, 2009; for spheres by the rule of Kanatani and Rangarajan, 2011), which has no
    bias to second order, so that short arcs keep their radius: A |p|^2 + B . p + D = 0 by a generalised eigenvector,
    here as a linear problem solved in closed form.
    """
    d = p.shape[-1]
    mean = weighted_mean(p, weights)
    x = p - mean[..., None, :]
    share = weights / weights.sum(axis=-1, keepdims=True)
    square = np.sum(x**2, axis=-1)
    scale = np.sqrt(np.maximum((share * square).sum(axis=-1), SCATTER_FLOOR))
    x, square = x / scale[..., None, None], square / scale[..., None] ** 2
    rows = np.concatenate([square[..., None], x, np.ones_like(square)[..., None]], axis=-1)
    M: FloatArray = np.einsum("...t,...ti,...tj->...ij", share, rows, rows)
    N = np.zeros_like(M)
    N[..., 0, 0] = (4 + 2 * d) * M[..., 0, -1]  # Hyper's constraint matrix, for points with zero mean
    N[..., 0, -1] = N[..., -1, 0] = d
    N[..., range(1, d + 1), range(1, d + 1)] = 1.0
    # N a = (1 / eta) M a with the smallest eta > 0, made symmetric by M = L L^T: the last of the ascending eigenvalues.
    root = np.linalg.inv(np.linalg.cholesky(M + SCATTER_FLOOR * np.eye(d + 2)))
    _, vectors = np.linalg.eigh(root @ N @ np.swapaxes(root, -1, -2))
    algebraic = (np.swapaxes(root, -1, -2) @ vectors[..., -1:])[..., 0]
    bend, B, D = algebraic[..., 0], algebraic[..., 1:-1], algebraic[..., -1]
    A = np.where(np.abs(bend) > SCATTER_FLOOR, bend, SCATTER_FLOOR)
    centre = -B / (2 * A[..., None])
    radius = np.sqrt(np.maximum(np.sum(centre**2, axis=-1) - D / A, 0.0))
    return mean + scale[..., None] * centre, radius * scale
