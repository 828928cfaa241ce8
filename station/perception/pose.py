"""Poses of square markers from their corners: both solutions, refined on the reprojection error, with covariances.

A square seen nearly from the front has two poses that explain it nearly equally well; both are kept, and tracking
chooses. Where noise has merged the two minima of the error, as it does exactly at the front, there is but one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.intrinsics import CameraModel
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.observations import COORDINATES
from station.perception.point_poses import (
    FEW_STEPS,
    Sights,
    Solved,
    information_at,
    sights_of,
    solve_poses,
    squared_errors,
)
from station.perception.square_pose import cross3, square_poses
from station.quadrilaterals import unshift_edges

# Corners of a marker of size 1 in its own frame, clockwise from its top left.
UNIT_CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])

# A pose with an RMS error above this share of the marker's size in the image is none: what was seen is no square.
FAILED_SHARE = 0.2
# Two solutions closer than this, in squared standard deviations, are one: noise has merged the two minima of the error,
# or nothing that matters is between them.
SAME_SQUARED = 0.25
# A covariance is taken with its marker turned to the front by this many standard deviations of the tilt.
FRONT_TURN_SIGMAS = 1.5
# Determinant of an information matrix, its diagonal scaled to ones, below which it is singular: some direction of the
# pose then has 1e-7 of the information that its neighbours have.
SINGULAR_DETERMINANT = 1e-14


@dataclass(frozen=True, eq=False)
class MarkerPoses:
    """Solutions for M markers, the likelier first.

    Attributes:
        T_cam_marker: (M, 2, 4, 4); all-NaN where there is no such solution.
        rms_px: (M, 2) RMS of the eight coordinates' reprojection errors; NaN where there is no solution.
        covariance: (M, 2, 6, 6) of the right perturbation [m, rad]; NaN where there is no solution, or where the
            corners' covariances are not known.
    """

    T_cam_marker: FloatArray
    rms_px: FloatArray
    covariance: FloatArray


def estimate_poses(
    corners_px: FloatArray, size_m: ArrayLike, camera: CameraModel, covariance_px2: FloatArray | None = None
) -> MarkerPoses:
    """Both poses of each marker, refined on its corners, the one with the lower error first.

    Args:
        corners_px: (M, 4, 2) as detected (distorted), top left first, clockwise. If the camera has an `edge_shift_px`
            it is undone here: the edges are moved along their outward normals by its negative.
        size_m: (M,) sides of the black squares.
        camera: the camera that saw them.
        covariance_px2: (M, 8, 8) of the corners' coordinates, which weigh them, see `joint_covariance`; markers with
            NaN there, or all for None, have equal weights and no covariance.
    """
    seen_px = without_edge_shift(np.asarray(corners_px, dtype=np.float64), camera)
    count = len(seen_px)
    size_m = np.broadcast_to(np.asarray(size_m, dtype=np.float64), count)
    if not count:
        return MarkerPoses(np.zeros((0, 2, 4, 4)), np.zeros((0, 2)), np.zeros((0, 2, 6, 6)))
    known, weights = _weights(covariance_px2, count)
    sights = sights_of(size_m[:, None, None] * UNIT_CORNERS, seen_px, weights, camera)
    both = sights[np.repeat(np.arange(count), 2)]
    start = square_poses(sights.rays, size_m).reshape(-1, 4, 4)
    solved = solve_poses(both, start, most_steps=FEW_STEPS)
    covariance = square_covariance(both, solved.T, solved.information).reshape(count, 2, 6, 6)
    side_px = np.linalg.norm(seen_px[:, 2] - seen_px[:, 0], axis=-1) / np.sqrt(2.0)
    return _ordered(solved, np.where(known[:, None, None, None], covariance, np.nan), FAILED_SHARE * side_px)


def squared_corner_errors(
    T_cam_marker: FloatArray,
    corners_px: FloatArray,
    size_m: ArrayLike,
    camera: CameraModel,
    covariance_px2: FloatArray,
) -> FloatArray:
    """Squared errors (M,) of corners at poses (M, 4, 4), in units of their covariances (M, 8, 8); NaN for NaN."""
    size_m = np.broadcast_to(np.asarray(size_m, dtype=np.float64), len(corners_px))
    known, weights = _weights(covariance_px2, len(corners_px))
    points_m = size_m[:, None, None] * UNIT_CORNERS
    sights = sights_of(points_m, without_edge_shift(corners_px, camera), weights, camera)
    return np.where(known, squared_errors(sights, T_cam_marker), np.nan)


def without_edge_shift(corners_px: FloatArray, camera: CameraModel) -> FloatArray:
    """Corners (M, 4, 2) with the camera's shift of dark edges undone."""
    if not camera.edge_shift_px or not len(corners_px):
        return corners_px
    return unshift_edges(corners_px, camera.edge_shift_px)


def _weights(covariance_px2: FloatArray | None, count: int) -> tuple[NDArray[np.bool_], FloatArray | None]:
    """Which markers' covariances are known, and covariances (M, 1, 8, 8) to weigh by; None for equal weights."""
    if covariance_px2 is None:
        return np.zeros(count, dtype=bool), None
    known = np.all(np.isfinite(covariance_px2), axis=(1, 2))
    return known, np.where(known[:, None, None], covariance_px2, np.eye(COORDINATES))[:, None]


def _ordered(solved: Solved, covariance: FloatArray, limit_px: FloatArray) -> MarkerPoses:
    """The likelier solution first; a second one that is the same, or is still on its way to the first, is left out."""
    T, rms_px, settled = solved.T.reshape(-1, 2, 4, 4), solved.rms_px.reshape(-1, 2), solved.settled.reshape(-1, 2)
    chi2 = np.where(rms_px <= limit_px[:, None], solved.chi2.reshape(-1, 2), np.inf)  # NaN compares false
    rows, order = np.arange(len(T))[:, None], np.argsort(chi2, axis=1)
    absent = np.isinf(chi2[rows, order])
    absent[:, 1] |= ~settled[rows, order][:, 1] | same_pose(T[:, 0], T[:, 1], solved.information[::2])
    gone = absent[..., None, None]
    return MarkerPoses(
        np.where(gone, np.nan, T[rows, order]),
        np.where(absent, np.nan, rms_px[rows, order]),
        np.where(gone, np.nan, covariance[rows, order]),
    )


def same_pose(T_a: FloatArray, T_b: FloatArray, information: FloatArray) -> NDArray[np.bool_]:
    """Whether (N,) two solutions (N, 4, 4) are one, given the information (N, 6, 6) of the first; False for NaN."""
    back = np.swapaxes(T_a[:, :3, :3], -1, -2)
    turn = back @ T_b[:, :3, :3]
    # The twist between them, to first order: they are close, or else clearly not one.
    w = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], -1
    )
    v = (back @ (T_b[:, :3, 3] - T_a[:, :3, 3])[..., None])[..., 0]
    xi = np.concatenate([v, w], axis=-1)
    return np.einsum("ni,nij,nj->n", xi, information, xi) < SAME_SQUARED


def square_covariance(sights: Sights, T: FloatArray, information: FloatArray) -> FloatArray:
    """Covariances (N, 6, 6) of the right perturbation [m, rad] of single squares' poses (N, 4, 4); NaN for NaN.

    `information` is theirs to first order. It is taken anew with the square turned towards the line of sight by
    FRONT_TURN_SIGMAS standard deviations of its tilt (not beyond): noise makes a frontal square seem tilted, and at
    that tilt the corners would tell the pose better than they do. Without the turn the normalised squared error is up
    to 1.8 times too large at frontal views (corners to 0.1 px, 0.6 m), with it up to 1.2.

    The other solution of the pose, where there is one, may lie outside. A square of whose pose the corners leave
    something open, such as one seen exactly from its edge, gives infinite variances.
    """
    first_order = inverse_information(information)
    return inverse_information(information_at(sights, _turned_to_front(T, first_order)))


def _turned_to_front(T: FloatArray, covariance: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) turned to the line of sight by FRONT_TURN_SIGMAS of their rotations' largest deviations."""
    rotation = covariance[:, 3:, 3:]
    known = np.all(np.isfinite(rotation), axis=(-2, -1))
    variance = np.linalg.eigvalsh(np.where(known[:, None, None], rotation, 0.0))[:, -1]
    normal, towards = T[:, :3, 2], -T[:, :3, 3]
    across = cross3(normal, towards)
    length = np.sqrt(np.einsum("ni,ni->n", across, across))
    tilt_rad = np.arctan2(length, np.sum(normal * towards, axis=-1))
    turn_rad = np.minimum(tilt_rad, FRONT_TURN_SIGMAS * np.sqrt(np.maximum(variance, 0.0)))
    axis = across * (turn_rad / np.where(length > 0, length, 1.0))[:, None]
    turned = np.array(T)
    turned[:, :3, :3] = se3.exp_so3(axis) @ T[:, :3, :3]
    return turned


def inverse_information(information: FloatArray) -> FloatArray:
    """Covariances (N, 6, 6) of information matrices; infinite variances where one is singular, NaN for NaN."""
    deviation = 1.0 / np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), np.finfo(np.float64).tiny))
    scaled = information * deviation[:, :, None] * deviation[:, None, :]
    known = np.all(np.isfinite(scaled), axis=(-2, -1))
    regular = np.linalg.det(np.where(known[:, None, None], scaled, np.eye(6))) > SINGULAR_DETERMINANT
    inverse = np.linalg.inv(np.where((known & regular)[:, None, None], scaled, np.eye(6)))
    covariance = inverse * deviation[:, :, None] * deviation[:, None, :]
    covariance[known & ~regular] = np.diag(np.full(6, np.inf))
    covariance[~known] = np.nan
    return covariance


def viewing_angles(T_cam_marker: FloatArray) -> FloatArray:
    """Angles (...,) rad between the markers' normals and the lines of sight to them: 0 from the front; NaN for NaN."""
    normal, towards = T_cam_marker[..., :3, 2], -T_cam_marker[..., :3, 3]
    across = np.linalg.norm(np.cross(normal, towards), axis=-1)
    return np.arctan2(across, np.sum(normal * towards, axis=-1))
