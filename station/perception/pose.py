"""Poses of square markers from their corners: both solutions, refined on the reprojection error, with covariances.

Source of the start: T. Collins and A. Bartoli, Infinitesimal Plane-based Pose Estimation, IJCV 2014 (OpenCV's
IPPE_SQUARE). A square seen nearly from the front has two poses that explain it nearly equally well; both are kept, and
tracking chooses.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.intrinsics import CameraModel, project, project_jacobian
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.edges import shift_edges

# Corners of a marker of size 1 in its own frame, clockwise from its top left: the order that IPPE_SQUARE wants.
UNIT_CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])

# A start above this RMS error, as a share of the marker's size in the image, is no solution (IPPE fails at exactly
# frontal views: 35 px off for a marker of 50 px).
FAILED_START_SHARE = 0.2

# Levenberg-Marquardt on the reprojection error.
MAX_STEPS = 30
FIRST_DAMPING = 1e-4  # share of the normal matrix's diagonal that is added to it
DAMPING_FACTOR = 10.0
LARGEST_DAMPING = 1e6
SMALL_STEP = 1e-5  # a step below this, in marker sizes and radians, ends the refinement

# Two solutions closer than this are one: noise has merged the two minima of the reprojection error.
SAME_ROTATION_RAD = 1e-3


@dataclass(frozen=True, eq=False)
class MarkerPoses:
    """Solutions for M markers, the one with the lower error first.

    Attributes:
        T_cam_marker: (M, 2, 4, 4); all-NaN where there is no such solution.
        rms_px: (M, 2) RMS of the eight coordinates' reprojection errors; NaN where there is no solution.
    """

    T_cam_marker: FloatArray
    rms_px: FloatArray


def reprojection_jacobian(T_cam_marker: FloatArray, size_m: FloatArray, camera: CameraModel) -> FloatArray:
    """Derivative (..., 8, 6) of the corners' pixels (u0, v0, u1, ...) with respect to the right perturbation [m, rad].

    T_cam_marker (..., 4, 4) and size_m (...) broadcast. d p_cam / d xi = R [I, -hat(p_marker)], times the projection's.
    """
    p_marker, p_cam, R = _corner_points(T_cam_marker, size_m)
    shift = np.broadcast_to(R, (*p_marker.shape[:-1], 3, 3))
    d_point = np.concatenate([shift, -(R @ se3.hat3(p_marker))], axis=-1)
    d_pixel = project_jacobian(camera, p_cam) @ d_point
    return d_pixel.reshape(*d_pixel.shape[:-3], 8, 6)


def reprojection_errors(
    T_cam_marker: FloatArray, corners_px: FloatArray, size_m: FloatArray, camera: CameraModel
) -> FloatArray:
    """Projected less seen corners (..., 8) px, (u0, v0, u1, ...); NaN where a corner is not in front of the camera."""
    _, p_cam, _ = _corner_points(T_cam_marker, size_m)
    error = project(camera, p_cam) - corners_px
    return error.reshape(*error.shape[:-2], 8)


def _corner_points(T_cam_marker: FloatArray, size_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corners in the marker's frame and the camera's (..., 4, 3) m; the rotations (..., 1, 3, 3)."""
    p_marker = np.asarray(size_m)[..., None, None] * UNIT_CORNERS
    R = T_cam_marker[..., None, :3, :3]
    p_cam = (R @ p_marker[..., None])[..., 0] + T_cam_marker[..., None, :3, 3]
    return p_marker, p_cam, R


def _rms(errors: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(np.square(errors), axis=-1))


def refine_poses(
    T_cam_marker: FloatArray, corners_px: FloatArray, size_m: FloatArray, camera: CameraModel
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Poses (N, 4, 4) moved to the nearest minimum of the reprojection error; whether (N,) they got there.

    NaN poses stay NaN.

    Levenberg-Marquardt, all poses at once, each with its own damping: near frontal views the tilt is almost free and
    plain Gauss-Newton steps would leave the minimum.
    """
    T = np.array(T_cam_marker, dtype=np.float64)
    scale = np.concatenate([np.repeat(size_m[:, None], 3, axis=1), np.ones((len(T), 3))], axis=1)
    damping = np.full(len(T), FIRST_DAMPING)
    errors = reprojection_errors(T, corners_px, size_m, camera)
    active = np.flatnonzero(np.all(np.isfinite(errors), axis=-1))
    for _ in range(MAX_STEPS):  # an iteration needs the last; those that have settled drop out
        if not active.size:
            break
        s, e = scale[active], errors[active]
        J = reprojection_jacobian(T[active], size_m[active], camera) * s[:, None]
        normal = np.swapaxes(J, -1, -2) @ J
        damp = damping[active, None] * np.diagonal(normal, axis1=-2, axis2=-1)
        step = -np.linalg.solve(normal + damp[:, :, None] * np.eye(6), (np.swapaxes(J, -1, -2) @ e[..., None]))[..., 0]
        tried = T[active] @ se3.exp(s * step)
        tried_errors = reprojection_errors(tried, corners_px[active], size_m[active], camera)
        better = np.sum(tried_errors**2, axis=-1) <= np.sum(e**2, axis=-1)  # NaN compares false
        T[active[better]], errors[active[better]] = tried[better], tried_errors[better]
        damping[active] *= np.where(better, 1 / DAMPING_FACTOR, DAMPING_FACTOR)
        done = (np.abs(step).max(axis=-1) < SMALL_STEP) | (damping[active] > LARGEST_DAMPING)
        active = active[~done]
    settled = np.all(np.isfinite(errors), axis=-1)
    settled[active] = False
    return T, settled


def _starts(corners_px: FloatArray, size_m: FloatArray, camera: CameraModel) -> FloatArray:
    """Starting poses (M, 2, 4, 4); where IPPE finds but one, or fails and SQPNP stands in, the second is its mirror."""
    twists = np.full((len(corners_px), 2, 6), np.nan)
    side_px = np.linalg.norm(corners_px[:, 2] - corners_px[:, 0], axis=-1) / np.sqrt(2.0)
    for m, corners in enumerate(corners_px):  # OpenCV solves one marker at a time
        limit_px = FAILED_START_SHARE * side_px[m]
        points = size_m[m] * UNIT_CORNERS
        found = _solve(points, corners, camera, cv2.SOLVEPNP_IPPE_SQUARE, limit_px)
        if not len(found):
            found = _solve(points, corners, camera, cv2.SOLVEPNP_SQPNP, limit_px)[:1]
        twists[m, : len(found)] = found
    T = se3.pose(se3.exp_so3(twists[..., 3:]), twists[..., :3])
    alone = np.isnan(T[:, 1, 0, 0]) & ~np.isnan(T[:, 0, 0, 0])
    T[alone, 1] = _mirrored(T[alone, 0])
    return T


def _solve(points: FloatArray, corners_px: FloatArray, camera: CameraModel, method: int, limit_px: float) -> FloatArray:
    """(n, 6) [t (m), rotation vector (rad)] of the solutions in front of the camera, with errors within `limit_px`."""
    _, rvecs, tvecs, rms_px = cv2.solvePnPGeneric(points, corners_px, camera.matrix, camera.distortion, flags=method)
    t, r = np.reshape(np.asarray(tvecs, np.float64), (-1, 3)), np.reshape(np.asarray(rvecs, np.float64), (-1, 3))
    found: FloatArray = np.concatenate([t, r], axis=1)
    return found[(found[:, 2] > 0) & (np.ravel(rms_px) <= limit_px)]  # NaN compares false


def _mirrored(T_cam_marker: FloatArray) -> FloatArray:
    """Starts (N, 4, 4) for the other solutions: the same places, the normals mirrored at the lines of sight."""
    t = T_cam_marker[:, :3, 3]
    sight = t / np.linalg.norm(t, axis=-1, keepdims=True)
    normal = T_cam_marker[:, :3, 2]
    mirrored = 2 * np.sum(normal * sight, axis=-1, keepdims=True) * sight - normal
    return se3.pose(se3.rotation_between(normal, mirrored) @ T_cam_marker[:, :3, :3], t)


def estimate_poses(corners_px: FloatArray, size_m: ArrayLike, camera: CameraModel) -> MarkerPoses:
    """Both poses of each marker, refined on its corners, the better one first.

    Args:
        corners_px: (M, 4, 2) as detected (distorted), top left first, clockwise. If the camera has an `edge_shift_px`
            it is undone here: the edges are moved along their outward normals by its negative.
        size_m: (M,) sides of the black squares.
        camera: the camera that saw them.
    """
    corners_px = np.asarray(corners_px, dtype=np.float64)
    size_m = np.broadcast_to(np.asarray(size_m, dtype=np.float64), len(corners_px))
    if not len(corners_px):
        return MarkerPoses(np.zeros((0, 2, 4, 4)), np.zeros((0, 2)))
    if camera.edge_shift_px:
        corners_px = shift_edges(corners_px, -camera.edge_shift_px)
    T = _starts(corners_px, size_m, camera)
    both_px, both_m = np.repeat(corners_px, 2, axis=0), np.repeat(size_m, 2)
    flat, settled = refine_poses(T.reshape(-1, 4, 4), both_px, both_m, camera)
    rms_px = _rms(reprojection_errors(flat, both_px, both_m, camera)).reshape(-1, 2)
    return _ordered(flat.reshape(-1, 2, 4, 4), rms_px, settled.reshape(-1, 2))


def _ordered(T: FloatArray, rms_px: FloatArray, settled: NDArray[np.bool_]) -> MarkerPoses:
    """The better solution first; a second one that is the same, or is still on its way to the first, is left out."""
    order = np.argsort(rms_px, axis=1)  # NaN last
    rms_px = np.take_along_axis(rms_px, order, axis=1)
    settled = np.take_along_axis(settled, order, axis=1)
    T = np.take_along_axis(T, order[:, :, None, None], axis=1)
    R = T[..., :3, :3]
    apart_rad = se3.angle(np.swapaxes(R[:, 0], -1, -2) @ R[:, 1])
    absent = np.isnan(rms_px)
    absent[:, 1] |= ~settled[:, 1] | (apart_rad < SAME_ROTATION_RAD)
    return MarkerPoses(np.where(absent[..., None, None], np.nan, T), np.where(absent, np.nan, rms_px))


def pose_covariance(
    T_cam_marker: FloatArray, size_m: ArrayLike, camera: CameraModel, sigma_px: ArrayLike
) -> FloatArray:
    """Covariances (N, 6, 6) of poses (N, 4, 4), of the right perturbation [m, rad]: sigma^2 (J^T J)^-1.

    J is taken with the marker turned towards the line of sight by one standard deviation of its tilt (not beyond).
    Noise makes a frontal marker seem tilted, and at that tilt the corners would tell the pose better than they do:
    without the turn the normalised squared error is up to 2.3 times too large at frontal views, with it up to 1.3.

    Args:
        T_cam_marker: poses; NaN gives NaN.
        size_m: (N,) or one, sides of the black squares.
        camera: the camera that saw them.
        sigma_px: (N,) or one, standard deviation of each corner coordinate, taken as independent.

    The other solution of the pose, where there is one, may lie outside. A marker seen exactly from its edge, of whose
    tilt the corners say nothing, gives infinite variances.
    """
    shape = np.broadcast_shapes(T_cam_marker.shape[:-2], np.shape(size_m), np.shape(sigma_px))
    T = np.broadcast_to(T_cam_marker, (*shape, 4, 4))
    size_m = np.broadcast_to(np.asarray(size_m, dtype=np.float64), shape)
    sigma_px = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), shape)
    first_order = _first_order_covariance(T, size_m, camera, sigma_px)
    return _first_order_covariance(_turned_to_front(T, first_order), size_m, camera, sigma_px)


def _first_order_covariance(T: FloatArray, size_m: FloatArray, camera: CameraModel, sigma_px: FloatArray) -> FloatArray:
    scale = np.concatenate([np.repeat(size_m[..., None], 3, axis=-1), np.ones((*T.shape[:-2], 3))], axis=-1)
    # In marker sizes and radians J's columns are of one magnitude.
    J = reprojection_jacobian(T, size_m, camera) * scale[..., None, :]
    normal = np.swapaxes(J, -1, -2) @ J
    known = np.all(np.isfinite(normal), axis=(-2, -1))
    inverse = np.full(normal.shape, np.nan)
    inverse[known] = _inverses(normal[known])
    return inverse * scale[..., :, None] * scale[..., None, :] * sigma_px[..., None, None] ** 2


def _turned_to_front(T: FloatArray, covariance: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) turned towards the line of sight by their rotation's largest standard deviation at most."""
    rotation = covariance[..., 3:, 3:]
    known = np.all(np.isfinite(rotation), axis=(-2, -1))
    variance = np.linalg.eigvalsh(np.where(known[..., None, None], rotation, 0.0))[..., -1]
    tilt_rad = viewing_angles(T)
    across = np.cross(T[..., :3, 2], -T[..., :3, 3])
    length = np.linalg.norm(across, axis=-1)
    turn_rad = np.minimum(tilt_rad, np.sqrt(np.maximum(variance, 0.0))) / np.where(length > 0, length, 1.0)
    return se3.pose(se3.exp_so3(across * turn_rad[..., None]) @ T[..., :3, :3], T[..., :3, 3])


def _inverses(normal: FloatArray) -> FloatArray:
    """Inverses (N, 6, 6) of symmetric matrices, infinite variances where one is singular to working precision."""
    values, vectors = np.linalg.eigh(normal)
    floor = np.finfo(np.float64).eps * values[:, -1:]
    singular = values[:, 0] <= floor[:, 0]
    inverse = (vectors / np.maximum(values, floor)[:, None]) @ np.swapaxes(vectors, -1, -2)
    return np.where(singular[:, None, None], np.diag(np.full(6, np.inf)), inverse)


def viewing_angles(T_cam_marker: FloatArray) -> FloatArray:
    """Angles (...,) rad between the markers' normals and the lines of sight to them: 0 from the front; NaN for NaN."""
    normal, towards = T_cam_marker[..., :3, 2], -T_cam_marker[..., :3, 3]
    across = np.linalg.norm(np.cross(normal, towards), axis=-1)
    return np.arctan2(across, np.sum(normal * towards, axis=-1))
