"""Poses from any known points: the derivatives, and what a search from a wrong start finds."""

from collections.abc import Callable

import cv2
import numpy as np

from calibration.intrinsics import CameraModel, FloatArray
from station.kinematics import se3
from station.perception.point_poses import ray_errors, sights_of, solve_poses
from station.perception.square_pose import square_poses


def scene(camera: CameraModel, count: int, points: int, seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses (N, 4, 4), points (N, P, 3) and their pixels by cv2.projectPoints."""
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(size=(count, 6)) * (0.05, 0.05, 0.05, 0.5, 0.5, 0.5)) @ np.eye(4)
    T[:, 2, 3] += 0.6
    points_m = rng.uniform(-0.05, 0.05, (count, points, 3))
    px = [
        cv2.projectPoints(p, cv2.Rodrigues(t[:3, :3])[0], t[:3, 3], camera.matrix, camera.distortion)[0].reshape(-1, 2)
        for p, t in zip(points_m, T, strict=True)
    ]
    return T, points_m, np.stack(px)


def test_the_derivatives_agree_with_finite_differences(camera: CameraModel) -> None:
    T, points_m, px = scene(camera, 20, 5)
    sights, step = sights_of(points_m, px, None, camera), 1e-6

    def errors(shift: FloatArray) -> FloatArray:
        return ray_errors(se3.exp_so3(shift[3:]) @ T[:, :3, :3], T[:, :3, 3] + shift[:3], sights)[0]

    exact, J = ray_errors(T[:, :3, :3], T[:, :3, 3], sights)
    np.testing.assert_allclose(exact, 0.0, atol=1e-9)  # rays: the lens model is OpenCV's, and inverted
    numeric = np.stack([(errors(s) - errors(-s)) / (2 * step) for s in step * np.eye(6)], axis=-1)
    np.testing.assert_allclose(J, numeric, rtol=1e-6, atol=1e-8)  # rays/m, rays/rad


def test_a_search_from_a_wrong_start_ends_at_the_pose(camera: CameraModel) -> None:
    T, points_m, px = scene(camera, 50, 8)
    start = T @ se3.exp(np.random.default_rng(1).normal(size=(50, 6)) * (0.02, 0.02, 0.02, 0.2, 0.2, 0.2))
    start[7] = np.nan
    solved = solve_poses(sights_of(points_m, px, None, camera), start)
    rest = np.delete(np.arange(50), 7)
    np.testing.assert_allclose(solved.T[rest], T[rest], atol=1e-6)  # m, rad
    assert np.all(solved.settled[rest]) and not solved.settled[7] and np.all(np.isnan(solved.T[7]))
    assert np.all(solved.rms_px[rest] < 1e-4)


def test_information_is_that_of_right_perturbations(camera: CameraModel) -> None:
    T, points_m, px = scene(camera, 10, 6)
    solved = solve_poses(sights_of(points_m, px, None, camera), T)
    xi = np.random.default_rng(2).normal(size=(10, 6)) * (1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4)
    moved = solve_poses(sights_of(points_m, px, None, camera), solved.T @ se3.exp(xi), most_steps=0)
    growth = moved.chi2 - solved.chi2
    np.testing.assert_allclose(growth, np.einsum("ni,nij,nj->n", xi, solved.information, xi), rtol=2e-2)


def test_the_closed_form_of_a_square_is_exact(
    camera: CameraModel, pose_facing: Callable, project_corners: Callable
) -> None:
    rng = np.random.default_rng(3)
    for tilt_deg in (0.0, 1e-7, 0.01, 5.0, 40.0, 80.0):
        T = np.stack(
            [
                pose_facing(
                    np.deg2rad(tilt_deg), *rng.uniform(0, 6.28, 2), rng.uniform((-0.2, -0.1, 0.4), (0.2, 0.1, 1))
                )
                for _ in range(20)
            ]
        )
        px = np.stack([project_corners(t, 0.05, camera) for t in T])
        rays = sights_of(np.zeros((20, 4, 3)), px, None, camera).rays
        both = square_poses(rays, np.full(20, 0.05))
        apart = np.abs(both - T[:, None]).max(axis=(-2, -1)).min(axis=1)
        # At the front an error of the rays, here 1e-10, moves the tilt by its square root.
        assert apart.max() < 2e-4 if tilt_deg < 1 else 1e-7
