"""The bound of corners, against the exact bound of poses, a Monte Carlo, and what must hold of any bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from calibration.intrinsics import project_jacobian
from station.kinematics import se3
from station.logs import FloatArray
from station.tree_bounds import tree_bounds
from tests.benchmarks.made_joints import normals, poses
from tests.fit.image.image_bounds import image_bounds
from tests.fit.image.seen_objects import SIZE_M, UNIT_CORNERS, Scene, pixels
from tests.fit.image.simulated_views import Seeing, Watched, watch, watched

KINDS = ("revolute", "prismatic", "screw", "spherical")
KNOWN_CAMERA: dict[str, float] = {}


def pose_covariance(found: Watched) -> FloatArray:
    """(T, K, 6, 6) of poses that corners tell part by part, by the station's own derivatives."""
    views = found.views
    part = views.part[views.marker]
    T = found.made.T_ref_part[views.frame, part]
    points = views.points_m[views.marker]
    p_cam = points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]
    by_twist = np.concatenate([np.broadcast_to(np.eye(3), (*points.shape, 3)), -se3.hat3(points)], axis=-1)
    J = (project_jacobian(found.true_camera, p_cam) @ T[:, None, :3, :3] @ by_twist).reshape(-1, 8, 6)
    H = np.swapaxes(J, -1, -2) @ np.linalg.solve(views.covariance_px2, J)
    information = np.zeros((*found.made.T_ref_part.shape[:2], 6, 6))
    np.add.at(information, (views.frame, part), H)
    return np.asarray(np.linalg.inv(information), dtype=np.float64)


@pytest.mark.parametrize("root_moves", [False, True])
def test_corners_of_a_known_camera_tell_what_their_poses_tell(root_moves: bool) -> None:
    scene = Scene(joints=4, kinds=KINDS, root_moves=root_moves, frames=60, trackers=(1, 2), markers=(1, 2))
    found = watched(1, scene, Seeing(correlated=True))
    exact = tree_bounds(found.tree, found.truth, found.states, pose_covariance(found), root_moves=root_moves)
    for corners, by_poses in zip(image_bounds(found, camera=KNOWN_CAMERA).joints, exact, strict=True):
        # Central differences are good to 1e-7, and the worst direction has 1e-4 of the best one's information.
        for ours, theirs in ((corners.axis, by_poses.axis), (corners.point, by_poses.point)):
            np.testing.assert_allclose(np.trace(ours), np.trace(theirs), rtol=1e-4)


def test_the_bound_does_not_depend_on_the_tracker_that_names_a_body() -> None:
    kinds = ("revolute", "prismatic", "screw")  # a spherical one's states are told in the axes of that very tracker
    found = watched(2, Scene(joints=3, kinds=kinds, frames=40, trackers=(2, 2)), Seeing())
    last = [1, 3, 5, 7]
    for first, other in zip(image_bounds(found).joints, image_bounds(found, frame_parts=last).joints, strict=True):
        np.testing.assert_allclose(first.state_rms, other.state_rms, rtol=1e-5)
        np.testing.assert_allclose(first.efficient_rms, other.efficient_rms, rtol=1e-5)


def test_what_is_known_of_the_camera_makes_the_bound_smaller() -> None:
    found = watched(3, Scene(joints=3, frames=40, tilt_deg=(0.0, 40.0)), Seeing(edge_shift_px=-0.3))
    nothing = image_bounds(found, camera={"edge_shift_px": np.inf, "focal": np.inf, "readout_s": np.inf})
    usual, known = image_bounds(found), image_bounds(found, camera=KNOWN_CAMERA)
    for joints in zip(nothing.joints, usual.joints, known.joints, strict=True):
        least = [joint.state_rms for joint in joints]
        assert least[0] >= least[1] >= least[2]
    assert image_bounds(found, camera={"edge_shift_px": 1e-4}).camera_std["edge_shift_px"] < 1e-4


def test_a_state_that_was_not_seen_is_not_known() -> None:
    found = watched(4, Scene(joints=3, frames=40), Seeing(missing=0.3))
    for joint in image_bounds(found).joints:
        child = joint.true.child
        below = {child} | {j.child for j in found.made.joints if j.parent == child}
        part_seen = np.zeros(40, dtype=bool)
        for body in below:
            part_seen |= np.isin(np.arange(40), found.views.frame[found.views.part[found.views.marker] == body])
        assert not np.isfinite(joint.states[~part_seen]).any()
        assert np.isfinite(joint.states[part_seen]).any()


@pytest.mark.parametrize("root_moves", [False, True])
def test_best_linear_estimates_err_as_much_as_the_bound_says(root_moves: bool) -> None:
    scene = Scene(joints=3, kinds=("revolute", "prismatic", "spherical"), root_moves=root_moves, frames=30)
    seen, squares = watched(5, scene).seen, []
    for trial in range(30):
        found = watch(np.random.default_rng([5, trial]), seen, Seeing(correlated=True))
        bounds = image_bounds(found).joints
        squares.append([joint.efficient_rms**2 / joint.state_rms**2 for joint in bounds])
    # Mean over trials of each joint's squares; what all frames share makes them scatter by some 0.5 in each trial.
    np.testing.assert_allclose(np.mean(squares, axis=0), 1.0, atol=4 * 0.5 / np.sqrt(30))


def test_least_squares_of_one_hinge_errs_as_much_as_the_bound_says() -> None:
    scene = Scene(joints=1, kinds=("revolute",), frames=12, tilt_deg=(20.0, 60.0))
    seen = watched(6, scene).seen
    joint = seen.at(scene.t_s).joints[0]
    at_start = np.concatenate([np.zeros(18), seen.at(scene.t_s).q[0][:, 0]])
    states, axes, least = [], [], None
    for trial in range(60):
        found = watch(np.random.default_rng([6, trial]), seen, Seeing(sigma_px=0.1))
        least = image_bounds(found, camera=KNOWN_CAMERA).joints[0]

        def residuals(x: FloatArray, found: Watched = found) -> FloatArray:
            """A hinge turns about z of a frame in the root, its pose and the child's in it turned by six numbers."""
            return (found.views.corners_px.reshape(12, 2, 4, 2) - hinge_px(found, *np.split(x, [6, 12, 18]))).ravel()

        x = least_squares(residuals, at_start, method="lm").x
        error = x[18:] - at_start[18:]
        states.append(error - error.mean())
        T_root_axis = poses(x[9:12], x[6:9])
        axes.append(normals(joint.axis) @ (T_root_axis[:3, :3] @ joint.axis))
    assert least is not None
    # 60 trials of 12 states: 720 squares, most of them shared by few numbers.
    assert np.mean(np.square(states)) == pytest.approx(least.state_rms**2, rel=0.25)
    assert np.mean(np.sum(np.square(axes), axis=-1)) == pytest.approx(np.trace(least.axis), rel=0.5)


def hinge_px(found: Watched, root: FloatArray, axis: FloatArray, child: FloatArray, q: FloatArray) -> FloatArray:
    """(T, 2, 4, 2) corners of the root's marker and the child's, with the true ones' poses moved by (6,) each."""
    joint = found.made.joints[0]
    T_cam_root = found.made.T_ref_root[0] @ poses(root[3:], root[:3])
    moved = poses(axis[3:], axis[:3])
    w = q[:, None] * joint.axis
    turn = poses(np.zeros(3), joint.point_m) @ poses(w, np.zeros(3)) @ poses(np.zeros(3), -joint.point_m)
    T_cam_child = T_cam_root @ moved @ turn @ joint.T_parent_child_zero @ poses(child[3:], child[:3])
    T = np.stack([np.broadcast_to(T_cam_root, T_cam_child.shape), T_cam_child], axis=1)
    p_cam = (SIZE_M * UNIT_CORNERS) @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
    return pixels(found.true_camera, p_cam)


def test_half_the_noise_is_half_the_bound() -> None:
    scene = Scene(joints=3, frames=30)
    whole, half = (image_bounds(watched(7, scene, Seeing(sigma_px=sigma))).joints for sigma in (0.2, 0.1))
    for one, other in zip(whole, half, strict=True):
        assert one.state_rms == pytest.approx(2 * other.state_rms)
    stated = image_bounds(watched(7, scene, replace(Seeing(sigma_px=0.1), stated=3.0))).joints
    assert stated[0].state_rms == pytest.approx(half[0].state_rms)  # what is told of noise is none
