"""Closed form of the two poses of a square: where the refinement starts.

Source: T. Collins and A. Bartoli, Infinitesimal Plane-based Pose Estimation, IJCV 2014. The homography from the square
to its image tells, at the square's centre, how the image changes along the square's plane; that derivative alone
gives both rotations and the distance. Exactly frontal views, where OpenCV's version is 35 px off, are a case like any
other.
"""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray


def square_poses(rays: FloatArray, size_m: FloatArray) -> FloatArray:
    """Both poses (M, 2, 4, 4) of squares of sizes (M,) m whose corners are seen along rays (M, 4, 2).

    Corners run clockwise as seen from the top left; the square's x points right, y up, z to the camera. The two are
    equal at an exactly frontal view. NaN or senseless for corners that are no convex quadrilateral.
    """
    centre, along = _centre_derivative(rays)
    turn = _turns_to(centre)
    # With p = R (x, y, 0) + t the derivative of p's ray is [1, -ray] R[:, :2] / depth; in a frame turned to the line of
    # sight only the upper two rows of R are left in it.
    across = turn[:, :2, :2] - centre[:, :, None] * turn[:, None, 2, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        K = _inverse2(across) @ along
        # The largest singular value of those two rows is 1: no direction is seen longer than it is.
        largest = _largest_singular(K)
        A = K / largest[:, None, None]
        depth_m = size_m / largest
    columns = np.zeros((len(rays), 2, 3, 3))
    columns[:, :, :2, :2] = A[:, None]
    third = _third_row(A)
    columns[:, 0, 2, :2], columns[:, 1, 2, :2] = third, -third
    columns[..., 2] = cross3(columns[..., 0], columns[..., 1])
    T = np.zeros((len(rays), 2, 4, 4))
    T[..., :3, :3] = turn[:, None] @ columns
    T[..., :2, 3] = (depth_m[:, None] * centre)[:, None]
    T[..., 2, 3] = depth_m[:, None]
    T[..., 3, 3] = 1.0
    return T


def cross3(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (..., 3); of a few vectors in a third of the time that np.cross takes."""
    after, before = [1, 2, 0], [2, 0, 1]
    return a[..., after] * b[..., before] - a[..., before] * b[..., after]


def _centre_derivative(rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Image (M, 2) of the square's centre, and its derivative (M, 2, 2) along the square's x and y in square sizes.

    The homography of the unit square u, v (right, down): (a u + b v + c) / (g u + h v + 1).
    """
    p0, p1, p2, p3 = np.moveaxis(rays, 1, 0)
    d1, d2, closing = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    with np.errstate(divide="ignore", invalid="ignore"):
        det = _cross(d1, d2)
        g, h = (_cross(closing, d2) / det)[:, None], (_cross(d1, closing) / det)[:, None]
        a, b = p1 - p0 + g * p1, p3 - p0 + h * p3
        w = 1.0 + 0.5 * (g + h)
        centre = (0.5 * (a + b) + p0) / w
        along = np.stack([(a - g * centre) / w, -(b - h * centre) / w], axis=-1)
    return centre, along


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _turns_to(ray: FloatArray) -> FloatArray:
    """Smallest rotations (M, 3, 3) that take z to the rays (M, 2)."""
    z = 1.0 / np.sqrt(1.0 + np.sum(ray * ray, axis=-1))
    s = ray * z[:, None]
    turn = np.zeros((len(ray), 3, 3))
    turn[:, :2, :2] = np.eye(2) - s[:, :, None] * s[:, None, :] / (1.0 + z)[:, None, None]
    turn[:, :2, 2], turn[:, 2, :2], turn[:, 2, 2] = s, -s, z
    return turn


def _inverse2(M: FloatArray) -> FloatArray:
    det = M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] * M[:, 1, 0]
    swapped = np.empty(M.shape)
    swapped[:, 0, 0], swapped[:, 1, 1] = M[:, 1, 1], M[:, 0, 0]
    swapped[:, 0, 1], swapped[:, 1, 0] = -M[:, 0, 1], -M[:, 1, 0]
    return swapped / det[:, None, None]


def _largest_singular(M: FloatArray) -> FloatArray:
    a, b, c, d = M[:, 0, 0], M[:, 0, 1], M[:, 1, 0], M[:, 1, 1]
    return 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))


def _third_row(A: FloatArray) -> FloatArray:
    """c (M, 2), up to its sign, with A^T A + c c^T = 1 for A (M, 2, 2) whose largest singular value is 1."""
    left = np.eye(2) - np.swapaxes(A, -1, -2) @ A
    c = np.sqrt(np.maximum(np.diagonal(left, axis1=-2, axis2=-1), 0.0))
    c[:, 1] = np.copysign(c[:, 1], left[:, 0, 1])
    return c
