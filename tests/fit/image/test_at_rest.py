"""What corners say to be at rest though its poses seem to move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.image.at_rest import at_rest
from station.fit.image.camera_numbers import unknowns
from station.fit.image.refinement import refine_image
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.rigid_pairs import RigidPairs
from station.fit.skeleton import TreeJoint
from station.fit.tree_motion import tree_poses
from station.fit.tree_solver import refined
from station.fit.whole_tree import state_covariances
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames
from station.tree_scores import score_tree
from tests.fit.image.seen_objects import Scene
from tests.fit.image.simulated_views import Seeing, watched
from tests.fit.image.test_corner_data import problem_of
from tests.fit.true_trees import true_tree


def test_a_tree_whose_joints_move_has_none_at_rest() -> None:
    for root_moves in (False, True):
        problem, model = problem_of(watched(31, Scene(joints=3, frames=120, root_moves=root_moves)))
        solution = refined(problem, model)
        covariance = np.linalg.inv(solution.last.reduced.H)
        states = state_covariances(problem.skeleton, solution.last, covariance, 1.0)
        found = at_rest(problem, solution, covariance, states)
        assert found.joints == ()
        assert found.bodies == ()


def test_a_joint_within_a_body_and_a_root_that_need_not_move_are_at_rest() -> None:
    w = watched(31, Scene(joints=1, kinds=("revolute",), frames=120, trackers=(2, 2)))
    problem, model = problem_of(w)
    skeleton = problem.skeleton
    last = len(skeleton.body_of) - 1
    far = skeleton.body_of[last]
    hinge = TreeJoint(far, far + 1, JOINT_TYPES["revolute"])
    frames = JointFrames.plain(se3.exp(np.array([0.1, 0, 0, 0.3, 0, 0])), np.eye(4))
    inside = JointFrames.plain(frames.T_parent_axis, se3.inverse(frames.T_parent_axis) @ model.mounts[last])
    split = replace(
        skeleton,
        joints=(*skeleton.joints, hinge),
        body_of=(*skeleton.body_of[:-1], far + 1),
        free_mount=(False, *skeleton.free_mount[1:-1], False),
        root_moves=True,
    )
    held = model.mounts.copy()
    T_root, held[last] = tree_poses(skeleton, model).parts[:, 0], np.eye(4)
    at_root = se3.inverse(held[0])
    joints = (JointFrames.plain(at_root @ model.frames[0].T_parent_axis, model.frames[0].T_axis_child), inside)
    held[:2] = at_root @ held[:2]
    start = replace(
        model, T_ref_root=T_root, frames=joints, q=np.append(model.q, np.zeros((len(model.q), 1)), axis=1), mounts=held
    )
    np.testing.assert_allclose(tree_poses(split, start).parts, tree_poses(skeleton, model).parts, atol=1e-9)
    problem = replace(problem, skeleton=split)
    solution = refined(problem, start)
    covariance = np.linalg.pinv(solution.last.reduced.H)
    found = at_rest(problem, solution, covariance, state_covariances(split, solution.last, covariance, 1.0))
    assert found.joints == (1,)
    assert found.bodies == (0,)


@pytest.mark.parametrize("root_moves", [False, True])
def test_a_root_stands_still_that_only_seems_to_move_with_the_joints(root_moves: bool) -> None:
    """By their own deviations, frontal markers have it move: an error of an axis moves it as the joint does."""
    for seed in (2, 5, 6, 8):
        scene = Scene(joints=3, frames=60, tilt_deg=(0.0, 25.0), root_moves=root_moves)
        seen = watched([71, seed], scene, Seeing(sigma_px=0.1))
        skeleton, model = true_tree(replace(seen.made, root="moving"))
        found = refine_image(skeleton, model, seen.made.parts, seen.views, unknowns(seen.views.camera, 0.0))
        assert found.rest.bodies == (() if root_moves else (0,))
        assert found.rest.joints == ()


@pytest.mark.parametrize("seed", [12, 14])
def test_corners_put_right_what_frontal_poses_made_of_a_still_root(seed: int) -> None:
    rng = np.random.default_rng([99, seed])
    sigma_px = float(np.exp(rng.uniform(np.log(0.05), np.log(0.3))))
    joints, moves = int(rng.integers(3, 7)), bool(rng.integers(2))
    kinds, course = ("revolute", "prismatic"), ("smooth", "steps")[seed % 2]
    scene = Scene(joints=joints, root_moves=moves, course=course, kinds=kinds, trackers=(1, 2))
    w = watched([seed], scene, Seeing(sigma_px=sigma_px))
    pose, image = learn(w.poses), learn(w.poses, FitOptions(), w.views)
    assert pose.tree.method["root"] == "moving"  # else this seed shows nothing
    assert image.tree.method["root"] == "static"
    assert score_tree(image.tree, w.tree).types_correct


def test_a_root_that_is_said_to_move_keeps_its_poses() -> None:
    w = watched(31, Scene(joints=1, kinds=("revolute",), frames=100))
    told = learn(w.poses, FitOptions(root_static=False), w.views)
    assert told.tree.method["root"] == "moving"


def test_rigid_pairs_stay_a_forest() -> None:
    T = se3.exp(np.arange(18.0).reshape(3, 6) / 20)
    some = RigidPairs(np.array([[0, 1], [1, 2]]), T[:2])
    both = some.plus(RigidPairs(np.array([[0, 2], [2, 3]]), T[1:]), 4)
    np.testing.assert_array_equal(both.pairs, [[0, 1], [1, 2], [2, 3]])
    np.testing.assert_array_equal(both.T_a_b[2], T[2])
