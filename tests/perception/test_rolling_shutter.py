"""A rolling shutter: corners that were seen at different times, put where they were at their frame's own."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray, project
from station.kinematics import se3
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import ObservationLog
from station.perception.pose import UNIT_CORNERS, estimate_poses
from station.perception.rolling_shutter import at_frame_time, row_delay_s, straightened
from station.tracking import track_parts, views_of
from tests.noisy_corners import joint

SIZE_M, FPS, READOUT_S, SIGMA_PX = 0.05, 30.0, 0.025, 0.03
TABLE = MarkerTable("DICT_4X4_50", (Marker(4, "lid", SIZE_M),))


def turning(t_s: FloatArray) -> FloatArray:
    """(..., 4, 4) a marker on the end of a link of 12 cm that swings in front of the camera, up to 170 deg/s."""
    swing = 1.0 * np.sin(3.0 * t_s)
    zero = np.zeros_like(t_s)
    pivot = se3.pose(np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(np.array([0.5, 0.3, 0.0])), np.array([0.0, 0.05, 0.6]))
    link = se3.pose(np.eye(3), np.array([0.0, 0.12, 0.0]))
    return pivot @ se3.exp(np.stack([zero, zero, zero, zero, 0.3 * swing, swing], axis=-1)) @ link


def rolling_points(camera: CameraModel, t_s: FloatArray, readout_s: float, points_m: FloatArray) -> FloatArray:
    """(F, n, 2) px of points (n, 3) on the marker, each where it was when its row was read."""
    px = np.tile(np.array(camera.size_px) / 2, (len(t_s), len(points_m), 1))
    for _ in range(10):  # a point's row depends on when it is read
        T = turning(t_s[:, None] + row_delay_s(px[..., 1], camera.size_px[1], readout_s))
        px = project(camera, (T[..., :3, :3] @ points_m[..., None])[..., 0] + T[..., :3, 3])
    return px


def own_corners(camera: CameraModel, t_s: FloatArray, readout_s: float) -> FloatArray:
    """(F, 4, 2) px, each corner where it was when its row was read."""
    return rolling_points(camera, t_s, readout_s, SIZE_M * UNIT_CORNERS)


def meeting_lines(camera: CameraModel, t_s: FloatArray, readout_s: float) -> FloatArray:
    """(F, 4, 2) px where the lines meet that fit the four edges best, clear of the corners."""
    corners_m = SIZE_M * UNIT_CORNERS
    share = np.linspace(0.04, 0.96, 24)[:, None]
    edges_m = [(1 - share) * corners_m[e] + share * corners_m[(e + 1) % 4] for e in range(4)]
    px = rolling_points(camera, t_s, readout_s, np.concatenate(edges_m)).reshape(len(t_s), 4, len(share), 2)
    middle = px.mean(axis=2)
    normal = np.linalg.svd(px - middle[:, :, None], full_matrices=False)[2][..., 1, :]
    offset = np.sum(normal * middle, axis=-1)
    pairs = np.stack([np.roll(normal, 1, axis=1), normal], axis=2)
    return np.linalg.solve(pairs, np.stack([np.roll(offset, 1, axis=1), offset], axis=2)[..., None])[..., 0]


def rolling_corners(camera: CameraModel, t_s: FloatArray, readout_s: float) -> FloatArray:
    """(F, 4, 2) px as a detector tells them that fits lines to edges, what the lens bends them by taken out."""
    by_lens = meeting_lines(camera, t_s, 0.0) - own_corners(camera, t_s, 0.0)
    return meeting_lines(camera, t_s, readout_s) - by_lens


def watched(camera: CameraModel, frames: int = 120, *, sigma_px: float = SIGMA_PX) -> ObservationLog:
    t_s = np.arange(frames) / FPS
    px = rolling_corners(camera, t_s, READOUT_S)
    px = px + sigma_px * np.random.default_rng(0).standard_normal(px.shape)
    covariance_px2 = np.broadcast_to(SIGMA_PX**2 * np.eye(2), (frames, 4, 2, 2))
    poses = estimate_poses(px, SIZE_M, camera, joint(covariance_px2))
    rows, ids = np.arange(frames), np.full(frames, 4)
    return ObservationLog(t_s, rows, ids, px, covariance_px2, poses.T_cam_marker, poses.rms_px)


def errors_deg(observations: ObservationLog, camera: CameraModel, readout_s: float) -> FloatArray:
    T = track_parts(observations, TABLE, camera, readout_s=readout_s).poses.T_ref_part[:, 0]
    truth = turning(observations.t_s)
    return np.rad2deg(se3.angle(np.swapaxes(truth[:, :3, :3], -1, -2) @ T[:, :3, :3]))


def test_an_uncorrected_rolling_shutter_costs_tenths_of_a_degree_and_a_corrected_one_little(
    camera: CameraModel,
) -> None:
    observations = watched(camera)
    plain, corrected = (np.sqrt(np.mean(errors_deg(observations, camera, r) ** 2)) for r in (0.0, READOUT_S))
    still = replace(observations, corners_px=rolling_corners(camera, observations.t_s, 0.0))
    noise = np.random.default_rng(1).normal(size=still.corners_px.shape) * SIGMA_PX
    floor = np.sqrt(np.mean(errors_deg(replace(still, corners_px=still.corners_px + noise), camera, 0.0) ** 2))
    assert plain > 0.5  # deg
    assert corrected < 1.25 * floor


def test_the_cameras_own_readout_is_used_unless_another_is_given(camera: CameraModel) -> None:
    observations = watched(camera)
    by_camera = track_parts(observations, TABLE, replace(camera, readout_s=READOUT_S)).poses.T_ref_part
    given = track_parts(observations, TABLE, camera, readout_s=READOUT_S).poses.T_ref_part
    none = track_parts(observations, TABLE, replace(camera, readout_s=READOUT_S), readout_s=0.0).poses.T_ref_part
    np.testing.assert_array_equal(by_camera, given)
    assert np.abs(none - given).max() > 1e-3


def test_covariances_stay_honest(camera: CameraModel) -> None:
    observations = watched(camera, 400)
    log = track_parts(observations, TABLE, camera, sigma_px=SIGMA_PX, readout_s=READOUT_S).poses
    assert log.covariance is not None
    error = se3.log(se3.inverse(turning(observations.t_s)) @ log.T_ref_part[:, 0])
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(log.covariance[:, 0]), error) / 6
    assert 0.8 < squared.mean() < 1.25


@pytest.mark.parametrize("rows", [[5], [5, 6], [5, 6, 7]])
def test_the_fewer_neighbours_a_frame_has_the_less_certain_it_is(camera: CameraModel, rows: list[int]) -> None:
    whole = watched(camera, sigma_px=0.0)
    kept = np.array([0, 1, 2, *(20 + n for n in rows)])  # the first three tell the typical speed
    some = replace(
        whole,
        frame=whole.frame[kept],
        marker_id=whole.marker_id[kept],
        corners_px=whole.corners_px[kept],
        corner_covariance_px2=whole.corner_covariance_px2[kept],
        T_cam_marker=whole.T_cam_marker[kept],
        rms_px=whole.rms_px[kept],
    )
    moved, covariance_px2 = at_frame_time(some, joint(some.corner_covariance_px2), camera.size_px[1], READOUT_S)
    exact = rolling_corners(camera, whole.t_s, 0.0)[kept]
    off_px = np.abs(moved.corners_px - exact)[3:].max()
    sigma_px = np.sqrt(np.diagonal(covariance_px2, axis1=-2, axis2=-1)[3:].max())
    if len(rows) == 1:
        assert off_px > 1.0 and sigma_px > 0.3 * off_px  # it may have moved, as fast as others do
    else:
        assert off_px < 0.3 and sigma_px < 1.6 * SIGMA_PX


def test_a_marker_that_stands_still_stays(camera: CameraModel) -> None:
    seen = watched(camera, 3, sigma_px=0.0)
    still = replace(seen, corners_px=np.repeat(seen.corners_px[:1], 3, axis=0))
    moved, _ = at_frame_time(still, joint(still.corner_covariance_px2), camera.size_px[1], READOUT_S)
    np.testing.assert_allclose(moved.corners_px, still.corners_px, atol=1e-9)  # px


def test_corners_of_bent_edges_are_where_their_rows_saw_them(camera: CameraModel) -> None:
    seen = watched(camera, sigma_px=0.0)
    straight = straightened(seen, camera.size_px[1], READOUT_S)
    own = own_corners(camera, seen.t_s, READOUT_S)[1:-1]
    bent_px, left_px = (np.abs(of.corners_px[1:-1] - own).max() for of in (seen, straight))
    assert bent_px > 0.08
    assert left_px < 0.05 * bent_px
    in_image = views_of(seen, TABLE, camera, readout_s=READOUT_S)
    np.testing.assert_array_equal(in_image.corners_px, straight.corners_px)


def test_a_marker_that_is_seen_once_stays_as_it_is(camera: CameraModel) -> None:
    seen = watched(camera, 1, sigma_px=0.0)
    np.testing.assert_allclose(straightened(seen, camera.size_px[1], READOUT_S).corners_px, seen.corners_px, atol=1e-9)
