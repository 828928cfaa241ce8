"""Small vectors and matrices over many frames with their entries first: (3, P, T) and (3, 3, P, T).

NumPy's products of matrices (..., 3, 3) call a library for each; here each entry is one array over all frames, which
is five times as fast. The formulas are those of `kinematics.se3`, which tests hold these to.
"""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.logs import FloatArray

# Below this sine [1] of an angle beyond a right angle the rotation vector is read with care: it is near half a turn.
HALF_TURN_SINE = 0.05
# Below this angle [rad] a power series gives the Jacobian's coefficient, to 1e-15.
SERIES_BELOW_RAD = 0.3
# Coefficients of (1 - (a/2) cot(a/2)) / a^2 in a^2.
COT_SERIES = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160)


def entries_first(T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations (3, 3, ...) and positions (3, ...) of poses (..., 4, 4)."""
    entries = T[..., :3, :].transpose(T.ndim - 2, T.ndim - 1, *range(T.ndim - 2))
    return np.ascontiguousarray(entries[:, :3]), np.ascontiguousarray(entries[:, 3])


def entries_last(values: FloatArray, axes: int) -> FloatArray:
    """The same values with their first `axes` axes last."""
    return values.transpose(*range(axes, values.ndim), *range(axes))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(3, ...) vector product of a and b (3, ...), broadcast."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def log(R: FloatArray) -> FloatArray:
    """(3, ...) rotation vectors, no longer than pi, of rotations (3, 3, ...)."""
    v = 0.5 * np.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = np.sqrt(np.sum(v**2, axis=0)), 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1)
    angle = np.arctan2(sine, cosine)
    w = v * np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 1.0)
    turned = (cosine < 0) & (sine < HALF_TURN_SINE)
    if turned.any():
        w[:, turned] = se3.log_so3(np.moveaxis(R[:, :, turned], -1, 0)).T
    return w


def inverse_right_jacobian(w: FloatArray) -> FloatArray:
    """(3, 3, ...) J with log(exp(w) exp(dw)) = w + J dw to first order, of w (3, ...) no longer than pi."""
    square = np.sum(w**2, axis=0)
    far = square > SERIES_BELOW_RAD**2
    c = _power_series(COT_SERIES, np.where(far, 0.0, square))
    if far.any():
        half = 0.5 * np.sqrt(square[far])
        c[far] = (1 - half / np.tan(half)) / square[far]
    J = c * w[:, None] * w
    diagonal = 1 - c * square
    for i in range(3):
        J[i, i] += diagonal
        J[(i + 2) % 3, (i + 1) % 3] += 0.5 * w[i]
        J[(i + 1) % 3, (i + 2) % 3] -= 0.5 * w[i]
    return J


def _power_series(coefficients: tuple[float, ...], x: FloatArray) -> FloatArray:
    value = np.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:  # Horner's rule
        value = value * x + coefficient
    return value
