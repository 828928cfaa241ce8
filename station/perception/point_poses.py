"""Poses of known points from where a camera saw them: least squares weighted by the points' covariances, many at once.

The work is done on undistorted rays, to which the covariances are carried over: the lens model is evaluated once, not
at each step. Live pictures wait for this, so the steps use few, large array operations; everything has the leading
axes (views N, points P).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel, project_jacobian
from station.logs import FloatArray

# OpenCV's inversion of the lens model ends at this distance between rays, after this many rounds at the latest.
UNDISTORTED_TO = 1e-10
UNDISTORTING_ROUNDS = 30

# Levenberg-Marquardt.
# A frame's markers get by with few: 1 in 500 second solutions is then still on its way, the first is right to a tenth
# of its deviation. More are for the slow way along the flat valley between two solutions that noise has merged.
FEW_STEPS = 4
MANY_STEPS = 60
FIRST_DAMPING = 1e-5  # share of the normal matrix's diagonal that is added to it
DAMPING_FACTOR = 10.0
LARGEST_DAMPING = 1e6
# A step that promises less than this, in squared standard deviations, is the last one: the pose is then right to some
# 1 % of its deviation. Of errors beyond chance, as the wrong pose of a square has them, a share counts as much.
SMALL_GAIN = 1e-4
# What points of unknown covariance are taken to have; it is their relative weights that count.
NOMINAL_SIGMA_PX = 0.05

_DIAGONAL = np.arange(6)


@dataclass(frozen=True, eq=False)
class Sights:
    """What N views show of P points each.

    Attributes:
        points_m: (N, P, 3) in the object's frame.
        rays: (N, P, 2) undistorted places at distance 1 from the camera.
        px_per_ray: (N, P, 2, 2) derivative of the pixels with respect to them.
        whitening: (N, G, n, n) takes the rays' errors, of G groups of points with n coordinates each, to errors of unit
            variance that are independent.
    """

    points_m: FloatArray
    rays: FloatArray
    px_per_ray: FloatArray
    whitening: FloatArray

    def __getitem__(self, rows: NDArray[np.intp] | slice) -> Sights:
        """Those views, in that order."""
        return Sights(self.points_m[rows], self.rays[rows], self.px_per_ray[rows], self.whitening[rows])

    def __len__(self) -> int:
        return len(self.rays)


def sights_of(
    points_m: FloatArray, seen_px: FloatArray, covariance_px2: FloatArray | None, camera: CameraModel
) -> Sights:
    """Sights of points (N, P, 3) seen at (N, P, 2).

    Args:
        points_m: in the object's frame.
        seen_px: distorted.
        covariance_px2: (N, G, n, n) joint covariances of groups of points that follow one another, n / 2 points each;
            for None all coordinates are independent, and equal.
        camera: that saw them.
    """
    flat = np.ascontiguousarray(seen_px, dtype=np.float64).reshape(-1, 1, 2)
    if len(flat):
        end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, UNDISTORTING_ROUNDS, UNDISTORTED_TO)
        flat = cv2.undistortPoints(flat, camera.matrix, camera.distortion, criteria=end)
    rays = np.asarray(flat, dtype=np.float64).reshape(seen_px.shape)
    px_per_ray = project_jacobian(camera, np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1))[..., :2]
    if covariance_px2 is None:
        return Sights(points_m, rays, px_per_ray, px_per_ray / NOMINAL_SIGMA_PX)
    count, groups, size = covariance_px2.shape[:3]
    of_px = np.linalg.inv(np.linalg.cholesky(covariance_px2)).reshape(count, groups, size, size // 2, 1, 2)
    of_rays = of_px @ px_per_ray.reshape(count, groups, 1, size // 2, 2, 2)
    return Sights(points_m, rays, px_per_ray, of_rays.reshape(covariance_px2.shape))


@dataclass(frozen=True, eq=False)
class Solved:
    """Poses at minima of the squared, whitened errors.

    Attributes:
        T: (N, 4, 4) poses of the objects in the camera; NaN where there was no start.
        chi2: (N,) sums of squared whitened errors there; NaN where a point is not in front of the camera.
        rms_px: (N,) RMS of the 2 P coordinates' errors, unweighted.
        information: (N, 6, 6) inverse covariances of T's right perturbation [m, rad], to first order.
        settled: (N,) the search ended at a minimum.
    """

    T: FloatArray
    chi2: FloatArray
    rms_px: FloatArray
    information: FloatArray
    settled: NDArray[np.bool_]


def ray_errors(R: FloatArray, t: FloatArray, sights: Sights) -> tuple[FloatArray, FloatArray]:
    """Errors (N, P, 2) of the rays, and their derivatives (N, P, 2, 6); NaN where a point is not before the camera.

    Derivatives are with respect to a shift of t (m) and a turn (rad), both in camera coordinates, the turn about the
    object's own origin: R, t -> exp(w) R, t + v. With q = R p and (x, y) the ray to q + t at depth z:
    z dx = v1 - x v3 - x q2 w1 + (q3 + x q1) w2 - q2 w3, z dy = v2 - y v3 - (q3 + y q2) w1 + y q1 w2 + q1 w3.
    """
    q = sights.points_m @ np.swapaxes(R, -1, -2)
    depth = q[..., 2] + t[:, None, 2]
    inverse = 1.0 / np.where(depth > 0, depth, np.nan)
    xy = (q[..., :2] + t[:, None, :2]) * inverse[..., None]
    qz = q * inverse[..., None]
    J = np.zeros((*xy.shape, 6))
    J[..., 0, 0] = J[..., 1, 1] = inverse
    J[..., 2] = -xy * inverse[..., None]
    J[..., 3] = -xy * qz[..., 1:2]
    J[..., 4] = xy * qz[..., 0:1]
    J[..., 0, 4] += qz[..., 2]
    J[..., 1, 3] -= qz[..., 2]
    J[..., 0, 5] = -qz[..., 1]
    J[..., 1, 5] = qz[..., 0]
    return xy - sights.rays, J


def _normal(R: FloatArray, t: FloatArray, sights: Sights) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrices (N, 6, 6), gradients (N, 6) and sums of squares (N,)."""
    errors, J = ray_errors(R, t, sights)
    groups, size = sights.whitening.shape[1:3]
    both = np.concatenate([J, errors[..., None]], axis=-1).reshape(len(J), groups, size, 7)
    both = (sights.whitening @ both).reshape(len(J), groups * size, 7)
    square = np.swapaxes(both, -1, -2) @ both
    return square[:, :6, :6], square[:, :6, 6], square[:, 6, 6]


def _turns(w: FloatArray) -> FloatArray:
    """Rotations (N, 3, 3) by about w (N, 3): Cayley's, equal to exp(w) to second order and always orthogonal."""
    a = 0.5 * w
    A = np.zeros((len(a), 3, 3))
    A[:, 0, 1], A[:, 0, 2], A[:, 1, 2] = -a[:, 2], a[:, 1], -a[:, 0]
    A -= np.swapaxes(A, -1, -2)
    factor = 2.0 / (1.0 + np.sum(a * a, axis=-1))
    return np.eye(3) + factor[:, None, None] * (A + A @ A)


def solve_poses(sights: Sights, start: FloatArray, *, most_steps: int = MANY_STEPS) -> Solved:
    """The minima that poses (N, 4, 4) lead to; NaN poses stay NaN.

    Levenberg-Marquardt, all views at once, each with its own damping: near frontal views the tilt of a square is almost
    free and plain Gauss-Newton steps would leave the minimum.
    """
    R, t = np.array(start[:, :3, :3]), np.array(start[:, :3, 3])
    normal, gradient, chi2 = _normal(R, t, sights)
    damping = np.full(len(R), FIRST_DAMPING)
    active = np.flatnonzero(np.isfinite(chi2))
    for _ in range(most_steps):  # a step needs the last; those that have settled drop out
        if not active.size:
            break
        rows = slice(None) if len(active) == len(R) else active
        damped = np.array(normal[rows])
        damped[:, _DIAGONAL, _DIAGONAL] *= 1.0 + damping[rows, None]
        slope = gradient[rows]
        step = np.asarray(-np.linalg.solve(damped, slope[..., None])[..., 0], dtype=np.float64)
        tried_R, tried_t = _turns(step[:, 3:]) @ R[rows], t[rows] + step[:, :3]
        tried = _normal(tried_R, tried_t, sights[rows])
        better = tried[2] <= chi2[rows]  # NaN compares false
        kept = active[better]
        R[kept], t[kept] = tried_R[better], tried_t[better]
        normal[kept], gradient[kept], chi2[kept] = (values[better] for values in tried)
        damping[active] *= np.where(better, 1 / DAMPING_FACTOR, DAMPING_FACTOR)
        gain = -np.sum(step * slope, axis=-1)
        going_on = gain >= SMALL_GAIN * np.maximum(chi2[active], 1.0)
        active = active[going_on & (damping[active] <= LARGEST_DAMPING)]
    settled = np.isfinite(chi2)
    settled[active] = False
    return _solved(sights, R, t, normal, chi2, settled)


def _solved(
    sights: Sights, R: FloatArray, t: FloatArray, normal: FloatArray, chi2: FloatArray, settled: NDArray[np.bool_]
) -> Solved:
    errors, _ = ray_errors(R, t, sights)
    px = (sights.px_per_ray @ errors[..., None])[..., 0]
    with np.errstate(over="ignore"):  # a start that led nowhere may have a point at the camera's plane
        rms_px = np.sqrt(np.mean(px * px, axis=(-2, -1)))
    T = np.zeros((len(R), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, t, 1.0
    T[np.isnan(chi2)] = np.nan
    return Solved(T, chi2, rms_px, _right(normal, R), settled)


def _right(normal: FloatArray, R: FloatArray) -> FloatArray:
    """Normal matrices (N, 6, 6) of right perturbations: v = R v_right, w = R w_right."""
    blocks = np.zeros(normal.shape)
    blocks[:, :3, :3] = blocks[:, 3:, 3:] = R
    return np.swapaxes(blocks, -1, -2) @ normal @ blocks


def squared_errors(sights: Sights, T: FloatArray) -> FloatArray:
    """Sums (N,) of squared whitened errors at poses (N, 4, 4); NaN for NaN."""
    return _normal(T[:, :3, :3], T[:, :3, 3], sights)[2]


def information_at(sights: Sights, T: FloatArray) -> FloatArray:
    """Inverse covariances (N, 6, 6) of the right perturbation [m, rad], to first order, of poses (N, 4, 4)."""
    normal, _, _ = _normal(T[:, :3, :3], T[:, :3, 3], sights)
    return _right(normal, T[:, :3, :3])
