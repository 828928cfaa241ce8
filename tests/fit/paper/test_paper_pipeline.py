"""The paper's pipeline end to end: simulated trees, each step swapped, what it refuses and what it warns of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.sparse.csgraph import minimum_spanning_tree

from station.errors import InvalidData
from station.fit.options import FitOptions
from station.fit.paper import Criterion, PaperSteps, Weights, learn_paper, low_pass, unsmoothed, weighted_cost
from station.fit.paper.cost import Cost
from station.fit.paper.elimination import Skeleton, eliminate_rigid
from station.fit.paper.joints import PaperJoint, PaperRevolute
from station.fit.paper.optimiser import bfgs, one_by_one, scoring
from station.fit.paper.starts import STARTS
from station.fit.paper.steps import spanning_tree
from station.fit.result import Fit
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray, PoseLog
from tests.fit.simulated import Truth, noisy_log, poses, simulated_tree

RAW = PaperSteps(smoothing=unsmoothed)
FRAMES = 50


def simulated(seed: int, *, bodies: int, trackers: int = 1, sigma: float = 1.0) -> tuple[Truth, PoseLog]:
    """Noise of `sigma` times 0.5 mm and 0.25 deg on each part."""
    rng = np.random.default_rng(seed)
    truth = simulated_tree(rng, bodies=bodies, frames=FRAMES, trackers=(trackers, trackers))
    return truth, noisy_log(rng, truth, sigma_m=0.0005 * sigma, sigma_rad=np.radians(0.25) * sigma)


def joints_found(truth: Truth, log: PoseLog, fit: Fit) -> set[tuple[frozenset[int], str]]:
    body = dict(zip(log.parts, truth.body_of, strict=True))
    return {(frozenset((body[j.parent], body[j.child])), j.type) for j in fit.tree.joints}


def joints_of(truth: Truth) -> set[tuple[frozenset[int], str]]:
    return {(frozenset(joint[:2]), joint[2]) for joint in truth.joints}


def hinge(seed: int = 0, frames: int = FRAMES) -> PoseLog:
    """One part that swings by 60 deg and back before the camera, 0.3 m from its axis."""
    rng, t = np.random.default_rng(seed), np.arange(frames) / 30
    turn = np.radians(60.0) * np.sin(np.pi * t / t[-1])[:, None] * np.array([0.0, 0.6, 0.8])
    exact = poses(turn, np.zeros((frames, 3))) @ poses(np.zeros(3), np.array([0.3, 0.0, 0.0]))
    noise = poses(np.radians(0.5) * rng.normal(size=(frames, 3)), 0.001 * rng.normal(size=(frames, 3)))
    return PoseLog(t, "camera", ("door",), (exact @ noise)[:, None])


def none(start: PaperJoint, T_parent_child: FloatArray, cost: Cost) -> PaperJoint:
    """No optimiser."""
    return start


@pytest.mark.parametrize("seed", range(4))
def test_simulated_trees_of_single_parts_are_found(seed: int) -> None:
    truth, log = simulated(seed, bodies=4)
    assert joints_found(truth, log, learn_paper(log, steps=RAW)) == joints_of(truth)


@pytest.mark.parametrize("seed", range(2))
def test_without_noise_the_parts_of_a_body_become_one_and_the_tree_moves_as_they_did(seed: int) -> None:
    truth, log = simulated(seed, bodies=3, trackers=2, sigma=0.0)
    fit = learn_paper(log, steps=RAW)
    body = dict(zip(log.parts, truth.body_of, strict=True))
    assert {frozenset(body[p] for p in group) for group in fit.tree.rigid_groups} == {
        frozenset([b]) for b in set(truth.body_of)
    }
    assert joints_found(truth, log, fit) == joints_of(truth)
    root = log.parts.index(fit.tree.root)
    for part, T in fit.tree.forward(fit.states.q).items():
        want = se3.inverse(log.T_ref_part[:, root]) @ log.T_ref_part[:, log.parts.index(part)]
        np.testing.assert_allclose(T, want, atol=1e-5)  # m: what the optimiser leaves


def test_states_and_residuals_are_those_of_the_joint() -> None:
    log = hinge()
    fit = learn_paper(log, steps=RAW)
    (joint,) = fit.tree.joints
    assert (joint.parent, joint.child, joint.type) == ("camera", "door", "revolute")
    assert (joint.frames, joint.outliers, joint.axis_std_rad, fit.states.std) == (FRAMES, 0, None, None)
    q = fit.states.state(joint.name)
    truth = np.radians(60.0) * np.sin(np.pi * log.t_s / log.t_s[-1])
    assert np.std(q - truth) < np.radians(0.6)  # the noise about one axis, 0.5 deg; it is known to 10 % from 50 frames
    assert (joint.state_min, joint.state_max) == (q.min(), q.max())
    assert q[0] == 0 and q.max() > 1.0  # rad: counted from the first frame, towards the larger excursion
    model = joint.forward(q)
    turn = se3.angle(np.swapaxes(model[:, :3, :3], -1, -2) @ log.T_ref_part[:, 0, :3, :3])
    assert joint.rms_rotation_rad == pytest.approx(np.sqrt(np.mean(turn**2)), rel=1e-6)
    shift = np.linalg.norm(model[:, :3, 3] - log.T_ref_part[:, 0, :3, 3], axis=-1)
    assert joint.rms_translation_m == pytest.approx(np.sqrt(np.mean(shift**2)), rel=1e-6)
    assert joint.scores is not None and joint.scores["criterion"] == "paper-aic"
    assert joint.probability is not None and joint.probability["revolute"] > 0.99


def test_frames_with_an_unseen_part_are_discarded_and_said_so() -> None:
    truth, log = simulated(1, bodies=3)
    T = log.T_ref_part.copy()
    T[5:9, 0], T[30:32, 2] = np.nan, np.nan
    fit = learn_paper(PoseLog(log.t_s, log.reference, log.parts, T), steps=RAW)
    gone = np.isnan(fit.states.q).all(axis=-1)
    np.testing.assert_array_equal(np.flatnonzero(gone), [5, 6, 7, 8, 30, 31])
    assert not np.isnan(fit.states.q[~gone]).any()
    assert any("6 of 50 frames were discarded" in warning for warning in fit.tree.warnings)
    kept = ~gone
    alone = learn_paper(PoseLog(log.t_s[kept], log.reference, log.parts, log.T_ref_part[kept]), steps=RAW)
    np.testing.assert_array_equal(fit.states.q[kept], alone.states.q)
    assert joints_found(truth, log, fit) == joints_of(truth)


def test_a_part_without_orientations_leaves_no_frames() -> None:
    log = hinge()
    covariance = np.tile(np.diag([1e-6] * 3 + [np.inf] * 3), (FRAMES, 1, 1, 1))
    with pytest.raises(InvalidData, match=r"0 of 50 frames .* door 0; leave parts out, or use method 'station'"):
        learn_paper(PoseLog(log.t_s, "camera", log.parts, log.T_ref_part, covariance))


def test_poses_are_smoothed_unless_told_otherwise() -> None:
    """A third of the bandwidth's noise is left: 0.45 of its deviation, of rotation and of translation."""
    rough, smooth = (learn_paper(hinge(frames=300), steps=steps).tree.joints[0] for steps in (RAW, PaperSteps()))
    assert rough.rms_rotation_rad is not None and smooth.rms_rotation_rad is not None
    assert 0.3 < smooth.rms_rotation_rad / rough.rms_rotation_rad < 0.6


def test_the_low_pass_correlates_the_noise() -> None:
    """What is left of one frame's noise is nearly that of the next: frames no longer tell what their number says."""

    def correlation(log: PoseLog) -> float:
        noise = log.T_ref_part[:, 0, :3, 3]
        return float(np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2))

    rng = np.random.default_rng(0)
    T = poses(0.01 * rng.normal(size=(600, 3)), 0.001 * rng.normal(size=(600, 3)))
    log = PoseLog(np.arange(600) / 30, "camera", ("still",), T[:, None])
    assert abs(correlation(log)) < 0.1  # 0.02 is one deviation
    assert correlation(low_pass(log)) > 0.8


def test_the_fit_ignores_the_world_frame() -> None:
    _, log = simulated(2, bodies=3)
    elsewhere = poses(np.array([0.3, 0.4, -0.9]), np.array([1.0, -2.0, 0.5]))
    here = learn_paper(log, steps=RAW)
    there = learn_paper(PoseLog(log.t_s, "world", log.parts, elsewhere @ log.T_ref_part), steps=RAW)
    for a, b in zip(here.tree.joints, there.tree.joints, strict=True):
        assert (a.name, a.type) == (b.name, b.type)
        assert a.axis_parent is not None and b.axis_parent is not None
        np.testing.assert_allclose(a.axis_parent, b.axis_parent, atol=1e-4)  # what the optimiser leaves


def test_the_seed_decides_the_starts_alone() -> None:
    _, log = simulated(3, bodies=3)
    once, again, other = (learn_paper(log, steps=replace(RAW, seed=seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(once.states.q, again.states.q)
    assert not np.array_equal(once.states.q, other.states.q)
    np.testing.assert_allclose(once.states.q, other.states.q, atol=1e-3)  # rad, m: the same minimum


def test_the_root_is_the_part_asked_for_or_the_one_that_stays() -> None:
    truth, log = simulated(4, bodies=3)
    fit = learn_paper(log, steps=RAW)
    assert truth.body_of[log.parts.index(fit.tree.root)] == 0  # the simulated root stands still
    wanted = log.parts[truth.body_of.index(2)]
    other = learn_paper(log, FitOptions(root=wanted), steps=RAW)
    assert other.tree.root == wanted
    poses_here, poses_there = (f.tree.forward(f.states.q) for f in (fit, other))
    for part in log.parts:
        moved = se3.inverse(poses_here[wanted]) @ poses_here[part]
        np.testing.assert_allclose(poses_there[part], moved, atol=1e-12)


def test_the_reference_frame_is_a_part_when_asked_for() -> None:
    _, log = simulated(4, bodies=2)
    fit = learn_paper(log, FitOptions(include_reference=True), steps=RAW)
    assert fit.tree.root == "world"
    assert fit.tree.parts == ("world", *log.parts)


def test_parts_that_do_not_move_are_one_body_without_joints() -> None:
    still = np.broadcast_to(poses(np.ones((2, 3)), np.arange(6.0).reshape(2, 3)), (30, 2, 4, 4))
    fit = learn_paper(PoseLog(np.arange(30.0), "world", ("a", "b"), still))
    assert fit.tree.rigid_groups == (("a", "b"),)
    assert fit.states.q.shape == (30, 0)
    assert any("no part moved" in warning for warning in fit.tree.warnings)


def test_a_joint_that_hardly_moved_is_warned_about() -> None:
    log = hinge()
    few = PoseLog(log.t_s[:4], "camera", log.parts, log.T_ref_part[:4])  # 11 deg up the swing
    tree = learn_paper(few, FitOptions(joint_types=("revolute",)), steps=RAW).tree
    assert any("moved only" in warning and "may not be identifiable" in warning for warning in tree.warnings)
    assert learn_paper(log, steps=RAW).tree.warnings == ()


def test_states_go_on_through_full_turns() -> None:
    t = np.arange(60) / 30
    turn = 3.5 * np.pi * t[:, None] / t[-1] * np.array([0.0, 0.0, 1.0])
    T = poses(turn, np.zeros((60, 3))) @ poses(np.zeros(3), np.array([0.2, 0.0, 0.0]))
    fit = learn_paper(PoseLog(t, "camera", ("wheel",), T[:, None]), steps=RAW)
    np.testing.assert_allclose(np.abs(fit.states.q[:, 0]), turn[:, 2], atol=1e-6)  # rad: what the optimiser leaves


# Each of Figure 3's boxes, swapped.


def test_smoothing_can_be_swapped() -> None:
    def median(log: PoseLog) -> PoseLog:
        last = len(log.t_s) - 1
        rows = np.clip(np.arange(last + 1)[:, None] + np.arange(-2, 3), 0, last)
        around = np.median(log.T_ref_part[rows], axis=1)
        T = se3.pose(se3.project_to_so3(around[..., :3, :3]), around[..., :3, 3])
        return PoseLog(log.t_s, log.reference, log.parts, T)

    log = hinge()
    wild = log.T_ref_part.copy()
    wild[40] = poses(np.ones(3), np.ones(3))
    spoilt = PoseLog(log.t_s, "camera", log.parts, wild)
    by_default, by_median = (learn_paper(spoilt, steps=PaperSteps(smoothing=s)).tree for s in (low_pass, median))
    assert by_median.joints[0].rms_translation_m < 0.5 * by_default.joints[0].rms_translation_m
    heavier = learn_paper(log, steps=PaperSteps(smoothing=partial(low_pass, cutoff_share=0.02))).tree.joints[0]
    assert heavier.rms_rotation_rad < learn_paper(log).tree.joints[0].rms_rotation_rad


def test_the_cost_and_its_weights_can_be_swapped() -> None:
    """Rotations that weigh next to nothing: their residual grows, the translations' shrinks."""
    log = hinge()
    both, places = (
        learn_paper(log, steps=replace(RAW, cost=weighted_cost(weights))).tree.joints[0]
        for weights in (Weights.of_noise(np.radians(0.5), 0.001), Weights.of_noise(10.0, 0.001))
    )
    assert places.rms_translation_m < both.rms_translation_m

    def sturm(T_model: FloatArray, T_measured: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Equation 9 in place of 16: twice its exponent, with the gradient by the same twist."""
        xi = se3.log(se3.inverse(T_model) @ T_measured)
        weight = np.array([1e6] * 3 + [1e4] * 3)
        J = se3.inverse_left_jacobian(xi)
        return (weight * xi**2).sum(axis=-1), -2 * (np.swapaxes(J, -1, -2) @ (weight * xi)[..., None])[..., 0]

    swapped = learn_paper(log, steps=replace(RAW, cost=sturm)).tree.joints[0]
    assert swapped.type == "revolute"
    np.testing.assert_allclose(swapped.axis_parent, both.axis_parent, atol=0.01)  # rad: the noise


def test_the_optimiser_can_be_swapped() -> None:
    def trust_region(objective: Callable[[FloatArray], tuple[float, FloatArray]], step: FloatArray) -> FloatArray:
        return minimize(objective, step, jac=True, method="TNC", options={"maxfun": 2000}).x

    log = hinge()
    first, second, other, unmoved = (
        learn_paper(log, steps=replace(RAW, optimiser=optimiser)).tree.joints[0]
        for optimiser in (scoring, one_by_one(bfgs), one_by_one(trust_region), none)
    )
    np.testing.assert_allclose(second.axis_parent, first.axis_parent, atol=1e-6)
    np.testing.assert_allclose(other.axis_parent, first.axis_parent, atol=1e-3)
    assert unmoved.rms_translation_m > 2 * first.rms_translation_m


def test_starts_can_be_swapped_for_those_by_rotations() -> None:
    """A marker on the axis: the closed form by rotations finds the axis where the circumcentre is the noise's."""

    def by_rotations(T_parent_child: FloatArray, _: np.random.Generator) -> PaperRevolute:
        frames = JOINT_TYPES["revolute"].starts(T_parent_child, np.ones(len(T_parent_child)))[0]
        return PaperRevolute(frames.T_parent_axis, frames.T_axis_child)

    rng, t = np.random.default_rng(1), np.arange(FRAMES) / 30
    axis = np.array([0.0, 0.6, 0.8])
    turn = np.radians(60.0) * np.sin(np.pi * t / t[-1])[:, None] * axis
    T = poses(turn + np.radians(0.2) * rng.normal(size=(FRAMES, 3)), 0.001 * rng.normal(size=(FRAMES, 3)))
    log = PoseLog(t, "camera", ("knob",), T[:, None])
    options = FitOptions(joint_types=("revolute",))
    paper, ours = (
        learn_paper(log, options, steps=replace(RAW, starts=starts, optimiser=none)).tree.joints[0].axis_parent
        for starts in (STARTS, {**STARTS, "revolute": by_rotations})
    )
    assert abs(ours @ axis) > np.cos(np.radians(1.0))
    assert abs(paper @ axis) < np.cos(np.radians(5.0))


def test_the_criterion_can_be_swapped() -> None:
    """Rigid parts under noise: one more parameter for each frame's state makes them one body."""
    _, log = simulated(0, bodies=2, trackers=2, sigma=2.0)
    counting = Criterion(
        "aic-with-states", lambda joint, cost, frames: cost + 2 * (joint.parameters + frames * (joint.name != "rigid"))
    )
    cost = weighted_cost(Weights.of_noise(np.radians(0.7), 0.002))
    by_paper, by_states = (
        learn_paper(log, steps=replace(RAW, cost=cost, criterion=criterion)).tree
        for criterion in (RAW.criterion, counting)
    )
    assert by_paper.rigid_groups == ()
    assert len(by_states.rigid_groups) == 2
    assert by_states.joints[0].scores["criterion"] == "aic-with-states"


def test_structure_and_elimination_can_be_swapped() -> None:
    def chain(parts: int, pairs: FloatArray, scores: FloatArray) -> FloatArray:
        return np.flatnonzero(pairs[:, 1] - pairs[:, 0] == 1)

    seen: list[int] = []

    def counted(parts: int, edges: list) -> Skeleton:
        seen.append(len(edges))
        return eliminate_rigid(parts, edges)

    _, log = simulated(1, bodies=3)
    tree = learn_paper(log, steps=replace(RAW, structure=chain, elimination=counted)).tree
    links = {frozenset((j.parent, j.child)) for j in tree.joints}
    assert links == {frozenset(log.parts[i : i + 2]) for i in range(2)}
    assert seen == [2]


@pytest.mark.parametrize("seed", range(5))
def test_the_structure_is_the_minimum_spanning_tree_whatever_the_scores_signs(seed: int) -> None:
    """Against SciPy's on scores that are all positive; shifted ones, a zero among them, give the same tree."""
    rng = np.random.default_rng(seed)
    pairs = np.stack(np.triu_indices(6, k=1), axis=-1)
    scores = rng.uniform(1, 1000, len(pairs))
    graph = np.zeros((6, 6))
    graph[tuple(pairs.T)] = scores
    wanted = {tuple(edge) for edge in np.argwhere(minimum_spanning_tree(graph).toarray() > 0).tolist()}
    for shifted in (scores, scores - scores.min(), scores - 500, -scores.max() + scores):
        assert {tuple(pairs[i]) for i in spanning_tree(6, pairs, shifted)} == wanted


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (FitOptions(joint_types=("rigid", "screw")), "method 'paper' has rigid, prismatic, revolute"),
        (FitOptions(joint_types=()), "joint types none; method 'paper' has rigid, prismatic, revolute"),
        (FitOptions(criterion="bic"), "criterion 'bic'; method 'paper' has paper-aic only"),
        (FitOptions(root="elbow"), "no part 'elbow' for a root; have camera, door"),
    ],
)
def test_options_that_the_method_does_not_have_are_refused(options: FitOptions, message: str) -> None:
    with pytest.raises(InvalidData, match=message):
        learn_paper(hinge(), options)


def test_logs_without_parts_or_frames_are_refused() -> None:
    with pytest.raises(InvalidData, match="no parts"):
        learn_paper(PoseLog(np.arange(5.0), "world", (), np.zeros((5, 0, 4, 4))))
    with pytest.raises(InvalidData, match=r"2 of 2 frames .* wants 3"):
        learn_paper(hinge(frames=2))
    log = hinge()
    with pytest.raises(InvalidData, match="reference frame's name 'door'"):
        learn_paper(PoseLog(log.t_s, "door", log.parts, log.T_ref_part))
