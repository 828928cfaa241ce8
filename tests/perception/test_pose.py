from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray
from station.kinematics import se3
from station.perception.pose import UNIT_CORNERS, estimate_poses, inverse_information, viewing_angles
from station.quadrilaterals import shift_edges
from tests.noisy_corners import joint

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


def nearest_rows(found: FloatArray, truth: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the solution (N, 2, ...) of each marker that is nearer to the truth."""
    apart = np.where(np.isnan(found[..., 0, 0]), np.inf, angle_rad(found, truth[:, None]))
    return np.arange(len(found)), np.argmin(apart, axis=1)


def isotropic(sigma_px: float, count: int) -> FloatArray:
    return np.broadcast_to(sigma_px**2 * np.eye(8), (count, 8, 8))


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


@pytest.mark.parametrize("tilt_deg", [30, 60, 75])
def test_both_solutions_are_opencvs_to_a_small_part_of_the_noise(
    poses: Callable, corners: Callable, camera: CameraModel, tilt_deg: int
) -> None:
    T, sigma_px = poses(tilt_deg, 30, seed=tilt_deg), 0.03
    noisy = corners(T) + sigma_px * np.random.default_rng(0).standard_normal((30, 4, 2))
    found = estimate_poses(noisy, SIZE_M, camera, isotropic(sigma_px, 30))
    theirs = np.stack([by_opencv(px, camera) for px in noisy])
    error = se3.log(se3.inverse(found.T_cam_marker) @ theirs)
    sigmas = np.sqrt(np.einsum("msi,msij,msj->ms", error, np.linalg.inv(found.covariance), error))
    assert sigmas[:, 0].max() < 0.01  # the lens model is taken at the seen corners
    assert sigmas[:, 1].max() < 0.2  # refuted by its residuals, it is refined as far as those deserve


def by_opencv(px: FloatArray, camera: CameraModel) -> FloatArray:
    """(2, 4, 4) both solutions by OpenCV, each refined on the distorted pixels; the better first."""
    points, end = SIZE_M * UNIT_CORNERS, (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    _, rvecs, tvecs, _ = cv2.solvePnPGeneric(
        points, px, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    refined = [
        cv2.solvePnPRefineLM(points, px, camera.matrix, camera.distortion, r.copy(), t.copy(), end)
        for r, t in zip(rvecs, tvecs, strict=True)
    ]
    return np.stack([se3.pose(cv2.Rodrigues(r)[0], t.ravel()) for r, t in refined])


def test_corners_that_are_no_square_have_no_pose(camera: CameraModel) -> None:
    square = np.array([[300.0, 200], [350, 200], [350, 250], [300, 250]])
    bow = square[[0, 2, 1, 3]]
    line = np.array([[300.0, 200], [310, 200], [320, 200], [330, 200]])
    point = np.full((4, 2), 300.0)
    found = estimate_poses(np.stack([square, bow, line, point]), SIZE_M, camera)
    assert np.isnan(found.rms_px[:, 0]).tolist() == [False, True, True, True]
    assert np.all(np.isnan(found.T_cam_marker[1:]))


@pytest.mark.parametrize("tilt_deg", [0, 3, 10, 30, 60, 75])
def test_covariances_are_honest(poses: Callable, corners: Callable, camera: CameraModel, tilt_deg: int) -> None:
    count = 400
    T = poses(tilt_deg, count, seed=tilt_deg)
    noisy = corners(T) + SIGMA_PX * np.random.default_rng(tilt_deg).standard_normal((count, 4, 2))
    found = estimate_poses(noisy, np.full(count, SIZE_M), camera, isotropic(SIGMA_PX, count))
    nearest = nearest_rows(found.T_cam_marker, T)
    error = se3.log(se3.inverse(T) @ found.T_cam_marker[nearest])
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance[nearest]), error) / 6
    # The mean of 400 chi-squared of 6 over 6 is 1 +- 0.03; near frontal views second order terms stay.
    low, high = (0.8, 1.25) if tilt_deg < 5 else (0.85, 1.15)
    assert low < squared.mean() < high


def test_refined_residuals_show_the_noise(poses: Callable, corners: Callable, camera: CameraModel) -> None:
    T = poses(40, 400)
    noisy = corners(T) + SIGMA_PX * np.random.default_rng(0).standard_normal((400, 4, 2))
    rms_px = estimate_poses(noisy, SIZE_M, camera).rms_px[:, 0]
    # Eight coordinates less six parameters: the mean of 400 chi-squared of 2 over 2 is 1 +- 0.05.
    assert 0.85 < np.mean(8 * rms_px**2 / 2) / SIGMA_PX**2 < 1.15


def test_corners_count_by_their_covariances(poses: Callable, corners: Callable, camera: CameraModel) -> None:
    count, rng = 400, np.random.default_rng(5)
    T = poses(40, count)
    half = rng.normal(size=(count, 4, 2, 2)) * rng.uniform(0.01, 0.1, (count, 4, 1, 1))
    covariance_px2 = half @ np.swapaxes(half, -1, -2) + 0.02**2 * np.eye(2)
    noise = (np.linalg.cholesky(covariance_px2) @ rng.standard_normal((count, 4, 2, 1)))[..., 0]
    weighted, equal = (estimate_poses(corners(T) + noise, SIZE_M, camera, c) for c in (joint(covariance_px2), None))
    nearest = nearest_rows(weighted.T_cam_marker, T)
    error = se3.log(se3.inverse(T) @ weighted.T_cam_marker[nearest])
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(weighted.covariance[nearest]), error) / 6
    assert 0.85 < squared.mean() < 1.15  # 1 +- 0.03
    unweighted = se3.log(se3.inverse(T) @ equal.T_cam_marker[nearest_rows(equal.T_cam_marker, T)])
    assert np.median(np.linalg.norm(error[:, 3:], axis=1)) < 0.9 * np.median(np.linalg.norm(unweighted[:, 3:], axis=1))


def test_a_marker_of_unknown_covariance_has_a_pose_and_none(
    poses: Callable, corners: Callable, camera: CameraModel
) -> None:
    T = poses(30, 2)
    covariance_px2 = np.array(isotropic(SIGMA_PX, 2))
    covariance_px2[1, 2, 3] = np.nan
    found = estimate_poses(corners(T), SIZE_M, camera, covariance_px2)
    np.testing.assert_allclose(found.T_cam_marker[:, 0], T, atol=1e-6)  # m, rad
    assert np.all(np.isfinite(found.covariance[0])) and np.all(np.isnan(found.covariance[1]))


def test_frontal_views_say_that_their_tilt_is_unsure(poses: Callable, corners: Callable, camera: CameraModel) -> None:
    frontal, tilted = (
        estimate_poses(corners(poses(tilt, 1)), SIZE_M, camera, isotropic(SIGMA_PX, 1)).covariance[0, 0]
        for tilt in (0, 45)
    )
    tilt_deg = [np.rad2deg(np.sqrt(np.linalg.eigvalsh(c[3:, 3:])[-1])) for c in (frontal, tilted)]
    assert tilt_deg[0] > 1.5
    assert tilt_deg[1] < 0.5


def test_information_that_leaves_a_direction_open_gives_infinite_variances() -> None:
    known = np.diag([1e6, 1e6, 1e4, 1e3, 1e3, 1e5])
    open_ = known.copy()
    open_[3] = open_[:, 3] = 0.0
    covariance = inverse_information(np.stack([known, open_, np.full((6, 6), np.nan)]))
    np.testing.assert_allclose(covariance[0] @ known, np.eye(6), atol=1e-12)
    assert np.all(np.isinf(np.diagonal(covariance[1]))) and np.all(np.isnan(covariance[2]))


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
