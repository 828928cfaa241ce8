"""Frames to marker observations to a PoseLog: solutions chosen over time, bad views gated, a part's markers fused."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from calibration.intrinsics import CameraModel
from station.kinematics import se3
from station.logs import FloatArray, PoseLog
from station.perception import pose
from station.perception.corners import Detections, MarkerDetector
from station.perception.markers import MarkerTable
from station.perception.observations import CORNERS, SOLUTIONS, FrameMarkers, ObservationBuilder, ObservationLog
from station.perception.pose import MarkerPoses, estimate_poses, pose_covariance

IntArray = NDArray[np.int64]

CAMERA_FRAME = "camera"

# Poses are unreliable past 70 to 72 deg between the normal and the line of sight (measured on rendered frames).
TILT_GATE_RAD = np.deg2rad(75.0)
# Corner noise is never taken as less: compression, edge shift and lens model err without showing in residuals.
SMALLEST_SIGMA_PX = 0.05
# A marker whose reprojection error is above this many sigma is not the square that the model thinks it is.
RMS_GATE_SIGMAS = 5.0
COORDINATES = 2 * CORNERS
# Eight coordinates less the six parameters of a pose.
RESIDUAL_DOF = COORDINATES - 6
# Residuals and disagreements up to this quantile of their distribution are chance; beyond, they inflate covariances.
CHANCE = 0.99

# From one sighting to the next a marker's rotation steps like others of its own; smaller typical steps than this are
# taken as this, so that a static marker in a noiseless log doesn't forbid all motion.
SMALLEST_STEP_RAD = np.deg2rad(0.3)

FUSION_STEPS = 5


def chi2_quantile(probability: float, dof: int | IntArray) -> FloatArray:
    """Quantile of the chi-squared distribution with `dof` degrees of freedom."""
    return np.asarray(2.0 * gammaincinv(np.asarray(dof) / 2.0, probability), dtype=np.float64)


def observe(detections: Detections, table: MarkerTable, camera: CameraModel) -> FrameMarkers:
    """Those of a frame's detections that are in the table and have a pose, with their poses."""
    size_m = table.sizes_m(detections.ids)
    listed = np.flatnonzero(~np.isnan(size_m))
    poses = estimate_poses(detections.corners_px[listed], size_m[listed], camera)
    posed = ~np.isnan(poses.rms_px[:, 0])
    rows = listed[posed]
    return FrameMarkers(
        marker_id=detections.ids[rows],
        corners_px=detections.corners_px[rows],
        corner_covariance_px2=detections.covariance_px2[rows],
        T_cam_marker=poses.T_cam_marker[posed],
        rms_px=poses.rms_px[posed],
    )


def observe_frames(
    frames: Iterable[tuple[float, NDArray[np.uint8]]], table: MarkerTable, camera: CameraModel
) -> ObservationLog:
    """Observations of all frames, each (t_s, image); frames without a marker keep their time."""
    detector, builder = MarkerDetector(table.dictionary), ObservationBuilder()
    for t_s, image in frames:  # images come one at a time
        builder.add(t_s, observe(detector.detect(image), table, camera))
    return builder.build()


def reestimate(observations: ObservationLog, table: MarkerTable, camera: CameraModel) -> ObservationLog:
    """The same corners with the poses that another camera model, such as one with an edge shift, gives them."""
    size_m = table.sizes_m(observations.marker_id)
    listed = ~np.isnan(size_m)
    T = np.full(observations.T_cam_marker.shape, np.nan)
    rms_px = np.full(observations.rms_px.shape, np.nan)
    poses = estimate_poses(observations.corners_px[listed], size_m[listed], camera)
    T[listed], rms_px[listed] = poses.T_cam_marker, poses.rms_px
    return observations.with_poses(MarkerPoses(T, rms_px))


def viewing_angles(observations: ObservationLog) -> FloatArray:
    """(N,) rad between each marker's normal and the line of sight to it, by its better pose: 0 from the front."""
    return pose.viewing_angles(observations.T_cam_marker[:, 0])


def viewing_angles_of_parts(observations: ObservationLog, table: MarkerTable) -> FloatArray:
    """(F, K) rad: the least oblique view of each part's markers in each frame, parts as in the table; NaN if unseen."""
    part = _part_of_row(observations, table)
    angle_rad = viewing_angles(observations)
    least = np.full((len(observations.t_s), len(table.parts)), np.inf)
    listed = (part >= 0) & ~np.isnan(angle_rad)
    np.minimum.at(least, (observations.frame[listed], part[listed]), angle_rad[listed])
    return np.where(np.isfinite(least), least, np.nan)


def _part_of_row(observations: ObservationLog, table: MarkerTable) -> IntArray:
    """(N,) column of each observation's part; -1 for markers that aren't in the table."""
    part_of_marker = [table.parts.index(marker.part) for marker in table.markers]
    return np.append(part_of_marker, -1)[table.rows(observations.marker_id)]


def estimate_sigma_px(rms_px: FloatArray) -> float:
    """Standard deviation of a corner coordinate from poses' RMS errors (N,), px; at least SMALLEST_SIGMA_PX.

    Eight residuals less six parameters leave chi-squared of 2 degrees of freedom; its median bears half of the log bad.
    """
    squared = COORDINATES * rms_px[np.isfinite(rms_px)] ** 2
    if not squared.size:
        return SMALLEST_SIGMA_PX
    return max(float(np.sqrt(np.median(squared) / chi2_quantile(0.5, RESIDUAL_DOF))), SMALLEST_SIGMA_PX)


def _sightings(observations: ObservationLog) -> IntArray:
    """(n, S) rows of the log: column s holds marker s's sightings in the order of time, -1 beyond the last."""
    ids, column = np.unique(observations.marker_id, return_inverse=True)
    counts = np.bincount(column, minlength=len(ids))
    order = np.lexsort((observations.frame, column))
    place = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows = np.full((counts.max(initial=0), len(ids)), -1)
    rows[place, column[order]] = order
    return rows


def _step_costs(observations: ObservationLog, rows: IntArray) -> FloatArray:
    """(n - 1, S, 2, 2) costs log(1 + (angle / step)^2) from solution i at one sighting to solution j at the next.

    The step is what this marker typically turns by between sightings (the median of the smallest of the four angles),
    scaled by the time between these two. Heavy tails: a marker may jump, but flipping to and fro costs more than noise.
    """
    both = (rows[:-1] >= 0) & (rows[1:] >= 0)
    R = observations.T_cam_marker[..., :3, :3]
    before, after = R[rows[:-1]], R[rows[1:]]
    angle_rad = se3.angle(np.swapaxes(before, -1, -2)[:, :, :, None] @ after[:, :, None])
    angle_rad[~both] = np.nan
    dt_s = np.where(both, np.diff(observations.t_s[observations.frame[rows]], axis=0), np.nan)
    costs = np.zeros(angle_rad.shape)
    for s in np.flatnonzero(both.any(axis=0)):  # a few markers; each has its own typical step
        smallest_rad = np.where(np.isnan(angle_rad[:, s]), np.inf, angle_rad[:, s]).min(axis=(-1, -2))
        typical_rad = max(float(np.median(smallest_rad[both[:, s]])), SMALLEST_STEP_RAD)
        step_rad = np.minimum(typical_rad * dt_s[:, s] / np.median(dt_s[both[:, s], s]), np.pi)
        costs[:, s] = np.log1p((angle_rad[:, s] / step_rad[:, None, None]) ** 2)
    return np.nan_to_num(costs)  # where a solution is missing its own likelihood is zero


def choose_solutions(observations: ObservationLog, sigma_px: float) -> tuple[IntArray, FloatArray]:
    """Which pose solution each observation shows, given the whole log, and the probability (N,) that it does.

    Each marker is a chain of two states: the corners' likelihood of each solution (Gaussian with sigma_px) decides
    where it can, the rotation's continuity where it can't; forward-backward gives each sighting's probabilities.
    """
    rows = _sightings(observations)
    likelihood = -0.5 * COORDINATES * (observations.rms_px / sigma_px) ** 2
    likelihood = np.where(np.isnan(likelihood), -np.inf, likelihood)
    likelihood = np.where(np.isneginf(likelihood).all(axis=1, keepdims=True), 0.0, likelihood)
    emission = np.where(rows[..., None] >= 0, likelihood[rows], 0.0)
    log_step = -_step_costs(observations, rows)
    forward, backward = np.array(emission), np.zeros(emission.shape)
    for n in range(1, len(rows)):  # over time, all markers at once: each sighting needs the one before
        forward[n] += np.logaddexp.reduce(forward[n - 1][:, :, None] + log_step[n - 1], axis=1)
    for n in range(len(rows) - 2, -1, -1):  # and back
        backward[n] = np.logaddexp.reduce(log_step[n] + (emission[n + 1] + backward[n + 1])[:, None, :], axis=2)
    posterior = forward + backward
    posterior -= np.logaddexp.reduce(posterior, axis=-1, keepdims=True)
    by_row = np.zeros((len(observations), SOLUTIONS))
    by_row[rows[rows >= 0]] = posterior[rows >= 0]
    choice = np.argmax(by_row, axis=1)
    return choice, np.exp(np.max(by_row, axis=1))


def _marker_covariance(
    observations: ObservationLog, table: MarkerTable, camera: CameraModel, sigma_px: float, rows: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Chosen poses (N, 4, 4), their covariances (N, 6, 6) and RMS errors (N,) px; covariances only at `rows`.

    A worse residual than chance allows inflates the covariance; a choice that is not certain adds the other solution.
    """
    choice, probability = choose_solutions(observations, sigma_px)
    every = np.arange(len(observations))
    T, rms_px = observations.T_cam_marker[every, choice], observations.rms_px[every, choice]
    other = observations.T_cam_marker[every, 1 - choice]
    chi2 = COORDINATES * (rms_px / sigma_px) ** 2
    inflated_px = sigma_px * np.sqrt(np.maximum(chi2 / chi2_quantile(CHANCE, RESIDUAL_DOF), 1.0))
    covariance = np.full((len(observations), 6, 6), np.nan)
    size_m = table.sizes_m(observations.marker_id[rows])
    covariance[rows] = pose_covariance(T[rows], size_m, camera, inflated_px[rows])
    apart = np.nan_to_num(se3.log(se3.inverse(T[rows]) @ other[rows]))
    covariance[rows] += (1 - probability[rows])[:, None, None] * (apart[:, :, None] * apart[:, None, :])
    return T, covariance, rms_px


def gate(T_cam_marker: FloatArray, rms_px: FloatArray, sigma_px: float) -> NDArray[np.bool_]:
    """Whether (N,) each marker can be used: not too oblique, its corners those of a square; False for NaN."""
    return (pose.viewing_angles(T_cam_marker) <= TILT_GATE_RAD) & (rms_px <= RMS_GATE_SIGMAS * sigma_px)


def fuse_poses(T: FloatArray, covariance: FloatArray, group: IntArray, groups: int) -> tuple[FloatArray, FloatArray]:
    """Information-weighted means (G, 4, 4) of the poses (N, 4, 4) of each group (N,), and covariances (G, 6, 6).

    Gauss-Newton on the sum of squared normalised errors log(T_i^-1 T) (right perturbations), all groups at once; NaN
    for a group without members. Members that disagree beyond chance inflate the covariance.
    """
    information = np.linalg.inv(covariance)
    fused, normal = np.full((groups, 4, 4), np.nan), np.full((groups, 6, 6), np.nan)
    best_last = np.argsort(-np.trace(covariance, axis1=-2, axis2=-1), kind="stable")
    fused[group[best_last]] = T[best_last]
    counts = np.bincount(group, minlength=groups)
    present = np.flatnonzero(counts)
    chi2 = np.zeros(groups)
    for _ in range(FUSION_STEPS):  # Gauss-Newton: a step needs the last
        error = se3.log(se3.inverse(T) @ fused[group])
        J = se3.inverse_right_jacobian(error)
        weighted = np.swapaxes(J, -1, -2) @ information
        normal[present], gradient, chi2 = 0.0, np.zeros((groups, 6)), np.zeros(groups)
        np.add.at(normal, group, weighted @ J)
        np.add.at(gradient, group, (weighted @ error[..., None])[..., 0])
        np.add.at(chi2, group, np.einsum("ni,nij,nj->n", error, information, error))
        step = -np.linalg.solve(normal[present], gradient[present][..., None])[..., 0]
        fused[present] = fused[present] @ se3.exp(step)
    inflation = np.maximum(chi2 / chi2_quantile(CHANCE, np.maximum(6 * (counts - 1), 1)), 1.0)
    fused_covariance = np.full((groups, 6, 6), np.nan)
    fused_covariance[present] = np.linalg.inv(normal[present]) * inflation[present, None, None]
    return fused, fused_covariance


def estimate_pose_log(
    observations: ObservationLog, table: MarkerTable, camera: CameraModel, *, sigma_px: float | None = None
) -> PoseLog:
    """Poses of the table's parts in the camera's frame at the observations' times, with covariances.

    Args:
        observations: with the poses of this very camera (see `reestimate`).
        table: markers that aren't in it are left out; the log's parts are its parts, in its order.
        camera: the camera that saw them.
        sigma_px: standard deviation of a corner coordinate; estimated from the reprojection errors if None.

    A part that no usable marker shows in a frame is all NaN there. Rolling shutter is not corrected.
    """
    part = _part_of_row(observations, table)
    known = (part >= 0) & ~np.isnan(observations.rms_px[:, 0])
    sigma = estimate_sigma_px(observations.rms_px[known, 0]) if sigma_px is None else sigma_px
    T, covariance, rms_px = _marker_covariance(observations, table, camera, sigma, np.flatnonzero(known))
    usable = known & gate(T, rms_px, sigma) & np.all(np.isfinite(covariance), axis=(-2, -1))
    mounts = np.stack([marker.mount for marker in table.markers])[table.rows(observations.marker_id[usable])]
    T_cam_part = T[usable] @ se3.inverse(mounts)
    # T_cam_marker exp(xi) inverse(M) = T_cam_part exp(Ad_M xi)
    Ad = se3.adjoint(mounts)
    part_covariance = Ad @ covariance[usable] @ np.swapaxes(Ad, -1, -2)
    frames, parts = len(observations.t_s), len(table.parts)
    group = observations.frame[usable] * parts + part[usable]
    fused, fused_covariance = fuse_poses(T_cam_part, part_covariance, group, frames * parts)
    return PoseLog(
        t_s=observations.t_s,
        reference=CAMERA_FRAME,
        parts=table.parts,
        T_ref_part=fused.reshape(frames, parts, 4, 4),
        covariance=fused_covariance.reshape(frames, parts, 6, 6),
    )
