"""Screws: their hand, their turns, and starts from poses and from positions alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointGeometry
from station.kinematics.joints.screw import COHERENT

SCREW = JOINT_TYPES["screw"]


def screws(
    rng: np.random.Generator, q: np.ndarray, *, pitch: float, arm: float = 0.1
) -> tuple[JointFrames, np.ndarray]:
    """Random screws, one for each row of the states (P, T), and their poses."""
    count = len(q)
    of_child = se3.pose(Rotation.random(count, random_state=rng).as_matrix(), np.array([arm, 0, 0]))
    frames = JointFrames(se3.exp(rng.normal(size=(count, 6))), of_child, np.full((count, 1), pitch))
    M = SCREW.axis_motion(q[..., None], frames.form[:, None])
    return frames, frames.T_parent_axis[:, None] @ M @ frames.T_axis_child[:, None]


def noisy(rng: np.random.Generator, T: np.ndarray, noise_m: float, noise_rad: float) -> np.ndarray:
    return T @ se3.exp(rng.normal(size=(*T.shape[:2], 6)) * np.repeat([noise_m, noise_rad], 3))


def states_of(frames: JointFrames, T: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """(P, T) states over time of poses (P, T, 4, 4)."""
    M = se3.inverse(frames.T_parent_axis)[:, None] @ T
    q = SCREW.axis_state(M, frames.T_axis_child[:, None], frames.form[:, None])
    weights = np.ones(q.shape[:2]) if weights is None else weights
    return SCREW.over_time(q, M[..., :3, 3], frames.T_axis_child[..., :3, 3], frames.form, weights)[..., 0]


def axis_error_deg(frames: JointFrames, start: JointFrames) -> np.ndarray:
    a, b = frames.T_parent_axis[..., :3, 2], start.T_parent_axis[..., :3, 2]
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.abs(np.sum(a * b, axis=-1))))


def test_a_right_handed_screw_advances_along_the_thumb() -> None:
    geometry = JointGeometry(np.array([0.0, 0, 1]), np.zeros(3), se3.translation([1.0, 0, 0]), 0.02)
    T = SCREW.forward(geometry, np.array(np.pi / 2))
    np.testing.assert_allclose(T[:3, 3], [0, 1, 0.01 * np.pi], atol=1e-15)


@pytest.mark.parametrize("pitch", [-0.5, -1e-3, 1e-6, 0.02, 3.0])
def test_the_advance_tells_full_turns(pitch: float) -> None:
    rng = np.random.default_rng(0)
    frames, _ = screws(rng, np.zeros((1, 1)), pitch=pitch)
    geometry = SCREW.geometry(frames.take(0))
    q = np.linspace(-40, 40, 101)
    np.testing.assert_allclose(SCREW.inverse(geometry, SCREW.forward(geometry, q)), q, atol=1e-8)


@pytest.mark.parametrize("pitch", [0.0, 1e-12])
def test_without_an_advance_a_screw_is_a_hinge(pitch: float) -> None:
    frames, _ = screws(np.random.default_rng(1), np.zeros((1, 1)), pitch=pitch)
    geometry = SCREW.geometry(frames.take(0))
    hinge = JointGeometry(geometry.axis_parent, geometry.point_parent_m, geometry.T_parent_child_zero)
    q = np.array([-3.0, -0.1, 0.0, 2.0, 3.1])
    T = SCREW.forward(geometry, q)
    np.testing.assert_allclose(T, JOINT_TYPES["revolute"].forward(hinge, q), atol=1e-10)
    np.testing.assert_allclose(SCREW.inverse(geometry, T), q, atol=1e-10)


def test_positions_tell_the_same_states_and_with_no_arm_the_advance_does() -> None:
    rng, q = np.random.default_rng(2), np.linspace(-8, 8, 50)[None]
    for arm in (0.1, 1e-9, 0.0):
        frames, T = screws(rng, q, pitch=0.02, arm=arm)
        M = se3.inverse(frames.T_parent_axis)[:, None] @ T
        p, zero = M[..., :3, 3], frames.T_axis_child[:, None, :3, 3]
        found = SCREW.axis_state_of_position(p, zero, frames.form[:, None])[..., 0]
        np.testing.assert_allclose(found, q, atol=1e-6)


@pytest.mark.parametrize("in_order", [True, False])
@pytest.mark.parametrize("noise_m", [0.5, 5.0])  # times the pitch: turns by the advance, and by the order of frames
def test_turns_are_told_by_the_advance_or_else_by_the_order_of_frames(noise_m: float, *, in_order: bool) -> None:
    rng, pitch = np.random.default_rng(3), 0.001
    q = np.sort(rng.uniform(-15, 15, (5, 300)))
    q = q if in_order else rng.permuted(q, axis=1)
    frames, T = screws(rng, q, pitch=pitch)
    found = states_of(frames, noisy(rng, T, noise_m * pitch, 0.01))
    turns = np.rint((found - q) / (2 * np.pi))
    same = np.mean(turns == turns[:, :1], axis=1)  # all by the same number of turns off: the same joint
    coherent = np.exp(-0.5 * noise_m**2) > COHERENT
    assert np.all(same > 0.99) if coherent or in_order else np.all(same < 0.5)


def test_frames_that_are_not_trusted_disturb_no_turns() -> None:
    rng, pitch = np.random.default_rng(4), 0.001
    q = np.linspace(-15, 15, 300)[None]
    frames, T = screws(rng, q, pitch=pitch)
    measured = noisy(rng, T, 5 * pitch, 0.01)
    wrong = rng.uniform(size=q.shape) < 0.3
    measured[wrong] = se3.exp(rng.normal(size=(wrong.sum(), 6)))
    found = states_of(frames, measured, np.where(wrong, 1e-3, 1.0))
    turns = np.rint((found - q) / (2 * np.pi))[~wrong]
    assert np.all(turns == turns[0])


@pytest.mark.parametrize(
    ("travel", "pitch", "arm"),
    [(1.0, 0.05, 0.3), (0.3, 1.0, 0.1), (6 * np.pi, 0.002, 0.05), (6 * np.pi, -0.03, 0.0), (1.0, 0.0, 0.3)],
)
@pytest.mark.parametrize("in_order", [True, False])
def test_a_start_of_noisy_poses_is_near_the_screw(travel: float, pitch: float, arm: float, *, in_order: bool) -> None:
    rng = np.random.default_rng(5)
    q = np.sort(rng.uniform(-0.5, 0.5, (20, 200)) * travel)
    q = q if in_order else rng.permuted(q, axis=1)
    frames, T = screws(rng, q, pitch=pitch, arm=arm)
    starts = SCREW.starts(noisy(rng, T, 0.0005, 0.01), np.ones(q.shape))
    off = np.min([axis_error_deg(frames, start) for start in starts], axis=0)
    assert np.median(off) < 3.0  # deg: 0.01 rad of 0.3 rad is 2
    advance = np.min(
        [np.abs(start.form[:, 0] / pitch - 1) if pitch else np.abs(start.form[:, 0]) for start in starts], 0
    )
    assert np.median(advance) < 0.03


def test_outliers_in_the_first_round_leave_the_turns_of_a_start_alone() -> None:
    rng = np.random.default_rng(6)
    q = np.sort(rng.uniform(-10, 10, (10, 200)))
    frames, T = screws(rng, q, pitch=0.02)
    measured = noisy(rng, T, 0.001, 0.01)
    wrong = rng.uniform(size=q.shape) < 0.2
    measured[wrong] = measured[wrong] @ se3.exp(0.3 * rng.normal(size=(wrong.sum(), 6)))
    start = SCREW.starts(measured, np.ones(q.shape))[0]
    assert np.median(np.abs(start.form[:, 0] / 0.02 - 1)) < 0.15
    assert np.median(axis_error_deg(frames, start)) < 5.0


@pytest.mark.parametrize(
    ("travel", "pitch", "arm"), [(6 * np.pi, 0.002, 0.1), (3.0, 0.1, 0.2), (2 * np.pi, 0.01, 0.05), (1.5, 0.3, 0.1)]
)
def test_a_start_of_positions_finds_the_axis_of_the_helix(travel: float, pitch: float, arm: float) -> None:
    rng = np.random.default_rng(7)
    q = np.sort(rng.uniform(-0.5, 0.5, (8, 200)) * travel)
    frames, T = screws(rng, q, pitch=pitch, arm=arm)
    starts = SCREW.position_starts(T[..., :3, 3], np.ones(q.shape))
    off = np.min([axis_error_deg(frames, start) for start in starts], axis=0)
    assert off.max() < 2.0  # deg: the search ends with steps of 0.1 deg in a flat valley
    assert np.min([np.abs(start.form[:, 0] / pitch - 1) for start in starts], axis=0).max() < 0.1


def test_a_start_of_positions_turns_with_the_parent_s_frame() -> None:
    rng = np.random.default_rng(8)
    q = np.sort(rng.uniform(-2, 2, (4, 60)))
    _, T = screws(rng, q, pitch=0.03)
    p = noisy(rng, T, 0.002, 0.0)[..., :3, 3]
    T_other_parent = se3.exp(rng.normal(size=6))
    moved = p @ T_other_parent[:3, :3].T + T_other_parent[:3, 3]
    for here, there in zip(*(SCREW.position_starts(x, np.ones(q.shape)) for x in (p, moved)), strict=True):
        told = JointFrames(T_other_parent @ here.T_parent_axis, here.T_axis_child, here.form)
        assert axis_error_deg(told, there).max() < 1e-4
        np.testing.assert_allclose(here.form, there.form, atol=1e-8)
