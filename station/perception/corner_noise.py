"""How far corners are to be trusted: their covariances scaled to the residuals of a whole log, and what those hide.

A marker's eight coordinates less the six of its pose leave two: residuals say how noisy corners are only over many
markers, and say nothing of errors that look like another pose. Those (edges shifted by bloom, the lens model, the
print) have a floor of their own. It is common to all pictures of a marker that doesn't move.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from calibration.intrinsics import CameraModel
from station.logs import FloatArray
from station.perception.joint_covariance import joint_covariance
from station.perception.observations import COORDINATES, IntArray, ObservationLog
from station.perception.pose import squared_corner_errors

# Eight coordinates less the six parameters of a pose.
RESIDUAL_DOF = COORDINATES - 6

# Standard deviation of a corner coordinate by what no residual shows and the detector doesn't state (a floor of its own
# is in its covariances). On rendered pictures, whose lens model is exact, next to nothing is left: with it the mean of
# poses' normalised squared errors is 0.82 (cells of `pose_covariance` to 60 degrees: 0.53 to 1.9). What it is on a real
# camera isn't measured.
UNSEEN_SIGMA_PX = 0.003
# The part of a corner's variance that is the same in all pictures of a marker that stands still: 0.63 on rendered ones.
COMMON_SHARE = 0.6
# Corners of unknown covariance are never taken to be better than this.
SMALLEST_SIGMA_PX = 0.05
# The detector's word on its noise counts like the residuals of this many markers.
PRIOR_MARKERS = 20
# Pictures in which a marker's corners moved by less than this show the same errors.
SAME_LOOK_PX = 0.5


def chi2_quantile(probability: float, dof: int | IntArray) -> FloatArray:
    """Quantile of the chi-squared distribution with `dof` degrees of freedom."""
    return np.asarray(2.0 * gammaincinv(np.asarray(dof) / 2.0, probability), dtype=np.float64)


def estimate_sigma_px(rms_px: FloatArray) -> float:
    """Standard deviation of a corner coordinate from poses' RMS errors (N,), px; at least SMALLEST_SIGMA_PX.

    Eight residuals less six parameters leave chi-squared of 2 degrees of freedom; its median bears half of the log bad.
    """
    squared = COORDINATES * rms_px[np.isfinite(rms_px)] ** 2
    if not squared.size:
        return SMALLEST_SIGMA_PX
    return max(float(np.sqrt(_variance(squared))), SMALLEST_SIGMA_PX)


def _variance(squared: FloatArray) -> float:
    return float(np.median(squared) / chi2_quantile(0.5, RESIDUAL_DOF))


def estimate_scale(squared: FloatArray) -> float:
    """Factor on stated covariances that poses' squared errors (N,), in their units, ask for; 1 where there are few."""
    squared = squared[np.isfinite(squared)]
    if not squared.size:
        return 1.0
    return (len(squared) * _variance(squared) + PRIOR_MARKERS) / (len(squared) + PRIOR_MARKERS)


def total_covariance(
    observations: ObservationLog, size_m: FloatArray, camera: CameraModel, sigma_px: float | None = None
) -> FloatArray:
    """Covariances (N, 8, 8) px^2 of a log's corners, coordinates u0, v0, u1, ..., for estimation.

    Those that the detector stated are scaled by one factor of the log and have UNSEEN_SIGMA_PX added. Where it stated
    none, coordinates are independent with the standard deviation that the residuals of those markers show. A given
    `sigma_px` replaces all.

    Args:
        observations: with poses by this very camera.
        size_m: (N,) of the markers; NaN where nobody knows.
        camera: that saw them.
        sigma_px: standard deviation of a coordinate.
    """
    one = np.eye(COORDINATES)
    if sigma_px is not None:
        return np.broadcast_to(sigma_px**2 * one, (len(observations), COORDINATES, COORDINATES))
    stated = joint_covariance(observations.corners_px, observations.corner_covariance_px2)
    known = np.all(np.isfinite(stated), axis=(1, 2))
    total = np.empty(stated.shape)
    total[~known] = estimate_sigma_px(observations.rms_px[~known, 0]) ** 2 * one
    better = observations.T_cam_marker[:, 0]
    squared = squared_corner_errors(better, observations.corners_px, size_m, camera, stated)
    total[known] = estimate_scale(squared) * stated[known] + UNSEEN_SIGMA_PX**2 * one
    return total


def stated_covariance(observations: ObservationLog) -> FloatArray:
    """Covariances (N, 8, 8) px^2 of corners as the detector stated them, with UNSEEN_SIGMA_PX; residuals aren't asked.

    Where it stated none, coordinates are independent with SMALLEST_SIGMA_PX.
    """
    stated = joint_covariance(observations.corners_px, observations.corner_covariance_px2)
    known = np.all(np.isfinite(stated), axis=(1, 2), keepdims=True)
    one = np.eye(COORDINATES)
    return np.where(known, stated + UNSEEN_SIGMA_PX**2 * one, SMALLEST_SIGMA_PX**2 * one)


def evidence_weights(observations: ObservationLog) -> FloatArray:
    """What each observation's squared errors count (N,), 1 at most, beside others that show the same errors.

    The mean of n pictures of a marker that stands still has 1 / n of the variance that differs between them, but all of
    the share c that doesn't: the squared errors of each count 1 / (1 + (n - 1) c).
    """
    return 1.0 / (1.0 + COMMON_SHARE * (_looks(observations) - 1.0))


def _looks(observations: ObservationLog) -> FloatArray:
    """(N,) in how many sightings on end each marker's corners stay within SAME_LOOK_PX of the first of them."""
    looks = np.ones(len(observations))
    for marker in np.unique(observations.marker_id):  # a few markers
        rows = np.flatnonzero(observations.marker_id == marker)
        px = observations.corners_px[rows]
        first = 0
        while first < len(rows):
            moved = np.abs(px[first:] - px[first]).max(axis=(1, 2)) > SAME_LOOK_PX
            count = int(np.argmax(moved)) if moved.any() else len(moved)
            looks[rows[first : first + count]] = count
            first += count
    return looks
