"""The learner end to end: structure, groups, types, axes, states of simulated objects; roots, warnings, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import Truth, noisy_log, poses, scores, simulated_tree

from station.errors import InvalidData
from station.fit.learner import Fit, FitOptions, learn
from station.formats.trees import load_tree
from station.kinematics import se3
from station.kinematics.tree import Joint
from station.logs import PoseLog
from station.simulate import SimulationOptions, simulate

TREES = 20
LEAST_RIGHT = 0.95


def is_right(truth: Truth, log: PoseLog, fit: Fit) -> bool:
    """Bodies, joints between them, and their types."""
    return scores(truth, log, fit.tree).types_correct


def matched(truth: Truth, log: PoseLog, fit: Fit) -> list[tuple[int, Joint]]:
    """(index in the truth, joint) of a right fit's joints."""
    body = dict(zip(log.parts, truth.body_of, strict=True))
    ends = [frozenset(joint[:2]) for joint in truth.joints]
    return [(ends.index(frozenset((body[j.parent], body[j.child]))), j) for j in fit.tree.joints]


def state_errors(truth: Truth, log: PoseLog, fit: Fit) -> list[np.ndarray]:
    """Errors over deviations of each joint's states, after sign and offset."""
    found = []
    for i, joint in matched(truth, log, fit):
        column = fit.states.joints.index(joint.name)
        assert fit.states.std is not None
        q, std = fit.states.q[:, column], fit.states.std[:, column]
        good = np.isfinite(q)
        sign = np.sign(np.corrcoef(q[good], truth.q[good, i])[0, 1])
        error = sign * q[good] - truth.q[good, i]
        error -= np.average(error, weights=1 / std[good] ** 2)
        found.append(error / std[good])
    return found


def axis_ratios(truth: Truth, log: PoseLog, fit: Fit) -> list[float]:
    """Squared axis errors over their variances, in the frame of the joint's parent part."""
    found = []
    for i, joint in matched(truth, log, fit):
        part = log.parts.index(joint.parent)
        T = truth.T_world_body[0]
        axis_world = T[truth.joints[i][0], :3, :3] @ truth.axis_parent_body[i]
        axis = (T[truth.body_of[part]] @ truth.T_body_part[part])[:3, :3].T @ axis_world
        assert joint.axis_parent is not None and joint.axis_std_rad is not None
        error = np.arctan2(np.linalg.norm(np.cross(axis, joint.axis_parent)), abs(axis @ joint.axis_parent))
        found.append(float(error / joint.axis_std_rad) ** 2)
    return found


def simulated(seed: int) -> tuple[Truth, PoseLog]:
    """Still and moving roots, smooth and random-walk motion; each fourth as a camera sees it, a fifth missing."""
    rng = np.random.default_rng(seed)
    kind = "smooth" if seed % 3 else "walk"
    trackers = (1, 2 if seed % 5 else 3)
    size = int(rng.integers(3, 6))
    truth = simulated_tree(rng, bodies=size, root_moves=bool(seed % 2), kind=kind, frames=120, trackers=trackers)
    sigma_m, sigma_rad = rng.uniform(0.001, 0.003), np.radians(rng.uniform(0.5, 2.0))
    if seed % 4 == 3:
        return truth, noisy_log(
            rng, truth, sigma_m=0.5 * sigma_m, sigma_rad=np.radians(0.3), missing=0.2, camera_like=True
        )
    return truth, noisy_log(rng, truth, sigma_m=sigma_m, sigma_rad=sigma_rad)


@pytest.fixture(scope="module")
def fits() -> list[tuple[Truth, PoseLog, Fit]]:
    found = []
    for seed in range(TREES):
        truth, log = simulated(seed)
        found.append((truth, log, learn(log)))
    return found


def test_simulated_trees_are_found(fits: list[tuple[Truth, PoseLog, Fit]]) -> None:
    right = [is_right(*fit) for fit in fits]
    assert np.mean(right) >= LEAST_RIGHT, f"wrong: {np.flatnonzero(~np.array(right))}"


def test_state_errors_are_as_large_as_their_deviations_say(fits: list[tuple[Truth, PoseLog, Fit]]) -> None:
    errors = [error for fit in fits if is_right(*fit) for error in state_errors(*fit)]
    assert 0.85 < np.mean(np.concatenate(errors) ** 2) < 1.15
    assert max(np.mean(error**2) for error in errors) < 1.8  # for each joint; the axis's error is shared by all frames


def test_axis_errors_are_as_large_as_their_deviations_say(fits: list[tuple[Truth, PoseLog, Fit]]) -> None:
    ratios = [ratio for fit in fits if is_right(*fit) for ratio in axis_ratios(*fit)]
    assert 0.6 < np.mean(ratios) < 1.5  # some 60 joints with two directions each


def test_the_tree_s_forward_kinematics_give_the_measured_poses(fits: list[tuple[Truth, PoseLog, Fit]]) -> None:
    """A check of axes, zeros and states together: poses against the truth, from one part to another."""
    for truth, log, fit in fits:
        if not is_right(truth, log, fit):
            continue
        known = np.all(np.isfinite(fit.states.q), axis=-1)
        poses_root = fit.tree.forward({j: fit.states.q[known, i] for i, j in enumerate(fit.states.joints)})
        exact = truth.T_world_body[:, list(truth.body_of)] @ truth.T_body_part
        root = log.parts.index(fit.tree.root)
        for part, T in poses_root.items():
            want = se3.inverse(exact[known, root]) @ exact[known, log.parts.index(part)]
            error = se3.log(se3.inverse(want) @ T)
            assert np.degrees(np.sqrt(np.mean(error[:, 3:] ** 2))) < 1.5
            assert np.sqrt(np.mean(error[:, :3] ** 2)) < 0.012  # m: a degree at half a metre, and the noise


def chain(rng: np.random.Generator, *, moves: bool) -> PoseLog:
    """base - arm - tip, a revolute joint of 80 deg each; the base still or not."""
    t = np.linspace(0, 1, 150)
    z, flat = np.array([0.0, 0, 1]), np.zeros((150, 3))
    sway = poses(0.4 * np.sin(3 * t)[:, None] * np.array([1.0, 0.5, 0]), 0.3 * t[:, None] * z)
    base = sway if moves else np.broadcast_to(np.eye(4), (150, 4, 4))
    arm = base @ poses(1.4 * t[:, None] * z, flat) @ poses(np.zeros(3), np.array([0.3, 0, 0]))
    tip = arm @ poses(1.4 * np.sin(4 * t)[:, None] * np.array([0.0, 1, 0]), flat) @ poses(np.zeros(3), [0.2, 0, 0])
    exact = np.stack([base, arm, tip], axis=1)
    noise = rng.normal(size=(150, 3, 6)) * np.repeat([1e-3, 0.01], 3)
    return PoseLog(t, "world", ("tip", "base", "arm"), (exact @ poses(noise[..., 3:], noise[..., :3]))[:, [2, 0, 1]])


def test_the_fit_ignores_the_world_frame() -> None:
    log = chain(np.random.default_rng(49), moves=True)
    elsewhere = se3.exp([1.0, -2.0, 0.5, 0.3, 0.4, -0.9])
    other = PoseLog(log.t_s, "world", log.parts, elsewhere @ log.T_ref_part)
    here, there = learn(log), learn(other)
    assert here.tree.rigid_groups == there.tree.rigid_groups
    for a, b in zip(here.tree.joints, there.tree.joints, strict=True):
        assert (a.name, a.type) == (b.name, b.type)
        assert a.axis_parent is not None
        np.testing.assert_allclose(a.axis_parent, b.axis_parent, atol=1e-4)


def test_the_root_is_the_part_that_stands_still_else_the_one_in_the_middle() -> None:
    assert learn(chain(np.random.default_rng(50), moves=False)).tree.root == "base"
    assert learn(chain(np.random.default_rng(50), moves=True)).tree.root == "arm"


@pytest.mark.parametrize("root", ["tip", "base", "arm"])
def test_the_root_can_be_chosen_and_the_motion_stays(root: str) -> None:
    log = chain(np.random.default_rng(51), moves=False)
    fit = learn(log, FitOptions(root=root))
    assert fit.tree.root == root
    T = fit.tree.forward({j: fit.states.q[:, i] for i, j in enumerate(fit.states.joints)})
    measured = se3.inverse(log.T_ref_part[:, log.parts.index("base")]) @ log.T_ref_part[:, log.parts.index("tip")]
    error = se3.log(se3.inverse(measured) @ se3.inverse(T["base"]) @ T["tip"])
    assert np.sqrt(np.mean(error[:, 3:] ** 2)) < 0.025  # rad: the measurements' own noise


def test_states_begin_at_zero_and_grow_over_the_motion() -> None:
    fit = learn(chain(np.random.default_rng(52), moves=False))
    pan = fit.states.state("base__arm")
    assert pan[0] == 0
    assert pan[-1] == pytest.approx(1.4, abs=0.03)  # rad


def test_angles_go_on_past_a_full_turn() -> None:
    rng, t = np.random.default_rng(53), np.linspace(0, 1, 200)
    q = 9.0 * t
    exact = poses(q[:, None] * np.array([0.0, 0, 1]), np.zeros((200, 3))) @ poses(np.zeros(3), np.array([0.2, 0, 0]))
    noise = rng.normal(size=(200, 6)) * np.repeat([1e-3, 0.01], 3)
    fit = learn(PoseLog(t, "world", ("wheel",), (exact @ poses(noise[:, 3:], noise[:, :3]))[:, None]))
    np.testing.assert_allclose(fit.states.q[:, 0], q, atol=0.08)  # rad


def test_one_part_is_joined_to_the_reference_frame() -> None:
    log = chain(np.random.default_rng(54), moves=False)
    fit = learn(PoseLog(log.t_s, "world", ("arm",), log.T_ref_part[:, 2:]))
    assert fit.tree.parts == ("world", "arm")
    assert [(j.name, j.type) for j in fit.tree.joints] == [("world__arm", "revolute")]


def test_the_reference_frame_can_be_made_a_part() -> None:
    fit = learn(chain(np.random.default_rng(55), moves=False), FitOptions(include_reference=True))
    assert fit.tree.root == "world"
    assert fit.tree.rigid_groups == (("world", "base"),)


def test_parts_never_seen_together_are_joined_through_a_third() -> None:
    """Two trackers of one body that are never seen at once, and a body in between that both see."""
    log = chain(np.random.default_rng(56), moves=True)
    mount = se3.exp([0.02, 0.01, 0.0, 0.3, 0.0, 0.0])
    first, second = log.T_ref_part[:, 2].copy(), log.T_ref_part[:, 2] @ mount
    first[75:], second[:75] = np.nan, np.nan
    base = log.T_ref_part[:, 1]
    rest = se3.exp([0.0, 0.05, 0.0, 0.0, 0.2, 0.0])
    parts = ("first", "second", "base", "base_b")
    fit = learn(PoseLog(log.t_s, "world", parts, np.stack([first, second, base, base @ rest], axis=1)))
    assert ("base", "base_b") in fit.tree.rigid_groups
    assert {j.type for j in fit.tree.joints} == {"revolute"}


def test_a_joint_that_hardly_moved_is_warned_about() -> None:
    rng, t = np.random.default_rng(0), np.linspace(0, 1, 30)
    q = np.radians(5.0) * t
    exact = poses(q[:, None] * np.array([0.0, 0, 1]), np.zeros((30, 3)))
    noise = rng.normal(size=(30, 6)) * np.repeat([2e-3, 0.01], 3)
    fit = learn(PoseLog(t, "world", ("flap",), (exact @ poses(noise[:, 3:], noise[:, :3]))[:, None]))
    assert fit.tree.joints[0].type == "revolute"
    assert any("moved only 5" in warning and "its axis is not identifiable" in warning for warning in fit.tree.warnings)


@pytest.mark.parametrize("flat", [True, False])
def test_poses_of_a_tracker_in_2d_are_warned_about(flat: bool) -> None:
    made = simulate(load_tree("planar_linkage"), SimulationOptions(planar=True, planar_noise=flat), seed=1)
    assert any("tracker in 2D" in warning for warning in learn(made.log).tree.warnings) == flat


def test_a_part_that_was_hardly_seen_stays_out_and_is_named() -> None:
    log = chain(np.random.default_rng(58), moves=False)
    T = log.T_ref_part.copy()
    T[4:, 0] = np.nan
    fit = learn(PoseLog(log.t_s, "world", log.parts, T))
    assert ("tip",) in fit.tree.trees
    assert any("tip was seen in 4 of 150 frames" in warning for warning in fit.tree.warnings)
    assert [(j.parent, j.child) for j in fit.tree.joints] == [("base", "arm")]


def test_parts_that_do_not_move_are_one_body_without_joints() -> None:
    still = np.broadcast_to(se3.exp(np.ones((2, 6))), (30, 2, 4, 4))
    fit = learn(PoseLog(np.arange(30.0), "world", ("a", "b"), still))
    assert fit.tree.rigid_groups == (("a", "b"),)
    assert fit.states.q.shape == (30, 0)
    assert any("no part moved" in warning for warning in fit.tree.warnings)


def test_positions_alone_join_a_part_to_one_with_orientation() -> None:
    """The tip's orientation was not measured; its joint is told by where it is in the arm's frame."""
    log = chain(np.random.default_rng(60), moves=False)
    T, covariance = log.T_ref_part.copy(), np.tile(np.diag([1e-6] * 3 + [1e-4] * 3), (150, 3, 1, 1))
    T[:, 0, :3, :3] = np.eye(3)
    covariance[:, 0, range(3, 6), range(3, 6)] = np.inf
    for variance in (1e-6, np.nan):  # known, and to be estimated
        covariance[:, :, range(3), range(3)] = variance
        fit = learn(PoseLog(log.t_s, "world", log.parts, T, covariance))
        assert [(j.name, j.type) for j in fit.tree.joints] == [("base__arm", "revolute"), ("arm__tip", "revolute")]
        assert fit.tree.joints[1].rms_rotation_rad is None


def test_a_covariance_that_is_none_is_refused() -> None:
    log = chain(np.random.default_rng(61), moves=False)
    with pytest.raises(InvalidData, match="'tip' in row 0 is not symmetric and positive definite"):
        learn(PoseLog(log.t_s, "world", log.parts, log.T_ref_part, np.zeros((150, 3, 6, 6))))


def test_an_empty_log_is_refused() -> None:
    with pytest.raises(InvalidData, match="a 0, b 0 of 0 frames"):
        learn(PoseLog(np.zeros(0), "world", ("a", "b"), np.zeros((0, 2, 4, 4))))


def test_too_few_frames_are_refused_with_counts() -> None:
    still = np.broadcast_to(np.eye(4), (3, 2, 4, 4))
    with pytest.raises(InvalidData, match="a 3, b 3 of 3 frames"):
        learn(PoseLog(np.arange(3.0), "world", ("a", "b"), still))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (FitOptions(method="magic"), "choose one of station, paper"),
        (FitOptions(criterion="best"), "choose one of evidence"),
        (FitOptions(joint_types=("rigid", "hinge")), "want one or more of rigid"),
        (FitOptions(joint_types=()), "want one or more of rigid"),
        (FitOptions(root="elbow"), "no part 'elbow'"),
    ],
)
def test_options_that_do_not_exist_are_refused_with_the_choices(options: FitOptions, message: str) -> None:
    with pytest.raises(InvalidData, match=message):
        learn(chain(np.random.default_rng(59), moves=False), options)


@pytest.mark.parametrize("kind", ["hinge", "drawer"])
def test_states_of_positions_alone_are_as_far_off_as_they_say(kind: str):
    """Where no orientation is measured the states' zero is a choice: no part of their deviation."""
    rng = np.random.default_rng(5)
    truth = np.linspace(0.0, 1.2 if kind == "hinge" else 0.4, 150)
    around = np.stack([0.4 * np.cos(truth), 0.4 * np.sin(truth), np.full_like(truth, 0.7)], axis=-1)
    along = np.array([0.3, -0.2, 1.0]) + truth[:, None] * np.array([0.6, 0.0, 0.8])
    T = se3.translation((around if kind == "hinge" else along) + 0.002 * rng.normal(size=(150, 3)))
    covariance = np.zeros((150, 1, 6, 6))
    covariance[:, :, range(3), range(3)] = np.nan
    covariance[:, :, range(3, 6), range(3, 6)] = np.inf
    fit = learn(PoseLog(np.arange(150.0), "world", ("door",), T[:, None], covariance))
    assert fit.tree.joints[0].type == ("revolute" if kind == "hinge" else "prismatic")
    assert fit.states.std is not None
    error = fit.states.q[:, 0] * np.sign(fit.states.q[-1, 0]) - truth
    error -= np.mean(error)
    assert 0.7 < np.sqrt(np.mean((error / fit.states.std[:, 0]) ** 2)) < 1.3
