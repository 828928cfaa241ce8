"""Corners on a tree: places by OpenCV, equations by finite differences, outliers, scales, the prior of the camera."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from station.fit.image.camera_numbers import unknowns
from station.fit.image.corner_data import LADDER, SHARES, CornerData, corner_data
from station.fit.image.corner_noise import scales_of
from station.fit.skeleton import Skeleton, TreeModel, with_moved_states, with_parameters
from station.fit.tree_equations import equations
from station.fit.tree_motion import tree_poses
from station.fit.tree_problem import Prior, Problem
from station.fit.tree_solver import refined
from station.kinematics import se3
from station.logs import FloatArray
from tests.fit.image.seen_objects import Scene
from tests.fit.image.simulated_views import Seeing, Watched, watched
from tests.fit.true_trees import true_tree

NUMBERS = ("edge_shift_px", "focal", "readout_s")
READOUT_S, STEP = 0.02, 1e-6


def problem_of(w: Watched, names: tuple[str, ...] = ("edge_shift_px",)) -> tuple[Problem[CornerData], TreeModel]:
    """The true tree and what was seen of it."""
    skeleton, model = true_tree(w.made)
    unknown = unknowns(w.views.camera, w.views.readout_s, names)
    data = corner_data(w.views, w.made.parts, unknown)
    if data.motion is not None:
        poses = tree_poses(skeleton, model).parts[:, data.part]
        data = replace(data, motion=data.motion.through(poses))
    skeleton, model = replace(skeleton, shared=len(names)), replace(model, shared=unknown.start)
    return Problem(skeleton, data, Prior(unknown.start, np.array(unknown.prior_std))), model


@pytest.fixture(scope="module", params=[False, True], ids=["static", "moving"])
def rolling(request: pytest.FixtureRequest) -> Watched:
    scene = Scene(
        joints=3, kinds=("revolute", "prismatic", "spherical"), root_moves=request.param, trackers=(1, 2), frames=6
    )
    return watched(3, scene, Seeing(sigma_px=0.5, readout_s=READOUT_S, missing=0.1))


def moved(skeleton: Skeleton, model: TreeModel, by_parameters: FloatArray, by_states: FloatArray) -> TreeModel:
    return with_moved_states(skeleton, with_parameters(skeleton, model, by_parameters), by_states)


def residuals(problem: Problem[CornerData], model: TreeModel) -> FloatArray:
    """(T, M * 8) whitened."""
    data = problem.measured
    found = data.whitened(data.residual_px(tree_poses(problem.skeleton, model).parts, model.shared))
    return found.reshape(len(found), -1)


def test_corners_are_where_opencv_projects_them_with_distortion_and_focal_factor(rolling: Watched) -> None:
    w = watched(3, rolling.seen.scene, Seeing(sigma_px=0.0001))
    problem, model = problem_of(w, ("focal",))
    model = replace(model, shared=np.array([1.01]))
    data, poses = problem.measured, tree_poses(problem.skeleton, model).parts
    found = data.px.reshape(*data.shape, 8) - data.residual_px(poses, model.shared)
    matrix = w.views.camera.matrix * np.array([[1.01, 1, 1], [1, 1.01, 1], [1, 1, 1]])
    for t, m in np.argwhere(data.seen)[::3]:
        T = poses[t, data.part[m]]
        rotation, _ = cv2.Rodrigues(T[:3, :3])
        wanted, _ = cv2.projectPoints(data.views.points_m[m], rotation, T[:3, 3], matrix, w.views.camera.distortion)
        np.testing.assert_allclose(found[t, m], wanted.ravel(), atol=1e-9)


def test_equations_of_corners_are_those_of_finite_differences(rolling: Watched) -> None:
    problem, model = problem_of(rolling, NUMBERS)
    skeleton, data = problem.skeleton, problem.measured
    weights = np.random.default_rng(0).uniform(0.2, 1.0, data.shape) * data.seen
    n, s, T = skeleton.parameters, skeleton.states, len(model.q)
    root = np.sqrt(np.repeat(weights, 8, axis=1))

    def derivative(by_parameters: FloatArray, by_states: FloatArray) -> FloatArray:
        ends = [residuals(problem, moved(skeleton, model, x * by_parameters, x * by_states)) for x in (STEP, -STEP)]
        return root * (ends[0] - ends[1]) / (2 * STEP)

    J_p = np.stack([derivative(row, np.zeros((T, s))) for row in np.eye(n)], axis=-1)
    J_s = np.stack([derivative(np.zeros(n), np.tile(row, (T, 1))) for row in np.eye(s)], axis=-1)
    found, r = equations(skeleton, model, data, weights), root * residuals(problem, model)
    for have, want in (
        (found.H_pp, np.einsum("tri,trj->ij", J_p, J_p)),
        (found.H_sp, np.einsum("tri,trj->tij", J_s, J_p)),
        (found.H_ss, np.einsum("tri,trj->tij", J_s, J_s)),
        (found.g_p, np.einsum("tri,tr->i", J_p, r)),
        (found.g_s, np.einsum("tri,tr->ti", J_s, r)),
    ):
        np.testing.assert_allclose(have, want, rtol=1e-5, atol=1e-6 * np.abs(want).max())


def test_a_fit_from_a_disturbed_start_ends_where_one_from_the_truth_does(rolling: Watched) -> None:
    scene = replace(rolling.seen.scene, frames=60)
    problem, model = problem_of(watched(3, scene, Seeing(sigma_px=0.1)))
    rng, skeleton = np.random.default_rng(1), problem.skeleton
    by_states = 0.02 * rng.normal(size=(60, skeleton.states))
    start = moved(skeleton, model, 0.01 * rng.normal(size=skeleton.parameters), by_states)
    ends = [refined(problem, m) for m in (model, start)]
    poses = [tree_poses(skeleton, end.model).parts for end in ends]
    assert np.abs(se3.log(se3.inverse(poses[0]) @ poses[1])).max() < 1e-4
    assert abs(ends[0].chi2.sum() - ends[1].chi2.sum()) < 0.1


def test_squared_residuals_of_the_truth_have_their_chi_squared_distribution(
    rolling: Watched,
) -> None:
    scene = replace(rolling.seen.scene, frames=200)
    problem, model = problem_of(watched(4, scene, Seeing(sigma_px=0.2, correlated=True)))
    chi2 = problem.chi2(model)[problem.measured.seen]
    assert abs(chi2.mean() - 8) < 4 * np.sqrt(16 / len(chi2))


def test_outliers_cost_what_the_mixture_of_normal_distributions_says(rolling: Watched) -> None:
    data = problem_of(rolling)[0].measured
    t, m = np.argwhere(data.seen)[0]
    at_zero = multivariate_normal.logpdf(np.zeros(8), cov=np.eye(8))
    for length in (0.5, 3.0, 12.0, 400.0):
        chi2 = np.zeros(data.shape)
        chi2[t, m] = length**2
        along = length * np.eye(8)[0]
        steps = SHARES * [multivariate_normal.pdf(along, cov=f**2 * np.eye(8)) for f in LADDER]
        assert data.costs(chi2)[t, m] == pytest.approx(-2 * (np.log(steps.sum()) - at_zero), rel=1e-9)
        assert data.inliers(chi2)[t, m] == pytest.approx(steps[0] / steps.sum(), abs=1e-12)
        assert data.weights(chi2)[t, m] == pytest.approx(np.sum(steps / LADDER**2) / steps.sum(), rel=1e-9)


def test_a_wild_corner_pulls_less_than_one_that_is_off_by_a_deviation() -> None:
    data = problem_of(watched(3, Scene(joints=1, frames=1), Seeing()))[0].measured
    for deviations in (60.0, 200.0, 1000.0):
        chi2 = np.where(data.seen, deviations**2, 0.0)
        assert (data.weights(chi2) * deviations).max() < 1.0


def test_each_marker_gets_the_scale_of_its_noise() -> None:
    scene = Scene(joints=3, kinds=("revolute",), trackers=(2, 2), frames=150)
    w = watched(5, scene, Seeing(sigma_px=0.1))
    truth = np.linspace(0.6, 1.8, len(w.views.marker_id))
    views = replace(w.views, covariance_px2=w.views.covariance_px2 / truth[w.views.marker, None, None] ** 2)
    problem, model = problem_of(replace(w, views=views))
    for _ in range(4):
        problem = replace(
            problem, measured=replace(problem.measured, scale=scales_of(problem, refined(problem, model)))
        )
    freedoms = 8 * problem.measured.seen.sum(axis=0)
    np.testing.assert_allclose(problem.measured.scale / truth, 1.0, atol=4 / np.sqrt(freedoms.min()))


def test_what_is_known_of_the_camera_before_holds_it_as_a_measurement_would() -> None:
    problem, model = problem_of(watched(6, Scene(joints=2, frames=40), Seeing(sigma_px=0.2)))
    free = refined(replace(problem, prior=Prior(np.zeros(1), np.array([1e3]))), model)
    held = refined(replace(problem, prior=Prior(np.array([0.3]), np.array([0.02]))), model)
    variance = np.linalg.inv(free.last.reduced.H)[-1, -1]
    weight = 0.02**-2 / (0.02**-2 + 1 / variance)
    assert held.model.shared[0] == pytest.approx((1 - weight) * free.model.shared[0] + weight * 0.3, abs=0.002)


def test_corners_behind_the_camera_are_outliers_and_no_error() -> None:
    problem, model = problem_of(watched(6, Scene(joints=1, frames=3), Seeing()))
    behind = replace(model, mounts=se3.translation([0.0, 0.0, -5.0]) @ model.mounts)
    data = problem.measured
    chi2 = problem.chi2(behind)
    assert np.isfinite(chi2).all()
    assert data.inliers(chi2)[data.seen].max() < 1e-6
