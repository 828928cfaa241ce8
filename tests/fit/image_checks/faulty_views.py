"""Simulated sessions in which a marker slips or the camera is touched, for a whole fit to meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.intrinsics import project
from station.fit.image.views import Views
from station.kinematics import se3
from station.logs import PoseLog
from station.perception.pose import estimate_poses
from station.tracking import track_parts
from tests.fit.image.seen_objects import SIZE_M
from tests.fit.image.simulated_views import Watched
from tests.fit.image_checks.watched_trees import Wrong


def with_fault(watched: Watched, wrong: Wrong) -> tuple[PoseLog, Views]:
    """What tracking makes of a session's corners after something went wrong in it: poses, and views."""
    views = watched.views
    part, t = views.part[views.marker], views.t_s[views.frame]
    T = watched.made.T_ref_part[views.frame, part]
    after = t >= wrong.t_s
    share = t / views.t_s[-1]
    twist = np.outer(after, wrong.camera) + np.outer(share, wrong.drift)
    points = views.points_m[views.marker]
    middle = points.mean(axis=1, keepdims=True)
    slipped = (views.marker == wrong.marker) & after
    T_part_marker = watched.seen.T_part_marker[views.marker]
    slip = T_part_marker @ se3.exp(np.where(slipped[:, None], wrong.move, 0.0)) @ se3.inverse(T_part_marker)
    assert np.allclose(T_part_marker[:, :3, 3], middle[:, 0])
    moved = se3.inverse(se3.exp(twist)) @ T @ slip
    p_cam = points @ np.swapaxes(moved[:, :3, :3], -1, -2) + moved[:, None, :3, 3]
    old_cam = points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]
    px = views.corners_px + project(watched.true_camera, p_cam) - project(watched.true_camera, old_cam)
    both = estimate_poses(px, SIZE_M, views.camera, views.covariance_px2)
    T_ref_part = both.T_cam_marker @ se3.inverse(T_part_marker)[:, None]
    faulty = replace(views, corners_px=px, T_ref_part=T_ref_part)
    observations = replace(watched.observations, corners_px=px, T_cam_marker=both.T_cam_marker, rms_px=both.rms_px)
    sigma_px = None if watched.seeing.correlated else watched.seeing.stated * watched.seeing.sigma_px
    poses = track_parts(observations, watched.table, views.camera, sigma_px=sigma_px, readout_s=views.readout_s).poses
    return poses, faulty
