"""What doesn't fit a tree: flipped markers, gross errors, bodies that were not seen, poor starts, joints at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from true_trees import measured_of, true_tree, turned_tree

from station.fit.skeleton import Skeleton, TreeModel, with_parameters
from station.fit.tree_residuals import Measured
from station.fit.whole_tree import refine_tree
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray, PoseLog
from tests.benchmarks.made_joints import SOUND, Faults, MadeObject, poses, random_poses, single_joint, watch
from tests.benchmarks.made_trees import random_tree

STD_M, STD_RAD = 0.002, 0.01
FRAMES = 120
KINDS = [name for name in JOINT_TYPES if JOINT_TYPES[name].states]
GROSS_M = 10 * STD_M  # an error of position beyond this is no noise


def made_tree(
    seed: int,
    *,
    root_moves: bool = False,
    trackers: tuple[int, int] = (1, 1),
    walk: bool = True,
    kinds: Sequence[str] = KINDS,
) -> MadeObject:
    rng = np.random.default_rng([90, seed])
    return random_tree(rng, bodies=4, frames=FRAMES, kinds=kinds, root_moves=root_moves, walk=walk, trackers=trackers)


def logged(made: MadeObject, seed: int, faults: Faults = SOUND) -> PoseLog:
    return watch(np.random.default_rng([91, seed]), made.T_ref_part, STD_M, STD_RAD, faults).log


def held_states(skeleton: Skeleton, true: TreeModel, measured: Measured, known: np.ndarray) -> TreeModel:
    """The true model with states that are those of the last frame before where their far body was not known (T, K), and
    a root that moves where its first tracker was last seen, right or wrong.
    """
    q, root = true.q.copy(), true.T_ref_root
    for j, joint in enumerate(skeleton.joints):
        columns = skeleton.state_columns(j)
        good = np.any(known[:, np.equal(skeleton.body_of, joint.far)], axis=1)
        q[:, columns] = true.q[last(good), columns]
    if skeleton.root_moves:
        k = skeleton.body_of.index(0)
        root = measured.T_ref_part[last(measured.seen[:, k]), k] @ se3.inverse(true.mounts[k])
    return replace(true, q=q, T_ref_root=root)


def last(good: np.ndarray) -> np.ndarray:
    """(T,) row of the last good one up to each."""
    return np.maximum.accumulate(np.where(good, np.arange(len(good)), 0))


def off(made: MadeObject, measured: Measured) -> FloatArray:
    """(T, K) errors of the measured positions [m]."""
    return np.linalg.norm(measured.T_ref_part[..., :3, 3] - made.T_ref_part[..., :3, 3], axis=-1) * measured.seen


@pytest.mark.parametrize("root_moves", [False, True])
def test_flipped_markers_are_left_out_and_their_neighbours_are_not(root_moves: bool) -> None:
    """A third of the poses of one tracker of each body: position right, turned by half a radian or more."""
    made = made_tree(0, root_moves=root_moves, trackers=(2, 2))
    rng = np.random.default_rng(92)
    log = logged(made, 0)
    flipped = np.zeros((FRAMES, len(made.body_of)), dtype=bool)
    for body in range(4):
        flipped[:, made.body_of.index(body)] = rng.uniform(size=FRAMES) < 0.33
    turns = poses(rng.choice([-1, 1], (FRAMES, len(made.body_of), 1)) * rng.uniform(0.5, 1.5, 3), np.zeros(3))
    T = np.where(flipped[..., None, None], log.T_ref_part @ turns, log.T_ref_part)
    skeleton, true = true_tree(made)
    measured = measured_of(replace(log, T_ref_part=T), STD_M, STD_RAD)
    fit = refine_tree(skeleton, held_states(skeleton, true, measured, ~flipped), measured.of_parts)
    assert not np.any(fit.inlier[flipped] > 0.5)
    assert np.mean(fit.inlier[~flipped] > 0.5) > 0.999


@pytest.mark.parametrize("root_moves", [False, True])
@pytest.mark.parametrize("share", [0.2, 0.4])
def test_gross_errors_of_single_trackers_cost_no_other_pose(root_moves: bool, share: float) -> None:
    """However the joints are named."""
    made = made_tree(1, root_moves=root_moves, trackers=(3, 3))
    skeleton, true = true_tree(made)
    measured = measured_of(logged(made, 1, Faults(outliers=share)), STD_M, STD_RAD)
    gross = off(made, measured) > GROSS_M
    start = held_states(skeleton, true, measured, ~gross)
    for some_skeleton, some_start in ((skeleton, start), turned_tree(skeleton, start)):
        fit = refine_tree(some_skeleton, some_start, measured.of_parts)
        assert np.mean(fit.inlier[gross] > 0.5) < 0.01
        assert np.mean(fit.inlier[~gross] > 0.5) > 0.99


@pytest.mark.parametrize("root_moves", [False, True])
def test_frames_in_which_a_body_between_was_not_seen_are_used(root_moves: bool) -> None:
    """Jumping states, single trackers, a third unseen: what is beyond must not count as outliers. What nothing observes
    stays where it was, near a state that was.
    """
    made = made_tree(2, root_moves=root_moves)
    skeleton, true = true_tree(made)
    measured = measured_of(logged(made, 2, Faults(missing=0.33)), STD_M, STD_RAD)
    start = held_states(skeleton, true, measured, measured.seen)
    for some_skeleton, some_start in ((skeleton, start), turned_tree(skeleton, start)):
        fit = refine_tree(some_skeleton, some_start, measured.of_parts)
        assert np.mean(fit.inlier[measured.seen] > 0.5) > 0.99
        assert np.abs(fit.model.q).max() < 5 * np.abs(true.q).max()


@pytest.mark.parametrize("kind", ["revolute", "spherical"])
def test_a_state_half_a_turn_off_is_found(kind: str) -> None:
    """In every seventh frame; joints are named both ways."""
    made = single_joint(np.random.default_rng(98), kind, frames=FRAMES, travel=1.0, arm_m=0.2)
    skeleton, true = true_tree(made)
    measured = measured_of(logged(made, 13), STD_M, STD_RAD)
    for some_skeleton, model in ((skeleton, true), turned_tree(skeleton, true)):
        q = model.q.copy()
        q[::7] = skeleton.joints[0].type.moved(q[::7], np.eye(skeleton.states)[:1] * np.pi)
        fit = refine_tree(some_skeleton, replace(model, q=q), measured.of_parts)
        assert np.all(fit.inlier > 0.5)


@pytest.mark.parametrize("root_moves", [False, True])
def test_a_poor_start_is_recovered_from(root_moves: bool) -> None:
    """Every parameter off by some 0.1 m and rad, fifty times what the data tell, and a tenth gross errors.

    No screws: 0.1 m/rad would be three times the pitch.
    """
    kinds = [name for name in KINDS if name != "screw"]
    for seed in (3, 4, 5):
        made = made_tree(seed, root_moves=root_moves, walk=False, kinds=kinds)
        skeleton, true = true_tree(made)
        measured = measured_of(logged(made, seed, Faults(outliers=0.1)), STD_M, STD_RAD)
        step = 0.1 * np.random.default_rng([93, seed]).normal(size=skeleton.parameters)
        best = refine_tree(skeleton, true, measured.of_parts)
        fit = refine_tree(skeleton, with_parameters(skeleton, true, step), measured.of_parts)
        assert np.mean(np.abs(fit.inlier - best.inlier) > 0.5) < 0.01
        for a, b in zip(best.model.frames, fit.model.frames, strict=True):
            zero = se3.log(se3.inverse(a.T_parent_axis) @ b.T_parent_axis)
            np.testing.assert_allclose(zero, 0.0, atol=0.01)  # m, rad: poses that one of them left out


def test_a_joint_that_did_not_move_is_no_trouble() -> None:
    """Its axis is whatever it is, without a warning from the arithmetic; the others are as good as ever."""
    made = made_tree(6, walk=False)
    still = replace(made, q=(np.zeros_like(made.q[0]), *made.q[1:]))
    skeleton, true = true_tree(still)
    fit = refine_tree(skeleton, true, measured_of(logged(still, 6), STD_M, STD_RAD).of_parts)
    assert np.all(np.isfinite(fit.covariance))
    assert np.all(fit.inlier > 0.5)
    T = se3.inverse(true.mounts) @ fit.model.mounts
    np.testing.assert_allclose(se3.log(T), 0.0, atol=0.01)


def test_each_part_s_noise_is_found() -> None:
    """Trackers a third and three times as noisy as said; two to a body, so that each one's own noise shows."""
    made = made_tree(7, trackers=(2, 2), walk=False)
    rng = np.random.default_rng(94)
    factor = rng.choice([1 / 3, 1.0, 3.0], (len(made.body_of), 2))
    scale = np.repeat(factor * [STD_M, STD_RAD], 3, axis=-1)
    noise = scale * rng.normal(size=(FRAMES, len(made.body_of), 6))
    T = made.T_ref_part @ poses(noise[..., 3:], noise[..., :3])
    log = PoseLog(np.arange(float(FRAMES)), "world", made.parts, T)
    skeleton, true = true_tree(made)
    fit = refine_tree(skeleton, true, measured_of(log, STD_M, STD_RAD).of_parts)
    np.testing.assert_allclose(fit.spread / factor, 1.0, atol=0.3)  # 0.05 is chance; the rest is left after some rounds


def test_a_ball_s_orientation_is_no_more_certain_than_its_changes() -> None:
    """On a short arm its states take up whatever the orientation is off, so that residuals tell nothing of that."""
    made = single_joint(np.random.default_rng(97), "spherical", frames=FRAMES, travel=1.0, arm_m=0.03)
    skeleton, true = true_tree(made)
    fit = refine_tree(skeleton, true, measured_of(logged(made, 12), STD_M, STD_RAD / 10).of_parts)
    std = np.sqrt(np.diagonal(fit.state_covariance[0], axis1=1, axis2=2))
    np.testing.assert_allclose(np.median(std, axis=0), STD_RAD, rtol=0.25)  # a tenth is chance


def test_a_wrong_joint_type_shows_in_the_spread_of_its_parts() -> None:
    """A ball taken for a hinge; what hangs elsewhere fits."""
    kinds = ["revolute", "prismatic"]
    made = random_tree(
        np.random.default_rng(95), bodies=4, frames=FRAMES, kinds=kinds, root_moves=False, walk=False, trackers=(2, 2)
    )
    ball = replace(made.joints[-1], type="spherical")
    q = np.stack([0.4 * np.sin(np.linspace(0, f, FRAMES)) for f in (3, 5, 7)], axis=-1)
    wobbling = replace(made, joints=(*made.joints[:-1], ball), q=(*made.q[:-1], q))
    hinged = replace(made, joints=(*made.joints[:-1], replace(ball, type="revolute")), q=(*made.q[:-1], q[:, :1]))
    skeleton, start = true_tree(hinged)
    fit = refine_tree(skeleton, start, measured_of(logged(wobbling, 8), STD_M, STD_RAD).of_parts)
    on_ball = np.equal(made.body_of, ball.child)
    assert fit.spread[on_ball].max() > 5
    assert fit.spread[~on_ball].max() < 2


@pytest.mark.parametrize("root_moves", [False, True])
def test_deviations_of_states_do_not_depend_on_where_zero_is(root_moves: bool) -> None:
    made = made_tree(9, root_moves=root_moves, walk=False)
    skeleton, true = true_tree(made)
    measured = measured_of(logged(made, 9), STD_M, STD_RAD)
    shifted = list(true.frames)
    q = true.q.copy()
    for j, joint in enumerate(skeleton.joints):
        columns = skeleton.state_columns(j)
        zero = np.full(joint.type.states, 0.3)
        shifted[j], q[:, columns], _ = joint.type.from_zero(
            shifted[j], q[:, columns], np.zeros((1, len(zero), 0)), zero
        )
    here = refine_tree(skeleton, true, measured.of_parts)
    there = refine_tree(skeleton, replace(true, frames=tuple(shifted), q=q), measured.of_parts)
    for joint, a, b in zip(skeleton.joints, here.state_covariance, there.state_covariance, strict=True):
        if joint.type.states == 1:
            np.testing.assert_allclose(a, b, rtol=1e-3)
        else:  # the states of a ball turn with their zero
            np.testing.assert_allclose(np.trace(a, axis1=1, axis2=2), np.trace(b, axis1=1, axis2=2), rtol=1e-3)


def test_errors_that_repeat_themselves_widen_what_frames_share() -> None:
    """Slow errors of 10 frames: some 20 frames tell as much as one."""
    made = made_tree(10, walk=False)
    skeleton, true = true_tree(made)
    white, slow = (
        refine_tree(skeleton, true, measured_of(logged(made, 10, Faults(error_frames=f)), STD_M, STD_RAD).of_parts)
        for f in (0.0, 10.0)
    )
    assert 8 < np.median(np.diag(slow.covariance) / np.diag(white.covariance)) < 40


def test_random_poses_are_all_outliers_of_any_tree() -> None:
    """A part that has nothing to do with the tree does not pull it."""
    made = made_tree(11, root_moves=True, trackers=(2, 2), walk=False)
    log = logged(made, 11)
    T = log.T_ref_part.copy()
    T[:, -1] = random_poses(np.random.default_rng(96), 0.5, FRAMES)
    skeleton, true = true_tree(made)
    fit = refine_tree(skeleton, true, measured_of(replace(log, T_ref_part=T), STD_M, STD_RAD).of_parts)
    assert np.mean(fit.inlier[:, :-1] > 0.5) > 0.99
