"""Frames to marker observations to a PoseLog: corners weighed, both candidates of a pose kept, one chosen over time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.fit.image.views import Views
from station.kinematics import se3
from station.logs import FloatArray, PoseLog
from station.perception import pose
from station.perception.choice import Choice, choose_over_time, chosen_poses
from station.perception.corner_noise import evidence_weights, stated_covariance, total_covariance
from station.perception.corners import Detections
from station.perception.hypotheses import PoseHypotheses, estimate_hypotheses, part_of_row
from station.perception.joint_covariance import joint_covariance
from station.perception.marker_tracker import MarkerTracker
from station.perception.markers import MarkerTable
from station.perception.neighbours import choose_by_neighbours
from station.perception.observations import FrameMarkers, ObservationBuilder, ObservationLog
from station.perception.pose import UNIT_CORNERS, MarkerPoses, estimate_poses
from station.perception.rolling_shutter import at_frame_time, straightened


def observe(detections: Detections, table: MarkerTable, camera: CameraModel) -> FrameMarkers:
    """Those of a frame's detections that are in the table and have a pose, with their poses."""
    size_m = table.sizes_m(detections.ids)
    listed = np.flatnonzero(~np.isnan(size_m))
    corners_px = detections.corners_px[listed]
    joint_px2 = joint_covariance(corners_px, detections.covariance_px2[listed])
    poses = estimate_poses(corners_px, size_m[listed], camera, joint_px2)
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
    detector = MarkerTracker(table.dictionary, camera, [marker.id for marker in table.markers])
    builder = ObservationBuilder()
    for t_s, image in frames:  # images come one at a time
        builder.add(t_s, observe(detector.detect(image), table, camera))
    return builder.build()


def reestimate(observations: ObservationLog, table: MarkerTable, camera: CameraModel) -> ObservationLog:
    """The same corners with the poses that another camera model, such as one with an edge shift, gives them."""
    size_m = table.sizes_m(observations.marker_id)
    listed = ~np.isnan(size_m)
    T = np.full(observations.T_cam_marker.shape, np.nan)
    rms_px = np.full(observations.rms_px.shape, np.nan)
    covariance = np.full((*rms_px.shape, 6, 6), np.nan)
    corners_px = observations.corners_px[listed]
    joint_px2 = joint_covariance(corners_px, observations.corner_covariance_px2[listed])
    poses = estimate_poses(corners_px, size_m[listed], camera, joint_px2)
    T[listed], rms_px[listed], covariance[listed] = poses.T_cam_marker, poses.rms_px, poses.covariance
    return observations.with_poses(MarkerPoses(T, rms_px, covariance))


def viewing_angles(observations: ObservationLog) -> FloatArray:
    """(N,) rad between each marker's normal and the line of sight to it, by its better pose: 0 from the front."""
    return pose.viewing_angles(observations.T_cam_marker[:, 0])


def viewing_angles_of_parts(observations: ObservationLog, table: MarkerTable) -> FloatArray:
    """(F, K) rad: the least oblique view of each part's markers in each frame, parts as in the table; NaN if unseen."""
    part = part_of_row(observations, table)
    angle_rad = viewing_angles(observations)
    least = np.full((len(observations.t_s), len(table.parts)), np.inf)
    listed = (part >= 0) & ~np.isnan(angle_rad)
    np.minimum.at(least, (observations.frame[listed], part[listed]), angle_rad[listed])
    return np.where(np.isfinite(least), least, np.nan)


@dataclass(frozen=True, eq=False)
class TrackedParts:
    """Parts followed through a log: both candidates of every pose, and which of them was chosen."""

    hypotheses: PoseHypotheses
    choice: Choice

    @property
    def poses(self) -> PoseLog:
        """The chosen poses in the camera's frame, with covariances; a part without a usable marker is all NaN."""
        return chosen_poses(self.hypotheses, self.choice)


def track_parts(
    observations: ObservationLog,
    table: MarkerTable,
    camera: CameraModel,
    *,
    sigma_px: float | None = None,
    readout_s: float | None = None,
) -> TrackedParts:
    """Poses of the table's parts in the camera's frame at the observations' times.

    Args:
        observations: their corners, times, and how well each marker alone could be fitted; poses are estimated anew.
        table: markers that aren't in it are left out; the result's parts are its parts, in its order.
        camera: the camera that saw them.
        sigma_px: standard deviation of a corner coordinate, in place of the covariances that the detector stated and of
            what the reprojection errors tell.
        readout_s: time from the first to the last row of a rolling shutter; the camera's own if None.
    """
    readout_s = camera.readout_s if readout_s is None else readout_s
    covariance_px2 = total_covariance(observations, table.sizes_m(observations.marker_id), camera, sigma_px)
    weight = evidence_weights(observations)
    if readout_s:
        observations = straightened(observations, camera.size_px[1], readout_s)
        observations, covariance_px2 = at_frame_time(observations, covariance_px2, camera.size_px[1], readout_s)
    hypotheses = estimate_hypotheses(observations, table, camera, covariance_px2, weight)
    return TrackedParts(hypotheses, choose_by_neighbours(hypotheses, choose_over_time(hypotheses)))


def estimate_pose_log(
    observations: ObservationLog,
    table: MarkerTable,
    camera: CameraModel,
    *,
    sigma_px: float | None = None,
    readout_s: float | None = None,
) -> PoseLog:
    """The poses of `track_parts` alone."""
    return track_parts(observations, table, camera, sigma_px=sigma_px, readout_s=readout_s).poses


def views_of(
    observations: ObservationLog,
    table: MarkerTable,
    camera: CameraModel,
    *,
    sigma_px: float | None = None,
    readout_s: float | None = None,
) -> Views:
    """A log's corners as a fit in the image takes them: on their parts, as detected, each with its covariance.

    Markers that aren't in the table are left out; frames stay all. What a rolling shutter does to edges is taken out,
    each corner stays at its own row's time.

    Args:
        observations: corners, times, and poses by this very camera.
        table: the result's markers and parts are its, in its order.
        camera: the camera that saw them; what it says of its edge shift and its focal lengths are priors.
        sigma_px: standard deviation of a corner coordinate, as for `track_parts`.
        readout_s: time from the first to the last row of a rolling shutter; the camera's own if None.
    """
    readout_s = (camera.readout_s or 0.0) if readout_s is None else readout_s
    covariance_px2 = total_covariance(observations, table.sizes_m(observations.marker_id), camera, sigma_px)
    if readout_s:
        observations = straightened(observations, camera.size_px[1], readout_s)
    return _views(observations, covariance_px2, table, camera, readout_s)


def views_of_frame(t_s: float, markers: FrameMarkers, table: MarkerTable, camera: CameraModel) -> Views:
    """The corners of one frame alone, with the covariances that the detector stated, for estimation while it records.

    Args:
        t_s: of the frame.
        markers: those of the table count.
        table: the result's markers and parts are its, in its order.
        camera: that saw them, with the readout of its rolling shutter.
    """
    builder = ObservationBuilder()
    builder.add(t_s, markers)
    observations = builder.build()
    return _views(observations, stated_covariance(observations), table, camera, camera.readout_s or 0.0)


def _views(
    observations: ObservationLog,
    covariance_px2: FloatArray,
    table: MarkerTable,
    camera: CameraModel,
    readout_s: float,
) -> Views:
    marker = table.rows(observations.marker_id)
    rows = np.flatnonzero(marker >= 0)
    mounts = np.stack([each.mount for each in table.markers])
    sides_m = np.array([each.size_m for each in table.markers])[:, None, None]
    points_m = (sides_m * UNIT_CORNERS) @ np.swapaxes(mounts[:, :3, :3], -1, -2) + mounts[:, None, :3, 3]
    return Views(
        t_s=observations.t_s,
        parts=table.parts,
        marker_id=np.array([each.id for each in table.markers], dtype=np.int64),
        part=np.array([table.parts.index(each.part) for each in table.markers], dtype=np.int64),
        points_m=points_m,
        frame=observations.frame[rows],
        marker=marker[rows],
        corners_px=observations.corners_px[rows],
        covariance_px2=covariance_px2[rows],
        T_ref_part=observations.T_cam_marker[rows] @ se3.inverse(mounts[marker[rows]])[:, None],
        camera=camera,
        readout_s=readout_s,
    )
