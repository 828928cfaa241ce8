"""The fit alone, on corners that are projected and made noisy rather than rendered."""

import cv2
import numpy as np
import pytest

from calibration.camera_fit import (
    Corners,
    fit_camera,
    parameter_jacobian,
    parameters_of,
    prior_std,
    refine_poses,
    refit_camera,
    stack_views,
)
from calibration.camera_fit import camera_of as camera
from calibration.errors import CalibrationError
from calibration.held_out import held_out_errors
from calibration.intrinsics import project
from calibration.verdict import map_std_px, undistorted_rays
from station.simulate.scene import CameraOptics
from tests.board_sets import BOARD, frontal_poses, good_poses, some_camera, true_parameters

SIGMA_PX = 0.05


def seen(optics: CameraOptics, poses: list[np.ndarray], rng: np.random.Generator, sigma_px: float) -> Corners:
    """Corners of all poses that fall into the image, projected by OpenCV, with noise."""
    points, px = [], []
    for T in poses:
        rvec, _ = cv2.Rodrigues(T[:3, :3])
        spots, _ = cv2.projectPoints(BOARD.corner_points(), rvec, T[:3, 3], optics.matrix, optics.distortion)
        spots = spots.reshape(-1, 2)
        inside = np.all((spots > 5) & (spots < np.array(optics.size_px) - 5), axis=1)
        points.append(BOARD.corner_points()[inside])
        px.append(spots[inside] + rng.normal(scale=sigma_px, size=(int(inside.sum()), 2)))
    return stack_views(optics.size_px, points, px)


def a_set(seed: int, sigma_px: float = SIGMA_PX) -> tuple[CameraOptics, Corners]:
    rng = np.random.default_rng(seed)
    optics = some_camera(rng)
    return optics, seen(optics, good_poses(optics, rng), rng, sigma_px)


def test_exact_corners_give_the_camera():
    optics, corners = a_set(0, sigma_px=0.0)
    error = parameters_of(fit_camera(corners).camera) - true_parameters(optics)
    assert np.abs(error[:4]).max() < 0.02  # px: what the weak priors pull
    assert np.abs(error[4:]).max() < 2e-3 * prior_std(fit_camera(corners).camera)[4:].max()


def test_the_camera_is_that_of_opencv_where_views_tell_it():
    _, corners = a_set(1)
    fit = fit_camera(corners)
    by_view = [corners.view == v for v in range(corners.views)]
    points = [corners.points_m[mine].astype(np.float32) for mine in by_view]
    px = [corners.px[mine].astype(np.float32) for mine in by_view]
    _, matrix, distortion, _, _ = cv2.calibrateCamera(points, px, corners.size_px, None, None)  # type: ignore[call-overload]
    theirs = np.array([*matrix[[0, 1], [0, 1]], *matrix[:2, 2], *np.ravel(distortion)[:5]])
    # They differ by the weights of the views and the priors: by less than the noise leaves open.
    assert np.abs((parameters_of(fit.camera) - theirs) / fit.std).max() < 0.5


def test_stated_uncertainties_are_honest():
    errors = []
    for seed in range(30):
        optics, corners = a_set(100 + seed)
        fit = fit_camera(corners)
        errors.append((parameters_of(fit.camera) - true_parameters(optics)) / fit.std)
    squares = np.mean(np.square(errors), axis=0)
    # 30 runs: a mean square is 1 +- 0.26; three standard deviations.
    assert np.all((squares[:4] > 0.25) & (squares[:4] < 1.8)), squares
    assert np.all(squares[4:] < 1.8), squares  # the priors may make them better than they say


def test_the_poses_are_found_too():
    optics, corners = a_set(2)
    rng = np.random.default_rng(2)
    some_camera(rng)
    truth = np.array(good_poses(optics, rng))
    fit = fit_camera(corners)
    assert np.abs(fit.T_cam_board[:, :3, 3] - truth[:, :3, 3]).max() < 1e-3  # m, f known to 0.1 %
    again = refine_poses(fit.camera, corners, fit.T_cam_board)
    np.testing.assert_allclose(again, fit.T_cam_board, atol=1e-6)


def test_corners_that_are_elsewhere_are_dropped_and_change_little():
    _, corners = a_set(3)
    clean = fit_camera(corners)
    px = corners.px.copy()
    px[::40] += [3.0, -2.0]
    fit = fit_camera(Corners(corners.size_px, corners.view, corners.points_m, px))
    assert not fit.used[::40].any() and np.mean(fit.used) > 0.95
    assert np.abs((parameters_of(fit.camera) - parameters_of(clean.camera)) / clean.std).max() < 1.0


def test_a_noisy_view_is_told_from_good_ones():
    _, corners = a_set(4)
    px = corners.px.copy()
    mine = corners.view == 6
    px[mine] += np.random.default_rng(0).normal(scale=0.4, size=(int(mine.sum()), 2))
    fit = fit_camera(Corners(corners.size_px, corners.view, corners.points_m, px))
    assert fit.sigma_px[6] > 5 * np.median(fit.sigma_px)
    assert np.median(fit.sigma_px) == pytest.approx(SIGMA_PX, rel=0.15)


def test_frontal_views_leave_the_focal_length_open_and_say_so():
    rng = np.random.default_rng(5)
    optics = some_camera(rng)
    fit = fit_camera(seen(optics, frontal_poses(optics, rng), rng, SIGMA_PX))
    share = fit.std[0] / fit.camera.matrix[0, 0]
    assert share > 0.01
    assert np.all(np.abs(parameters_of(fit.camera) - true_parameters(optics))[:4] < 3 * fit.std[:4])
    assert np.nanmax(map_std_px(fit)) > 1.5


def test_held_out_errors_are_those_of_the_noise_where_views_are_many():
    _, corners = a_set(6)
    held_out = held_out_errors(fit_camera(corners), corners)
    assert held_out is not None
    assert held_out.rms_px == pytest.approx(SIGMA_PX * np.sqrt(2), rel=0.15)
    assert np.isfinite(held_out.by_view_px).all() and len(held_out.focal_px) == 5


def test_the_uncertainty_of_the_map_is_what_the_scatter_of_calibrations_shows():
    rng = np.random.default_rng(7)
    optics = some_camera(rng)
    poses = good_poses(optics, rng)
    fits = [fit_camera(seen(optics, poses, rng, SIGMA_PX)) for _ in range(25)]
    truth = camera(true_parameters(optics), optics.size_px)
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    rays = undistorted_rays(truth, np.stack([u, v], axis=-1))
    scatter = np.array([project(fit.camera, rays) - project(truth, rays) for fit in fits])
    # A turn of the camera is taken off, to first order a shift of all.
    scatter -= scatter.mean(axis=(1, 2), keepdims=True)
    rms = np.sqrt(np.mean(np.sum(scatter**2, axis=-1), axis=0))
    stated = np.sqrt(np.mean([map_std_px(fit) ** 2 for fit in fits], axis=0))
    assert 0.6 < np.sqrt(np.mean(rms**2) / np.mean(stated**2)) < 1.5


def test_the_jacobian_of_the_parameters_agrees_with_finite_differences():
    optics = some_camera(np.random.default_rng(8))
    q = true_parameters(optics)
    points = np.random.default_rng(9).uniform([-0.2, -0.15, 0.4], [0.2, 0.15, 0.8], (50, 3))
    steps = np.array([1e-3] * 4 + [1e-6] * 5)
    J = parameter_jacobian(camera(q, optics.size_px), points)
    for k, step in enumerate(steps):
        change = np.zeros(9)
        change[k] = step
        ends = [project(camera(q + sign * change, optics.size_px), points) for sign in (1, -1)]
        np.testing.assert_allclose(J[..., k], (ends[0] - ends[1]) / (2 * step), rtol=1e-5, atol=1e-5)


def test_pixels_and_rays_are_inverse_to_each_other():
    model = camera(true_parameters(some_camera(np.random.default_rng(10))), (640, 480))
    u, v = np.meshgrid(np.linspace(0, 639, 7), np.linspace(0, 479, 5))
    px = np.stack([u, v], axis=-1)
    np.testing.assert_allclose(project(model, undistorted_rays(model, px)), px, atol=1e-6)


def test_a_part_of_the_views_is_fitted_from_the_whole():
    _, corners = a_set(11)
    fit = fit_camera(corners)
    chosen = np.arange(corners.views) < 10
    part = refit_camera(fit, corners, chosen)
    alone = fit_camera(corners.of(chosen))
    assert np.abs((parameters_of(part.camera) - parameters_of(alone.camera)) / alone.std).max() < 0.05


def test_too_few_views_or_corners_are_refused():
    _, corners = a_set(12)
    with pytest.raises(CalibrationError, match="2 views of the board; want at least 3"):
        stack_views((640, 480), [corners.points_m[:20]] * 2, [corners.px[:20]] * 2)
    with pytest.raises(CalibrationError, match="view 0 shows 4 corners"):
        stack_views((640, 480), [corners.points_m[:4]] * 3, [corners.px[:4]] * 3)
