"""Pairwise fit: Jacobians, accuracy against the bound, outliers, noise scales, positions alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.noise import given_noise, inverse_cholesky, unknown_noise
from station.fit.pair_model import JointFit, Model, PairTracks, parameter_covariance, stepped_frames
from station.fit.pair_residuals import errors, linearised
from station.fit.pairwise import fit_joint, fit_types
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointType
from station.logs import FloatArray

SIGMA_M, SIGMA_RAD = 0.003, 0.02
WITH_AXIS = pytest.mark.parametrize("name", [name for name, joint in JOINT_TYPES.items() if joint.has_axis])
MOVABLE = pytest.mark.parametrize("name", [name for name, joint in JOINT_TYPES.items() if joint.states])
TRAVEL = {"rigid": 0.0, "prismatic": 0.2, "revolute": 1.0, "screw": 4.0, "spherical": 1.2}
PITCH_M = 0.03


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """(...,) radians between lines along a and b (..., 3)."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.abs(np.sum(a * b, axis=-1)))


def simulated_pairs(
    rng: np.random.Generator,
    name: str,
    *,
    pairs: int = 20,
    frames: int = 200,
    travel: float | None = None,
    arm: float = 0.3,
) -> tuple[JointFrames, FloatArray, FloatArray]:
    """Frames, states and exact relative poses of random joints of one type."""
    joint = JOINT_TYPES[name]
    of_parent = se3.exp(0.5 * rng.normal(size=(pairs, 6)))
    of_child = se3.pose(se3.exp_so3(rng.normal(size=(pairs, 3))), np.array([arm, 0, 0]))
    q = (TRAVEL[name] if travel is None else travel) * (rng.uniform(size=(pairs, frames, joint.states)) - 0.5)
    q = np.sort(q, axis=1) if joint.states == 1 else q
    joints = JointFrames(of_parent, of_child, np.full((pairs, joint.form_freedoms), PITCH_M))
    return joints, q, of_parent[:, None] @ joint.axis_motion(q, joints.form[:, None]) @ of_child[:, None]


def noisy(rng: np.random.Generator, T: FloatArray) -> FloatArray:
    return T @ se3.exp(rng.normal(size=(*T.shape[:2], 6)) * np.repeat([SIGMA_M, SIGMA_RAD], 3))


def tracks_of(T: FloatArray, *, oriented: bool = True) -> PairTracks:
    seen, one = np.ones(T.shape[:2], dtype=bool), np.ones(len(T), dtype=bool)
    return PairTracks(T, seen, seen & oriented, unknown_noise(T, ~one, one), np.ones(len(T)))


def axis_error(fit: JointFit, truth: JointFrames) -> FloatArray:
    return angle_between(fit.model.frames.T_parent_axis[:, :3, 2], truth.T_parent_axis[:, :3, 2])


def centre_error(fit: JointFit, truth: JointFrames) -> FloatArray:
    """(P,) metres between the axis frames' origins."""
    between = fit.model.frames.T_parent_axis[:, :3, 3] - truth.T_parent_axis[:, :3, 3]
    return np.asarray(np.linalg.norm(between, axis=-1))


def axis_std(fit: JointFit) -> FloatArray:
    """(P,) sqrt of the trace of the two directions' covariance."""
    variance = np.diagonal(parameter_covariance(fit.information), axis1=-2, axis2=-1)
    return np.sqrt(variance[:, [fit.joint.axis_freedoms.index(i) for i in (3, 4)]].sum(axis=-1))


def numeric_jacobians(joint: JointType, model: Model, tracks: PairTracks) -> tuple[FloatArray, FloatArray]:
    """(6, n, P, T) and (6, s, P, T) derivatives of whitened residuals by central differences."""
    step = 1e-6
    still, nothing = np.zeros_like(model.q), np.zeros((len(model.q), joint.parameters))
    whitening = tracks.data.noise.whitening(model.scales)

    def at(delta: FloatArray, dq: FloatArray) -> FloatArray:
        moved = errors(
            joint, stepped_frames(joint, model.frames, delta), joint.moved(model.q, dq), tracks.data.R, tracks.data.t
        )
        return whitening(moved.d, moved.e)

    def slope(delta: FloatArray, dq: FloatArray) -> FloatArray:
        return (at(step * delta, step * dq) - at(-step * delta, -step * dq)) / (2 * step)

    by_parameters = [slope(nothing + row, still) for row in np.eye(joint.parameters)]
    by_states = [slope(nothing, still + row) for row in np.eye(joint.states)]
    empty = np.zeros((6, 0, *model.q.shape[:2]))
    return np.stack(by_parameters, axis=1), np.stack(by_states, axis=1) if by_states else empty


@pytest.mark.parametrize("name", JOINT_TYPES)
@pytest.mark.parametrize(("size_m", "size_rad"), [(1e-3, 1e-2), (1e-9, 1e-2), (1e-2, 1e-9), (0.3, 2.0), (0.0, 0.0)])
def test_jacobians_are_those_of_finite_differences(name: str, size_m: float, size_rad: float) -> None:
    """The states' own directions, and those of the parameters without what the states take up."""
    rng, joint = np.random.default_rng(7), JOINT_TYPES[name]
    frames, q, T = simulated_pairs(rng, name, pairs=3, frames=4)
    T_meas = T @ se3.exp(rng.normal(size=(3, 4, 6)) * np.repeat([size_m, size_rad], 3))
    tracks, one = tracks_of(T_meas), np.ones(3, dtype=bool)
    tracks = replace(tracks, noise=unknown_noise(T_meas, one, one))
    model = Model(frames, q, np.tile([0.5, 2.0], (3, 1)), np.full(3, 0.05), np.full(3, 0.01))
    at, whitening = errors(joint, frames, q, tracks.data.R, tracks.data.t), tracks.data.noise.whitening(model.scales)
    linear = linearised(joint, model, at, whitening, whitening(at.d, at.e))
    by_parameters, by_states = numeric_jacobians(joint, model, tracks)
    whole = linear.by_parameters - np.einsum("rspt,snpt->rnpt", by_states, linear.coupling)
    np.testing.assert_allclose(whole, by_parameters, atol=1e-7)
    information = np.einsum("rspt,rupt->ptsu", by_states, by_states)
    np.testing.assert_allclose(linear.state_information, information, rtol=1e-6, atol=1e-7)
    across = np.einsum("rspt,rnpt->snpt", by_states, linear.by_parameters)
    np.testing.assert_allclose(across, 0.0, atol=1e-7)


@WITH_AXIS
def test_axis_errors_are_as_large_as_their_deviations_say(name: str) -> None:
    rng = np.random.default_rng(8)
    truth, _, T = simulated_pairs(rng, name, pairs=60)
    fit = fit_joint(JOINT_TYPES[name], tracks_of(noisy(rng, T)), by_pose=True)
    ratio = np.mean((axis_error(fit, truth) / axis_std(fit)) ** 2)
    assert 0.7 < ratio < 1.35  # chi squared of 120 degrees of freedom over 120, beyond 99 %


@pytest.mark.parametrize(
    ("name", "travel", "arm", "bound_deg"),
    # Cramer-Rao bounds of notes for 3 mm and 0.02 rad at 200 frames, here times 1.25 for a median of 40
    [("prismatic", 0.3, 0.3, 0.21), ("revolute", np.pi / 2, 0.3, 0.19), ("revolute", np.pi / 6, 0.3, 0.56),
     ("revolute", np.pi / 2, 0.0, 0.28), ("revolute", 5 * np.pi / 3, 0.3, 0.08)],
)  # fmt: skip
def test_axes_are_as_good_as_the_bound(name: str, travel: float, arm: float, bound_deg: float) -> None:
    rng = np.random.default_rng(9)
    truth, _, T = simulated_pairs(rng, name, pairs=40, travel=travel, arm=arm)
    fit = fit_joint(JOINT_TYPES[name], tracks_of(noisy(rng, T)), by_pose=True)
    assert np.degrees(np.median(axis_error(fit, truth))) < bound_deg


@pytest.mark.parametrize("name", JOINT_TYPES)
def test_noise_is_estimated_without_the_states_share(name: str) -> None:
    rng = np.random.default_rng(10)
    _, _, T = simulated_pairs(rng, name)
    fit = fit_joint(JOINT_TYPES[name], tracks_of(noisy(rng, T)), by_pose=True)
    # of 20 pairs, 0.1-0.3 % where six numbers a frame tell it; of the ball's three, arm and turn mix two
    np.testing.assert_allclose(np.sqrt(fit.model.scales).mean(axis=0), [SIGMA_M, SIGMA_RAD], rtol=0.03)


def test_a_noisy_parent_s_lever_is_no_position_noise() -> None:
    rng = np.random.default_rng(11)
    _, _, T = simulated_pairs(rng, "revolute", arm=1.0)
    measured = se3.inverse(noisy(rng, np.broadcast_to(np.eye(4), T.shape))) @ noisy(rng, T)
    seen, one = np.ones(T.shape[:2], dtype=bool), np.ones(len(T), dtype=bool)
    tracks = PairTracks(measured, seen, seen, unknown_noise(measured, one, one), np.ones(len(measured)))
    fit = fit_joint(JOINT_TYPES["revolute"], tracks, by_pose=True)
    # 0.02 rad at a metre is 20 mm across the lever; what is left to position is less than a fifth too large.
    np.testing.assert_allclose(np.sqrt(fit.model.scales).mean(axis=0), [SIGMA_M, SIGMA_RAD], rtol=0.2)


@MOVABLE
@pytest.mark.parametrize("share", [0.1, 0.25])
def test_gross_outliers_are_found_and_do_no_harm(name: str, share: float) -> None:
    rng = np.random.default_rng(12)
    truth, _, T = simulated_pairs(rng, name)
    measured = noisy(rng, T)
    wrong = rng.uniform(size=T.shape[:2]) < share
    measured[wrong] = measured[wrong] @ se3.exp(rng.normal(size=(wrong.sum(), 6)) * np.repeat([0.2, 0.7], 3))
    fit = fit_joint(JOINT_TYPES[name], tracks_of(measured), by_pose=True)
    assert np.mean((fit.inlier < 0.5) == wrong) > 0.98
    if fit.joint.has_axis:
        assert np.degrees(np.median(axis_error(fit, truth))) < 0.5
    else:
        assert np.median(centre_error(fit, truth)) < 0.003  # m


@WITH_AXIS
def test_positions_alone_tell_the_axis(name: str) -> None:
    rng = np.random.default_rng(13)
    truth, _, T = simulated_pairs(rng, name)
    positions = se3.translation(noisy(rng, T)[..., :3, 3])
    fit = fit_joint(JOINT_TYPES[name], tracks_of(positions, oriented=False), by_pose=False)
    # 3 mm over 200 points that leave their chord by 37 mm: 0.019 rad out of the plane of the arc
    assert np.degrees(np.median(axis_error(fit, truth))) < 2.0


def test_frames_that_were_not_seen_change_nothing() -> None:
    rng, joint = np.random.default_rng(14), JOINT_TYPES["revolute"]
    _, _, T = simulated_pairs(rng, "revolute", pairs=4)
    measured = noisy(rng, T)
    seen = np.broadcast_to(np.arange(200) % 3 > 0, T.shape[:2])
    one = np.ones(4, dtype=bool)
    hidden = np.where(seen[..., None, None], measured, np.eye(4))
    some = fit_joint(
        joint, PairTracks(hidden, seen, seen, unknown_noise(hidden, ~one, one), np.ones(len(hidden))), by_pose=True
    )
    kept = measured[:, np.arange(200) % 3 > 0]
    all_seen = fit_joint(joint, tracks_of(kept), by_pose=True)
    between = angle_between(some.model.frames.T_parent_axis[:, :3, 2], all_seen.model.frames.T_parent_axis[:, :3, 2])
    assert np.degrees(between.max()) < 1e-3


def test_given_covariances_weigh_the_directions() -> None:
    """One direction ten times worse than the rest: the axis must gain from knowing it."""
    rng, joint = np.random.default_rng(15), JOINT_TYPES["revolute"]
    truth, _, T = simulated_pairs(rng, "revolute", pairs=30)
    std = np.array([1e-3, 1e-3, 1e-2, 0.005, 0.005, 0.05])
    measured = T @ se3.exp(rng.normal(size=(*T.shape[:2], 6)) * std)
    covariance = np.broadcast_to(np.diag(std**2), (*T.shape[:2], 6, 6))
    noise = given_noise(measured, np.zeros_like(covariance), covariance, 1.0)
    seen = np.ones(T.shape[:2], dtype=bool)
    given = fit_joint(joint, PairTracks(measured, seen, seen, noise, np.ones(len(measured))), by_pose=True)
    unknown = fit_joint(joint, tracks_of(measured), by_pose=True)
    assert np.median(axis_error(given, truth)) < 0.5 * np.median(axis_error(unknown, truth))
    assert np.all(given.model.scales < 1.1)


def test_inverse_cholesky_whitens() -> None:
    rng = np.random.default_rng(16)
    A = rng.normal(size=(5, 7, 6, 6))
    S = A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(6)
    W = inverse_cholesky(S)
    np.testing.assert_allclose(W @ S @ np.swapaxes(W, -1, -2), np.broadcast_to(np.eye(6), S.shape), atol=1e-9)


@pytest.mark.parametrize("travel", [0.2, 0.33])
def test_a_type_fits_no_worse_than_what_it_includes(travel: float) -> None:
    """Short turns of a screw at 0.3 m look most like a slide at first; the hinge is a better start."""
    rng = np.random.default_rng(16)
    _, _, T = simulated_pairs(rng, "screw", pairs=20, travel=travel)
    tracks = tracks_of(T @ se3.exp(rng.normal(size=(*T.shape[:2], 6)) * np.repeat([0.0015, 0.025], 3)))
    for name, joint in JOINT_TYPES.items():
        for simpler in joint.includes:
            for types in ((simpler, name), (name, simpler)):
                fits = fit_types(tracks, types)
                cost = [-2 * np.sum(fit.log_density - 0.5 * fit.chi2, axis=-1) for fit in (fits[simpler], fits[name])]
                assert np.all(cost[1] < cost[0] + 1.0)  # -2 log likelihood
