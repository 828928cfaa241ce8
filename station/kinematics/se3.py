"""Rigid motions SE(3) as (..., 4, 4) matrices: exponential, logarithm, Jacobians, adjoint, mean.

Conventions of the whole station: `T_a_b` is the pose of b in a and takes b-coordinates to a, so inner letters cancel
in `T_a_c = T_a_b @ T_b_c`. Twists are `[v (m), w (rad)]` and perturb on the right, `T @ exp(xi)`; covariances are in
that order. Every function takes leading batch axes; NaN in gives NaN out. Formulas: paper, 10-14 (its twists are
(w, v)); T. Barfoot, State Estimation for Robotics, chapter 8, for the Jacobians.

The scalar coefficients, such as (t - sin t) / t^3, lose all digits for small angles t. Each has a power series in t^2
that is exact to rounding below SERIES_BELOW_RAD and a closed form above, where cancellation costs at most two digits.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from station.errors import InvalidData
from station.logs import FloatArray

# Below this angle [rad] power series replace the closed forms; both are exact to 1e-14 here.
SERIES_BELOW_RAD = 1.0
_TERMS = 11
_SIN3_SERIES = tuple((-1) ** k / factorial(2 * k + 3) for k in range(_TERMS))
_COS4_SERIES = tuple((-1) ** k / factorial(2 * k + 4) for k in range(_TERMS))
_SIN5_SERIES = tuple((-1) ** k * (k + 1) / factorial(2 * k + 5) for k in range(_TERMS))
# |B_2k| / (2k)! for k = 1...: the series of (1 - (t/2) cot(t/2)) / t^2, with Bernoulli numbers B.
_BERNOULLI = ((1, 6), (1, 30), (1, 42), (1, 30), (5, 66), (691, 2730), (7, 6), (3617, 510), (43867, 798), (174611, 330))
_COT_SERIES = tuple(a / b / factorial(2 * k + 2) for k, (a, b) in enumerate(_BERNOULLI))


def _series(coefficients: tuple[float, ...], square: FloatArray) -> FloatArray:
    return np.asarray(np.polyval(coefficients[::-1], np.minimum(square, SERIES_BELOW_RAD**2)), dtype=np.float64)


def _coefficient(t: FloatArray, series: tuple[float, ...], closed: FloatArray) -> FloatArray:
    return np.where(t < SERIES_BELOW_RAD, _series(series, t**2), closed)


def _sin_over(t: FloatArray) -> FloatArray:
    """sin(t) / t."""
    s = np.where(t == 0, 1.0, t)
    return np.where(t == 0, 1.0, np.sin(s) / s)


def _cos2_over(t: FloatArray) -> FloatArray:
    """(1 - cos t) / t^2."""
    return 0.5 * _sin_over(0.5 * t) ** 2


def _sin3_over(t: FloatArray) -> FloatArray:
    """(t - sin t) / t^3."""
    s = np.maximum(t, SERIES_BELOW_RAD)
    return _coefficient(t, _SIN3_SERIES, (s - np.sin(s)) / s**3)


def _cos4_over(t: FloatArray) -> FloatArray:
    """(t^2 + 2 cos t - 2) / (2 t^4)."""
    s = np.maximum(t, SERIES_BELOW_RAD)
    return _coefficient(t, _COS4_SERIES, (s**2 + 2 * np.cos(s) - 2) / (2 * s**4))


def _sin5_over(t: FloatArray) -> FloatArray:
    """(2 t - 3 sin t + t cos t) / (2 t^5)."""
    s = np.maximum(t, SERIES_BELOW_RAD)
    return _coefficient(t, _SIN5_SERIES, (2 * s - 3 * np.sin(s) + s * np.cos(s)) / (2 * s**5))


def _cot2_over(t: FloatArray) -> FloatArray:
    """(1 - (t/2) cot(t/2)) / t^2."""
    s = np.maximum(t, SERIES_BELOW_RAD)
    return _coefficient(t, _COT_SERIES, (1 - (s / 2) * np.cos(s / 2) / np.sin(s / 2)) / s**2)


def _floats(values: ArrayLike, *tail: int) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape[-len(tail) :] != tail:
        raise InvalidData(f"array of shape {array.shape}; want (..., {', '.join(map(str, tail))})")
    return array


def identity(*batch: int) -> FloatArray:
    """Identity poses of shape (*batch, 4, 4)."""
    T = np.empty((*batch, 4, 4))
    T[...] = np.eye(4)
    return T


def pose(R: ArrayLike, t: ArrayLike) -> FloatArray:
    """(..., 4, 4) pose of rotation R (..., 3, 3) and translation t (..., 3) in metres."""
    rotation, shift = _floats(R, 3, 3), _floats(t, 3)
    T = identity(*np.broadcast_shapes(rotation.shape[:-2], shift.shape[:-1]))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = shift
    odd = np.isnan(T)
    if odd.any():
        T[odd.any(axis=(-2, -1))] = np.nan
    return T


def translation(t: ArrayLike) -> FloatArray:
    """(..., 4, 4) pure translation by t (..., 3) in metres; T of the paper."""
    return pose(np.eye(3), t)


def rotation_z(q: ArrayLike) -> FloatArray:
    """(..., 4, 4) rotation about z by q (...,) in radians; R_z of the paper."""
    q = np.asarray(q, dtype=np.float64)
    T = identity(*q.shape)
    T[..., 0, 0] = T[..., 1, 1] = np.cos(q)
    T[..., 1, 0] = np.sin(q)
    T[..., 0, 1] = -T[..., 1, 0]
    T[np.isnan(q)] = np.nan
    return T


def hat3(w: ArrayLike) -> FloatArray:
    """(..., 3, 3) skew matrix of w (..., 3), so that hat3(w) @ p = cross(w, p); paper, 12."""
    w = _floats(w, 3)
    out = np.zeros((*w.shape, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., k, j] = w[..., i]
        out[..., j, k] = -w[..., i]
    return out


def _powers(w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angle (..., 1, 1), hat and squared hat of a rotation vector (..., 3)."""
    W, (x, y, z) = hat3(w), np.moveaxis(w, -1, 0)
    return np.sqrt(x * x + y * y + z * z)[..., None, None], W, W @ W


def exp_so3(w: ArrayLike) -> FloatArray:
    """(..., 3, 3) rotation of the rotation vector w (..., 3) in radians; paper, 13."""
    t, W, W2 = _powers(_floats(w, 3))
    return np.eye(3) + _sin_over(t) * W + _cos2_over(t) * W2


def _quaternion_wxyz(R: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4), w first and not negative, of rotations (..., 3, 3).

    The four rows of 4 q q^T are read off the matrix; the one with the largest diagonal entry has no cancellation. For
    all turns of less than 120 degrees it is the first one.
    """
    m = [[R[..., i, j] for j in range(3)] for i in range(3)]
    w, x, y = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    d = [m[0][0], m[1][1], m[2][2]]
    trace = d[0] + d[1] + d[2]
    q = np.stack([1 + trace, w, x, y], axis=-1)
    far = ~(trace >= np.maximum(np.maximum(d[0], d[1]), d[2]))
    if far.any():
        q[far] = _far_quaternion(R[far])
    unit = _unit(q)
    return np.where(unit[..., :1] < 0, -unit, unit)


def _far_quaternion(R: FloatArray) -> FloatArray:
    """(N, 4) of rotations (N, 3, 3) of any angle, not of unit length."""
    m = [[R[..., i, j] for j in range(3)] for i in range(3)]
    w, x, y = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    xy, xz, yz = m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]
    d = [m[0][0], m[1][1], m[2][2]]
    rows = np.stack(
        [
            np.stack([1 + d[0] + d[1] + d[2], w, x, y], axis=-1),
            np.stack([w, 1 + d[0] - d[1] - d[2], xy, xz], axis=-1),
            np.stack([x, xy, 1 - d[0] + d[1] - d[2], yz], axis=-1),
            np.stack([y, xz, yz, 1 - d[0] - d[1] + d[2]], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)[..., None, None]
    q: FloatArray = np.take_along_axis(rows, best, axis=-2)[..., 0, :]
    return q


def log_so3(R: ArrayLike) -> FloatArray:
    """Rotation vector (..., 3), of length at most pi, of rotations (..., 3, 3)."""
    q = _quaternion_wxyz(_floats(R, 3, 3))
    v = q[..., 1:]
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    half = np.arctan2(length, q[..., :1])
    return v * (2 / _sin_over(half))  # length = sin(half), so v / length * 2 half


def angle(R: ArrayLike) -> FloatArray:
    """Angle (...,) in [0, pi] of rotations (..., 3, 3)."""
    return np.asarray(np.linalg.norm(log_so3(R), axis=-1), dtype=np.float64)


def left_jacobian_so3(w: ArrayLike) -> FloatArray:
    """(..., 3, 3) J with exp(w + dw) = exp(J dw) exp(w) to first order; A of the paper, 14."""
    t, W, W2 = _powers(_floats(w, 3))
    return np.eye(3) + _cos2_over(t) * W + _sin3_over(t) * W2


def inverse_left_jacobian_so3(w: ArrayLike) -> FloatArray:
    """(..., 3, 3) inverse of `left_jacobian_so3`; w (..., 3) shorter than 2 pi."""
    t, W, W2 = _powers(_floats(w, 3))
    return np.eye(3) - 0.5 * W + _cot2_over(t) * W2


def exp(xi: ArrayLike) -> FloatArray:
    """(..., 4, 4) pose of the twist xi (..., 6) = [v (m), w (rad)]; paper, 11."""
    xi = _floats(xi, 6)
    t, W, W2 = _powers(xi[..., 3:])
    cos2 = _cos2_over(t)
    R = np.eye(3) + _sin_over(t) * W + cos2 * W2
    J = np.eye(3) + cos2 * W + _sin3_over(t) * W2
    return pose(R, (J @ xi[..., :3, None])[..., 0])


def log(T: ArrayLike) -> FloatArray:
    """Twist (..., 6) = [v (m), w (rad)] of poses (..., 4, 4); the rotation is at most pi."""
    pose_of = _floats(T, 4, 4)
    w = log_so3(pose_of[..., :3, :3])
    v = (inverse_left_jacobian_so3(w) @ pose_of[..., :3, 3:])[..., 0]
    return np.concatenate([v, w], axis=-1)


def inverse(T: ArrayLike) -> FloatArray:
    """(..., 4, 4) inverse: from `T_a_b` to `T_b_a`."""
    forward = _floats(T, 4, 4)
    R_t = np.swapaxes(forward[..., :3, :3], -1, -2)
    return pose(R_t, -(R_t @ forward[..., :3, 3:])[..., 0])


def _blocks(diagonal: FloatArray, upper: FloatArray) -> FloatArray:
    """(..., 6, 6) [[diagonal, upper], [0, diagonal]]."""
    out = np.zeros((*diagonal.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = diagonal
    out[..., :3, 3:] = upper
    return out


def adjoint(T: ArrayLike) -> FloatArray:
    """(..., 6, 6) Ad with T @ exp(xi) = exp(Ad xi) @ T."""
    moved = _floats(T, 4, 4)
    out, R = np.zeros((*moved.shape[:-2], 6, 6)), moved[..., :3, :3]
    out[..., :3, :3] = out[..., 3:, 3:] = R
    for i in range(3):  # rows of hat3(p) @ R, quicker than products of small matrices
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i, 3:] = moved[..., j, 3:] * R[..., k, :] - moved[..., k, 3:] * R[..., j, :]
    return out


def _coupling(xi: FloatArray) -> FloatArray:
    """(..., 3, 3) upper right block of the left Jacobian of SE(3); Barfoot, 8.91."""
    V = hat3(xi[..., :3])
    t, W, W2 = _powers(xi[..., 3:])
    WVW = W @ V @ W
    return (
        0.5 * V
        + _sin3_over(t) * (W @ V + V @ W + WVW)
        + _cos4_over(t) * (W2 @ V + V @ W2 - 3 * WVW)
        + _sin5_over(t) * (WVW @ W + W @ WVW)
    )


def left_jacobian(xi: ArrayLike) -> FloatArray:
    """(..., 6, 6) J with exp(xi + dxi) = exp(J dxi) @ exp(xi) to first order."""
    xi = _floats(xi, 6)
    return _blocks(left_jacobian_so3(xi[..., 3:]), _coupling(xi))


def right_jacobian(xi: ArrayLike) -> FloatArray:
    """(..., 6, 6) J with exp(xi + dxi) = exp(xi) @ exp(J dxi) to first order."""
    return left_jacobian(-np.asarray(xi, dtype=np.float64))


def inverse_left_jacobian(xi: ArrayLike) -> FloatArray:
    """(..., 6, 6) inverse of `left_jacobian`; the rotation is less than 2 pi."""
    xi = _floats(xi, 6)
    J = inverse_left_jacobian_so3(xi[..., 3:])
    return _blocks(J, -J @ _coupling(xi) @ J)


def inverse_right_jacobian(xi: ArrayLike) -> FloatArray:
    """(..., 6, 6) inverse of `right_jacobian`; the rotation is less than 2 pi."""
    return inverse_left_jacobian(-np.asarray(xi, dtype=np.float64))


def project_to_so3(M: ArrayLike) -> FloatArray:
    """(..., 3, 3) rotations nearest to M (..., 3, 3) in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(_floats(M, 3, 3))
    sign = np.sign(np.linalg.det(U @ Vt))
    U[..., :, 2] *= sign[..., None]
    return U @ Vt


def _unit(v: FloatArray) -> FloatArray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(..., 3) vector product; on few vectors quicker than NumPy's."""
    (a0, a1, a2), (b0, b1, b2) = (np.moveaxis(v, -1, 0) for v in (a, b))
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def rotation_between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """(..., 3, 3) smallest rotation that takes the direction a (..., 3) to the direction b (..., 3).

    Opposite directions turn by pi about an axis at right angles to a.
    """
    start, end = np.broadcast_arrays(_unit(_floats(a, 3)), _unit(_floats(b, 3)))
    axis = _cross(start, end)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    turn = np.arctan2(sine, np.sum(start * end, axis=-1, keepdims=True))
    across = _cross(start, np.eye(3)[np.argmin(np.abs(start), axis=-1)])
    return exp_so3(turn * np.where(sine > 0, axis / np.where(sine > 0, sine, 1.0), _unit(across)))


def mean(
    T: ArrayLike, weights: ArrayLike | None = None, *, tolerance: float = 1e-12, iterations: int = 50
) -> FloatArray:
    """Group mean (..., 4, 4) of poses T (..., N, 4, 4): the pose about which the weighted mean twist is zero.

    Args:
        T: poses within a half turn of each other.
        weights: (..., N), not negative; equal if None.
        tolerance: largest entry of the last step [m, rad].

    Raises:
        InvalidData: if the iteration does not settle, as for poses spread over more than a half turn.
    """
    poses = _floats(T, 4, 4)
    given = np.ones(poses.shape[:-2]) if weights is None else np.broadcast_to(weights, poses.shape[:-2])
    w = given / given.sum(axis=-1, keepdims=True)
    R = project_to_so3(np.einsum("...n,...nij->...ij", w, poses[..., :3, :3]))
    centre = pose(R, np.einsum("...n,...ni->...i", w, poses[..., :3, 3]))
    for _ in range(iterations):  # a fixed-point iteration: each step needs the last
        step = np.einsum("...n,...ni->...i", w, log(inverse(centre)[..., None, :, :] @ poses))
        centre = centre @ exp(step)
        if not np.any(np.abs(step) > tolerance):
            return centre
    raise InvalidData("the poses have no mean: they are spread over more than a half turn")


def to_xyz_wxyz(T: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Positions (..., 3) in metres and unit quaternions (..., 4), w first and not negative."""
    poses = _floats(T, 4, 4)
    return poses[..., :3, 3].copy(), _quaternion_wxyz(poses[..., :3, :3])


def from_xyz_wxyz(xyz: ArrayLike, wxyz: ArrayLike) -> FloatArray:
    """(..., 4, 4) poses of positions (..., 3) in metres and quaternions (..., 4), w first, of any length but zero."""
    q = _floats(wxyz, 4)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, v = q[..., 0, None, None], q[..., 1:]
    V = hat3(v)
    return pose(np.eye(3) + 2 * w * V + 2 * V @ V, xyz)
