from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray
from station.kinematics import se3
from station.perception.edges import shift_edges
from station.perception.pose import (
    estimate_poses,
    pose_covariance,
    reprojection_errors,
    reprojection_jacobian,
    viewing_angles,
)

SIZE_M = 0.05
SIGMA_PX = 0.1


@pytest.fixture(scope="module")
def poses(pose_facing: Callable) -> Callable[..., FloatArray]:
    """poses(tilt_deg, count, seed) -> (count, 4, 4) random markers about 0.6 m away at that tilt."""

    def make(tilt_deg: float, count: int, seed: int = 0) -> FloatArray:
        rng = np.random.default_rng(seed)
        places = rng.uniform((-0.2, -0.15, 0.5), (0.2, 0.15, 0.7), (count, 3))
        turns = rng.uniform(0, 2 * np.pi, (count, 2))
        return np.stack([pose_facing(np.deg2rad(tilt_deg), *turn, p) for turn, p in zip(turns, places, strict=True)])

    return make


@pytest.fixture(scope="module")
def corners(camera: CameraModel, project_corners: Callable) -> Callable[[FloatArray], FloatArray]:
    return lambda T: np.stack([project_corners(pose, SIZE_M, camera) for pose in T])


def angle_rad(T_a: FloatArray, T_b: FloatArray) -> FloatArray:
    return se3.angle(np.swapaxes(T_a[..., :3, :3], -1, -2) @ T_b[..., :3, :3])


def nearest_solution(found: FloatArray, truth: FloatArray) -> FloatArray:
    apart = np.where(np.isnan(found[..., 0, 0]), np.inf, angle_rad(found, truth[:, None]))
    return found[np.arange(len(found)), np.argmin(apart, axis=1)]


def test_the_jacobian_agrees_with_finite_differences(poses: Callable, camera: CameraModel) -> None:
    T = np.concatenate([poses(tilt, 20, seed=tilt) for tilt in (0, 30, 70)])
    size_m, step = np.full(len(T), SIZE_M), 1e-6
    zero = np.zeros((len(T), 4, 2))

    def projected(xi: FloatArray) -> FloatArray:
        return reprojection_errors(T @ se3.exp(xi), zero, size_m, camera)

    numeric = np.stack([(projected(s) - projected(-s)) / (2 * step) for s in step * np.eye(6)], axis=-1)
    np.testing.assert_allclose(reprojection_jacobian(T, size_m, camera), numeric, rtol=1e-6, atol=1e-4)  # px/m, px/rad


def test_reprojection_agrees_with_opencv(poses: Callable, corners: Callable, camera: CameraModel) -> None:
    T = poses(40, 20)
    np.testing.assert_allclose(reprojection_errors(T, corners(T), np.full(20, SIZE_M), camera), 0.0, atol=1e-9)  # px


@pytest.mark.parametrize("tilt_deg", [10, 30, 60, 80])
def test_exact_corners_give_the_exact_pose(poses: Callable, corners: Callable, camera: CameraModel, tilt_deg) -> None:
    T = poses(tilt_deg, 20)
    found = estimate_poses(corners(T), np.full(20, SIZE_M), camera)
    # m and rad; the refinement ends at steps of 1e-5
    np.testing.assert_allclose(se3.log(se3.inverse(T) @ found.T_cam_marker[:, 0]), 0.0, atol=1e-6)
    assert np.all(found.rms_px[:, 0] < 1e-4)
    assert not np.any(found.rms_px[:, 1] < found.rms_px[:, 0])


def test_the_second_solution_is_the_mirrored_one(poses: Callable, corners: Callable, camera: CameraModel) -> None:
    T = poses(20, 30)
    found = estimate_poses(corners(T), np.full(30, SIZE_M), camera)
    assert not np.any(np.isnan(found.rms_px))
    turned = np.rad2deg(angle_rad(found.T_cam_marker[:, 0], found.T_cam_marker[:, 1]))
    assert np.all((turned > 25) & (turned < 50))  # about twice the tilt


@pytest.mark.parametrize("offset_rad", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_a_marker_seen_exactly_from_the_front_has_its_pose(offset_rad: float, project_corners: Callable) -> None:
    camera = CameraModel((640, 480), np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), np.zeros(5))
    T = se3.pose(np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(np.array([offset_rad, 0, 0])), np.array([0, 0, 0.6]))
    found = estimate_poses(project_corners(T, SIZE_M, camera)[None], SIZE_M, camera)
    assert found.rms_px[0, 0] < 1e-3  # OpenCV's IPPE_SQUARE alone is 35 px off here
    assert np.rad2deg(angle_rad(found.T_cam_marker[0, 0], T)) < 0.2
    assert abs(found.T_cam_marker[0, 0, 2, 3] - 0.6) < 1e-5  # m


def test_the_fallback_gives_both_solutions(
    poses: Callable, corners: Callable, camera: CameraModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    import cv2

    T = poses(20, 10)
    expected = estimate_poses(corners(T), SIZE_M, camera)
    solve = cv2.solvePnPGeneric

    def failing(points: FloatArray, px: FloatArray, *args: FloatArray, flags: int) -> tuple:
        ok, r, t, rms = solve(points, px, *args, flags=flags)
        return (ok, r, t, rms + 35.0) if flags == cv2.SOLVEPNP_IPPE_SQUARE else (ok, r, t, rms)

    monkeypatch.setattr(cv2, "solvePnPGeneric", failing)
    found = estimate_poses(corners(T), SIZE_M, camera)
    np.testing.assert_allclose(found.T_cam_marker, expected.T_cam_marker, atol=1e-4)  # m, rad: where refinement ends


@pytest.mark.parametrize("tilt_deg", [0, 3, 10, 30, 60, 75])
def test_covariances_are_honest(poses: Callable, corners: Callable, camera: CameraModel, tilt_deg: int) -> None:
    count = 400
    T = poses(tilt_deg, count, seed=tilt_deg)
    noisy = corners(T) + SIGMA_PX * np.random.default_rng(tilt_deg).standard_normal((count, 4, 2))
    found = nearest_solution(estimate_poses(noisy, np.full(count, SIZE_M), camera).T_cam_marker, T)
    covariance = pose_covariance(found, SIZE_M, camera, SIGMA_PX)
    error = se3.log(se3.inverse(T) @ found)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 6
    # The mean of 400 chi-squared of 6 over 6 is 1 +- 0.03; near frontal views second order terms stay.
    low, high = (0.8, 1.4) if tilt_deg < 5 else (0.85, 1.15)
    assert low < squared.mean() < high


def test_refined_residuals_show_the_noise(poses: Callable, corners: Callable, camera: CameraModel) -> None:
    T = poses(40, 400)
    noisy = corners(T) + SIGMA_PX * np.random.default_rng(0).standard_normal((400, 4, 2))
    rms_px = estimate_poses(noisy, SIZE_M, camera).rms_px[:, 0]
    # Eight coordinates less six parameters: the mean of 400 chi-squared of 2 over 2 is 1 +- 0.05.
    assert 0.85 < np.mean(8 * rms_px**2 / 2) / SIGMA_PX**2 < 1.15


def test_frontal_views_say_that_their_tilt_is_unsure(poses: Callable, camera: CameraModel) -> None:
    frontal, tilted = (pose_covariance(poses(tilt, 1), SIZE_M, camera, SIGMA_PX)[0] for tilt in (0, 45))
    tilt_deg = [np.rad2deg(np.sqrt(np.linalg.eigvalsh(c[3:, 3:])[-1])) for c in (frontal, tilted)]
    assert tilt_deg[0] > 1.5
    assert tilt_deg[1] < 0.5


def test_an_unseen_marker_has_no_covariance(camera: CameraModel) -> None:
    assert np.all(np.isnan(pose_covariance(np.full((2, 4, 4), np.nan), SIZE_M, camera, SIGMA_PX)))


def test_the_edge_shift_is_undone(poses: Callable, corners: Callable, camera: CameraModel) -> None:
    T, shift_px = poses(30, 20), -0.3
    smaller = shift_edges(corners(T), shift_px)
    as_it_is = estimate_poses(smaller, SIZE_M, camera).T_cam_marker[:, 0]
    undone = estimate_poses(smaller, SIZE_M, replace(camera, edge_shift_px=shift_px)).T_cam_marker[:, 0]
    np.testing.assert_allclose(undone, T, atol=1e-6)  # m; 1e-5 is where the refinement ends
    assert np.all(as_it_is[:, 2, 3] - T[:, 2, 3] > 0.004)  # m: a square that looks smaller looks farther away


def test_viewing_angles_are_those_of_the_normals(poses: Callable) -> None:
    for tilt_deg in (0.0, 1e-5, 35.0, 89.0):
        np.testing.assert_allclose(np.rad2deg(viewing_angles(poses(tilt_deg, 10))), tilt_deg, atol=1e-6)


def test_no_markers_have_no_poses(camera: CameraModel) -> None:
    found = estimate_poses(np.zeros((0, 4, 2)), np.zeros(0), camera)
    assert (found.T_cam_marker.shape, found.rms_px.shape) == ((0, 2, 4, 4), (0, 2))
