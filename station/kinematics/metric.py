"""The paper's distance between poses and its gradient (15-17), with two corrections.

Where the paper is inconsistent, this is what holds, and tests/kinematics/test_metric.py shows it:

- Section II-C calls the metric left-invariant where it introduces it and right-invariant where it defines it (15).
  As written it is left-invariant in full, l(g u, g v) = l(u, v) for every rigid motion g, and right-invariant only for
  pure rotations g: a translation t on the right adds (U_R - V_R) t to the difference of positions.
- The rotation term of the gradient, 2c log(U_R^T V_R) V_R^T U_R V_R in (17) and (29), has the wrong sign and order.
  With respect to U_R it is -2c U_R log(U_R^T V_R); finite differences decide.

The sum of (16) over frames is -2 log likelihood, up to a constant, only with `c` = 1 / (2 sigma_r^2) and
`d` = 1 / sigma_t^2, where sigma_r [rad] and sigma_t [m] are the noise per axis: ||log R||_F^2 is twice the angle's
square.
"""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.logs import FloatArray


def squared_distance(T_a: FloatArray, T_b: FloatArray, *, c: float, d: float) -> FloatArray:
    """Squared distance (...,) between poses (..., 4, 4), `c ||log(U_R^T V_R)||_F^2 + d ||u_T - v_T||^2` (paper, 16).

    Args:
        T_a: poses (..., 4, 4), u of the paper.
        T_b: poses (..., 4, 4), v of the paper, broadcast against `T_a`.
        c: weight of the rotation, 1 / rad^2.
        d: weight of the translation, 1 / m^2.

    Returns:
        The squared distance, without a unit; NaN where a pose is NaN.
    """
    w, t = _differences(T_a, T_b)
    return 2 * c * np.sum(w**2, axis=-1) + d * np.sum(t**2, axis=-1)


def distance(T_a: FloatArray, T_b: FloatArray, *, c: float, d: float) -> FloatArray:
    """Distance (...,) between poses (..., 4, 4) (paper, 15): the root of `squared_distance`, with its arguments."""
    return np.sqrt(squared_distance(T_a, T_b, c=c, d=d))


def gradient(T_a: FloatArray, T_b: FloatArray, *, c: float, d: float) -> FloatArray:
    """Gradient of `squared_distance` with respect to the entries of `T_a` (paper, 17 and 29, corrected).

    `[-2c U_R log(U_R^T V_R) | 2d (u_T - v_T)]`. The rotation part G lies in the tangent space of SO(3) at U_R: the
    inner product tr(G^T U_R hat(w)) is the derivative along the rotation w; off SO(3) it says nothing.

    Args:
        T_a: poses (..., 4, 4), u of the paper.
        T_b: poses (..., 4, 4), v of the paper, less than half a turn from `T_a`; at half a turn (16) has a kink.
        c: weight of the rotation, 1 / rad^2.
        d: weight of the translation, 1 / m^2.

    Returns:
        (..., 3, 4): a rotation block (..., 3, 3) and a translation column in 1/m; NaN where a pose is NaN.
    """
    w, t = _differences(T_a, T_b)
    G_rotation = -2 * c * T_a[..., :3, :3] @ se3.hat3(w)
    return np.concatenate([G_rotation, 2 * d * t[..., None]], axis=-1)


def twist_gradient(T_a: FloatArray, T_b: FloatArray, *, c: float, d: float) -> FloatArray:
    """Gradient (..., 6) of `squared_distance` along right perturbations `T_a @ exp([v, w])` [m, rad].

    `[2d U_R^T (u_T - v_T), -4c vee(log(U_R^T V_R))]`; arguments and limits as in `gradient`.
    """
    w, t = _differences(T_a, T_b)
    t_in_a = (np.swapaxes(T_a[..., :3, :3], -1, -2) @ t[..., None])[..., 0]
    return np.concatenate([2 * d * t_in_a, -4 * c * w], axis=-1)


def _differences(T_a: FloatArray, T_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation vector of U_R^T V_R (..., 3) and u_T - v_T (..., 3)."""
    w = se3.log_so3(np.swapaxes(T_a[..., :3, :3], -1, -2) @ T_b[..., :3, :3])
    return w, np.broadcast_to(T_a[..., :3, 3] - T_b[..., :3, 3], w.shape)
