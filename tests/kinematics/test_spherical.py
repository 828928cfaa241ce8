"""Balls: rotation vectors beyond half a turn, states by poses and by positions, starts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames
from station.kinematics.joints.base import BALANCE_M

BALL = JOINT_TYPES["spherical"]
NO_FORM = np.zeros(0)


def balls(rng: np.random.Generator, q: np.ndarray, *, arm: float = 0.2) -> tuple[JointFrames, np.ndarray]:
    """Random balls, one for each row of the states (P, T, 3), and their poses."""
    count = len(q)
    of_child = se3.pose(Rotation.random(count, random_state=rng).as_matrix(), arm * unit(rng.normal(size=(count, 3))))
    frames = JointFrames.plain(se3.translation(rng.normal(size=(count, 3))), of_child)
    M = BALL.axis_motion(q, np.zeros((count, 1, 0)))
    return frames, frames.T_parent_axis[:, None] @ M @ frames.T_axis_child[:, None]


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def winding(rng: np.random.Generator, count: int, size_rad: float) -> np.ndarray:
    """(count, 200, 3) smooth rotation vectors up to this size along each direction, about their middle."""
    t = np.linspace(0, 2 * np.pi, 200)[:, None]
    return size_rad * np.sin(t * np.array([1.0, 2.0, 3.0]) + rng.uniform(0, 2 * np.pi, (count, 1, 3)))


def same_rotation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...,) radians between the rotations of two vectors."""
    return (Rotation.from_rotvec(a.reshape(-1, 3)).inv() * Rotation.from_rotvec(b.reshape(-1, 3))).magnitude()


def test_a_spin_is_followed_over_several_turns() -> None:
    angle = np.linspace(0, 20, 200)
    axis = unit(np.array([1.0, -2.0, 0.5]))
    wrapped = Rotation.from_rotvec(angle[:, None] * axis).as_rotvec()
    np.testing.assert_allclose(BALL.continuous(wrapped), angle[:, None] * axis, atol=1e-9)
    np.testing.assert_allclose(BALL.continuous(-wrapped), -angle[:, None] * axis, atol=1e-9)


@pytest.mark.parametrize("size_rad", [0.5, 1.5, 2.6])
def test_vectors_go_on_smoothly_through_half_a_turn(size_rad: float) -> None:
    path = winding(np.random.default_rng(0), 8, size_rad)
    path = path - path[:, :1]  # from zero, where the vector is known; on to 2 size sqrt(3) at most
    path = path * np.minimum(1.0, 5.5 / np.linalg.norm(path, axis=-1).max(axis=1))[:, None, None]  # short of two turns
    wrapped = Rotation.from_rotvec(path.reshape(-1, 3)).as_rotvec().reshape(path.shape)
    np.testing.assert_allclose(BALL.continuous(wrapped), path, atol=1e-9)


def test_a_rest_stays_and_vectors_beyond_half_a_turn_may_be_given() -> None:
    np.testing.assert_array_equal(BALL.continuous(np.zeros((4, 3))), np.zeros((4, 3)))
    q = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 4.0], [0.0, 0.0, 6.0]])
    np.testing.assert_allclose(BALL.continuous(q), q, atol=1e-12)


def test_wrong_frames_lead_no_motion_through_half_a_turn() -> None:
    rng, t = np.random.default_rng(9), np.linspace(0, 6, 60)
    q = np.tile(0.5 * np.stack([np.sin(t), np.cos(t), np.sin(2 * t)], axis=-1), (50, 1, 1))
    right = (np.arange(60) < 20) | (np.arange(60) > 22)
    q[:, ~right] = Rotation.random(150, random_state=rng).as_rotvec().reshape(50, 3, 3)
    np.testing.assert_allclose(BALL.continuous(q)[:, right], q[:, right], atol=1e-12)


@pytest.mark.parametrize("size_rad", [0.0, 1e-12, 1.0, 3.1, 3.2, 7.0])
def test_the_nearest_turn_is_the_nearest_of_all_vectors_of_the_rotation(size_rad: float) -> None:
    rng = np.random.default_rng(1)
    near, q = 5 * rng.normal(size=(50, 3)), size_rad * unit(rng.normal(size=(50, 3)))
    found = BALL.nearest_turn(q, near)
    assert same_rotation(found, q).max() < 1e-9
    directions = unit(q) if size_rad else unit(near)
    turns = size_rad + 2 * np.pi * np.arange(-6, 7)
    distance = np.linalg.norm(directions[:, None] * turns[:, None] - near[:, None], axis=-1).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(found - near, axis=-1), distance, atol=1e-9)


def test_a_state_moves_by_a_rotation_after_it_also_through_half_a_turn() -> None:
    rng = np.random.default_rng(2)
    q, dq = 3.1 * unit(rng.normal(size=(40, 3))), 0.3 * rng.normal(size=(40, 3))
    moved = BALL.moved(q, dq)
    expected = (Rotation.from_rotvec(q) * Rotation.from_rotvec(dq)).as_matrix()
    np.testing.assert_allclose(Rotation.from_rotvec(moved).as_matrix(), expected, atol=1e-12)
    assert np.linalg.norm(moved - q, axis=-1).max() < 2.5  # no jump to the other side, which is 2 pi away


def test_the_state_of_a_pose_weighs_orientation_and_position() -> None:
    """The best rotation of weighted vectors: the child's axes, and where its origin is."""
    rng = np.random.default_rng(3)
    zero = se3.exp(rng.normal(size=6))
    T = se3.exp(rng.normal(size=6))
    after = np.concatenate([BALANCE_M * T[:3, :3].T, T[None, :3, 3]])
    before = np.concatenate([BALANCE_M * zero[:3, :3].T, zero[None, :3, 3]])
    expected, _ = Rotation.align_vectors(after, before)
    np.testing.assert_allclose(BALL.axis_state(T, zero, NO_FORM), expected.as_rotvec(), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-10, 0.5, 3.0, np.pi - 1e-6, np.pi - 1e-8, np.pi - 1e-9, np.pi])
def test_a_position_tells_the_smallest_rotation_that_brings_it_there(angle: float) -> None:
    rng = np.random.default_rng(4)
    zero = rng.normal(size=(20, 3))
    aside = unit(np.cross(zero, rng.normal(size=(20, 3))))
    p = 0.7 * Rotation.from_rotvec(angle * aside).apply(zero)
    q = BALL.axis_state_of_position(p, zero, NO_FORM)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), angle, atol=1e-7)
    np.testing.assert_allclose(0.7 * Rotation.from_rotvec(q).apply(zero), p, atol=1e-7)


def test_a_position_in_the_centre_tells_nothing() -> None:
    for p, zero in ((np.zeros(3), np.ones(3)), (np.ones(3), np.zeros(3)), (np.zeros(3), np.zeros(3))):
        np.testing.assert_array_equal(BALL.axis_state_of_position(p, zero, NO_FORM), np.zeros(3))


@pytest.mark.parametrize("arm", [0.0, 0.02, 0.3])
def test_a_start_of_noisy_poses_is_near_the_centre(arm: float) -> None:
    rng = np.random.default_rng(5)
    frames, T = balls(rng, winding(rng, 20, 0.5), arm=arm)
    measured = T @ se3.exp(rng.normal(size=(20, 200, 6)) * np.repeat([0.001, 0.01], 3))
    off = [
        np.linalg.norm(start.T_parent_axis[:, :3, 3] - frames.T_parent_axis[:, :3, 3], axis=-1)
        for start in BALL.starts(measured, np.ones((20, 200)))
    ]
    assert np.median(np.min(off, axis=0)) < 0.001  # m: ten times what 200 frames allow
    assert np.median(off[0]) < 0.003


def test_a_start_of_noisy_positions_is_near_the_centre() -> None:
    rng = np.random.default_rng(6)
    frames, T = balls(rng, winding(rng, 20, 0.5), arm=0.3)
    p = T[..., :3, 3] + 0.001 * rng.normal(size=(20, 200, 3))
    (start,) = BALL.position_starts(p, np.ones((20, 200)))
    off = np.linalg.norm(start.T_parent_axis[:, :3, 3] - frames.T_parent_axis[:, :3, 3], axis=-1)
    assert np.median(off) < 0.005  # m


def test_the_states_of_a_start_are_small_about_the_middle_of_the_motion() -> None:
    rng = np.random.default_rng(7)
    _, T = balls(rng, winding(rng, 5, 0.5) + np.array([2.0, 1.0, -1.0]))
    for start in BALL.starts(T, np.ones((5, 200))):
        M = se3.inverse(start.T_parent_axis)[:, None] @ T
        assert np.linalg.norm(BALL.axis_state(M, start.T_axis_child[:, None], NO_FORM), axis=-1).max() < 2.0


def test_the_extent_of_a_state_is_its_angle() -> None:
    assert BALL.extent(np.array([[0.0, 3.0, -4.0]])) == pytest.approx(5.0)
    assert JOINT_TYPES["revolute"].extent(np.array([[-4.0]])) == pytest.approx(-4.0)
