"""Whole tree: normal equations by finite differences, estimates against SciPy's least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.skeleton import Skeleton, TreeJoint, TreeModel, with_moved_states, with_parameters
from station.fit.tree_elimination import eliminated
from station.fit.tree_equations import equations
from station.fit.tree_motion import tree_poses
from station.fit.tree_residuals import Measured, tree_residuals
from station.fit.whole_tree import refine_tree
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames
from station.logs import FloatArray
from tests.benchmarks.bounds import bound, median_norm
from tests.benchmarks.made_joints import single_joint, watch
from tests.benchmarks.read_fits import axis_error_rad

FRAMES, STEP = 4, 1e-6
CERTAIN = 1e3  # log odds that make every pose an inlier


def random_frames(rng: np.random.Generator, kind: str) -> JointFrames:
    form = rng.normal(size=JOINT_TYPES[kind].form_freedoms)
    return JointFrames(se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6)), form)


def example(kind: str, *, root_moves: bool, frames: int = FRAMES) -> tuple[Skeleton, TreeModel]:
    """Joints of one type with a hinge before and after, one of them told against the way from the root."""
    rng = np.random.default_rng(40)
    hinge, joint = JOINT_TYPES["revolute"], JOINT_TYPES[kind]
    skeleton = Skeleton(
        joints=(
            TreeJoint(0, 1, hinge),
            TreeJoint(1, 2, joint),
            TreeJoint(4, 0, joint, turned=True),
            TreeJoint(2, 3, hinge),
        ),
        body_of=(0, 1, 1, 2, 3, 4, 4, 0),
        free_mount=(False, False, True, False, False, False, True, True),
        root_moves=root_moves,
    )
    root = se3.exp(rng.normal(size=(frames, 6))) if root_moves else se3.identity(frames)
    joints = tuple(random_frames(rng, joint.type.name) for joint in skeleton.joints)
    q = rng.normal(size=(frames, skeleton.joint_states))
    return skeleton, TreeModel(root, joints, q, se3.exp(rng.normal(size=(8, 6))))


def measured_about(rng: np.random.Generator, T_ref_part: FloatArray, error: float) -> Measured:
    """Poses off by a normal error [m, rad], whitened by any matrices."""
    shape = T_ref_part.shape[:2]
    whitener = rng.normal(size=(*shape, 6, 6)) + 3 * np.eye(6)
    moved = T_ref_part @ se3.exp(error * rng.normal(size=(*shape, 6)))
    return Measured(moved, whitener, np.full(shape, CERTAIN), np.full(shape, 6.0), np.ones((shape[1], 2)))


def whitened(
    skeleton: Skeleton, model: TreeModel, measured: Measured, weights: FloatArray, step: FloatArray, states: FloatArray
) -> FloatArray:
    """(T, 6 K) weighted residuals of a model moved by parameters (n,) and states (T, s)."""
    moved = with_moved_states(skeleton, with_parameters(skeleton, model, step), states)
    found = tree_residuals(measured, tree_poses(skeleton, moved).parts).whitened
    return (found * np.sqrt(weights)[..., None]).reshape(len(states), -1)


@pytest.mark.parametrize("root_moves", [True, False])
@pytest.mark.parametrize("kind", list(JOINT_TYPES))
def test_normal_equations_are_those_of_finite_differences(kind: str, root_moves: bool) -> None:
    skeleton, model = example(kind, root_moves=root_moves)
    rng = np.random.default_rng(41)
    measured = measured_about(rng, tree_poses(skeleton, model).parts, 0.3)
    weights = rng.uniform(size=(FRAMES, 8))
    n, s = skeleton.parameters, skeleton.states

    def slope(step: FloatArray, states: FloatArray) -> FloatArray:
        ahead = whitened(skeleton, model, measured, weights, step, states)
        return (ahead - whitened(skeleton, model, measured, weights, -step, -states)) / (2 * STEP)

    A = np.stack([slope(STEP * e, np.zeros((FRAMES, s))) for e in np.eye(n)], axis=-1)
    B = np.stack([slope(np.zeros(n), np.tile(STEP * e, (FRAMES, 1))) for e in np.eye(s)], axis=-1)
    r = whitened(skeleton, model, measured, weights, np.zeros(n), np.zeros((FRAMES, s)))
    found = equations(skeleton, model, measured, weights)
    expected = {
        "H_pp": np.einsum("tri,trj->ij", A, A),
        "g_p": np.einsum("tri,tr->i", A, r),
        "H_sp": np.einsum("tri,trj->tij", B, A),
        "H_ss": np.einsum("tri,trj->tij", B, B),
        "g_s": np.einsum("tri,tr->ti", B, r),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(found, name), value, atol=1e-7 * np.abs(value).max(initial=1.0))


@pytest.mark.parametrize("kind", list(JOINT_TYPES))
def test_eliminated_states_give_the_step_of_the_full_system(kind: str) -> None:
    skeleton, model = example(kind, root_moves=True)
    rng = np.random.default_rng(42)
    measured = measured_about(rng, tree_poses(skeleton, model).parts, 0.3)
    found = equations(skeleton, model, measured, np.ones((FRAMES, 8)))
    n, s = skeleton.parameters, skeleton.states
    H = np.zeros((n + FRAMES * s, n + FRAMES * s))
    H[:n, :n] = found.H_pp + 1e-3 * np.eye(n)  # four frames don't tell all parameters
    for t in range(FRAMES):
        own = slice(n + t * s, n + (t + 1) * s)
        H[own, own], H[own, :n], H[:n, own] = found.H_ss[t], found.H_sp[t], found.H_sp[t].T
    step = np.asarray(np.linalg.solve(H, -np.concatenate([found.g_p, found.g_s.ravel()])), dtype=np.float64)
    reduced, states = eliminated(skeleton, found, 0.0)
    np.testing.assert_allclose(np.linalg.solve(reduced.H + 1e-3 * np.eye(n), -reduced.g), step[:n], rtol=1e-5)
    np.testing.assert_allclose(states.states_step(step[:n]).ravel(), step[n:], rtol=1e-6)


@pytest.mark.parametrize("kind", [name for name in JOINT_TYPES if JOINT_TYPES[name].states])
def test_estimates_are_those_of_an_independent_optimiser(kind: str) -> None:
    """Residuals are shared, the search is not; SciPy gets the noise that was found."""
    frames, joint = 8, JOINT_TYPES[kind]
    skeleton = Skeleton((TreeJoint(0, 1, joint), TreeJoint(1, 2, joint)), (0, 1, 2), (True, False, False), False)
    rng = np.random.default_rng(43)
    joints = tuple(random_frames(rng, kind) for _ in skeleton.joints)
    q = rng.normal(size=(frames, skeleton.joint_states))
    truth = TreeModel(se3.identity(frames), joints, q, se3.exp(rng.normal(size=(3, 6))))
    measured = measured_about(rng, tree_poses(skeleton, truth).parts, 0.01)
    n, s = skeleton.parameters, skeleton.states
    fit = refine_tree(skeleton, truth, measured.of_parts)
    measured = replace(measured, spread=fit.spread)

    def moved(x: FloatArray) -> FloatArray:
        return whitened(skeleton, truth, measured, np.ones((frames, 3)), x[:n], x[n:].reshape(frames, s)).ravel()

    best = least_squares(moved, np.zeros(n + frames * s), xtol=1e-12, ftol=1e-12, gtol=1e-10)
    model = with_moved_states(skeleton, with_parameters(skeleton, truth, best.x[:n]), best.x[n:].reshape(frames, s))
    off = se3.log(se3.inverse(tree_poses(skeleton, model).parts) @ tree_poses(skeleton, fit.model).parts)
    np.testing.assert_allclose(off, 0.0, atol=2e-3)  # m, rad; poses are off by 1e-2
    reached = whitened(skeleton, fit.model, measured, np.ones((frames, 3)), np.zeros(n), np.zeros((frames, s)))
    assert np.sum(reached**2) < 2 * best.cost + 0.1  # 1 would be a standard deviation


@pytest.mark.parametrize(("kind", "travel"), [("prismatic", 0.2), ("revolute", 0.8)])
def test_parts_that_jump_from_frame_to_frame_have_the_noise_of_their_residuals(kind: str, travel: float) -> None:
    """Their changes are motion, not noise. 30 mm and 3 deg: the median axis errs by less than twice the bound, as the
    median of twelve may.
    """
    errors: list[tuple[float, float]] = []
    for seed in range(12):
        rng = np.random.default_rng([42, seed])
        made = single_joint(rng, kind, frames=60, travel=travel, arm_m=0.65, parent_tracked=True)
        watched = watch(rng, made.T_ref_part, 0.03, np.radians(3.0))
        (joint,) = learn(watched.log, FitOptions(joint_types=(kind,), root="p0")).tree.joints
        assert joint.axis_parent is not None
        least = bound(made, watched.noise, 0.03, np.radians(3.0))
        errors.append((axis_error_rad(joint.axis_parent, made.joints[0].axis), median_norm(least.axis(0))))
    found, best = np.median(errors, axis=0)
    assert found < 2 * best
