"""Joint types: every type in the registry moves as it says, inverts its motion and starts a fit near the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointGeometry, JointType
from station.kinematics.joints.revolute import FAR_HINGE_M, STRAIGHT_TURN_RAD

TYPES = pytest.mark.parametrize("joint", JOINT_TYPES.values(), ids=JOINT_TYPES)
MOVABLE = pytest.mark.parametrize("joint", [j for j in JOINT_TYPES.values() if j.states], ids=lambda j: j.name)


def random_frames(rng: np.random.Generator, *batch: int) -> JointFrames:
    return JointFrames(se3.exp(0.7 * rng.normal(size=(*batch, 6))), se3.exp(0.7 * rng.normal(size=(*batch, 6))))


def forward(joint: JointType, frames: JointFrames, q: np.ndarray) -> np.ndarray:
    return frames.T_parent_axis[..., None, :, :] @ joint.axis_motion(q) @ frames.T_axis_child[..., None, :, :]


@TYPES
def test_the_motion_is_the_exponential_of_its_screw(joint: JointType) -> None:
    for q in (-2.0, -1e-9, 0.0, 0.4, 3.0):
        twist = np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = se3.hat3(joint.screw[3:]), joint.screw[:3]
        np.testing.assert_allclose(joint.axis_motion(np.array(q)), expm(q * twist), atol=1e-14)


@TYPES
def test_free_directions_are_as_many_as_parameters_and_move_the_pose_independently_of_the_state(
    joint: JointType,
) -> None:
    rng = np.random.default_rng(1)
    frames, q = random_frames(rng), rng.uniform(-1, 1, 8) * (joint.states > 0)
    T = forward(joint, frames, q)
    columns, step = [], 1e-6
    for axis in joint.axis_freedoms:
        moved = JointFrames(frames.T_parent_axis @ se3.exp(step * np.eye(6)[axis]), frames.T_axis_child)
        columns.append(se3.log(se3.inverse(T) @ forward(joint, moved, q)).ravel() / step)
    for axis in joint.child_freedoms:
        moved = JointFrames(frames.T_parent_axis, se3.exp(step * np.eye(6)[axis]) @ frames.T_axis_child)
        columns.append(se3.log(se3.inverse(T) @ forward(joint, moved, q)).ravel() / step)
    for t in range(len(q) * (joint.states > 0)):
        moved_q = q + step * np.eye(len(q))[t]
        columns.append(se3.log(se3.inverse(T) @ forward(joint, frames, moved_q)).ravel() / step)
    assert len(joint.axis_freedoms) + len(joint.child_freedoms) == joint.parameters
    # A direction that the states could take over would lower the rank by one.
    assert np.linalg.matrix_rank(np.stack(columns), tol=1e-3) == len(columns)


@TYPES
def test_inverse_undoes_forward(joint: JointType) -> None:
    rng = np.random.default_rng(2)
    geometry = joint.geometry(random_frames(rng))
    q = rng.uniform(-3, 3, 50) * (joint.states > 0)
    np.testing.assert_allclose(joint.inverse(geometry, joint.forward(geometry, q)), q, atol=1e-13)


@TYPES
def test_geometry_and_frames_tell_the_same_motion(joint: JointType) -> None:
    rng = np.random.default_rng(3)
    frames, q = random_frames(rng), rng.uniform(-1, 1, 9)
    np.testing.assert_allclose(joint.forward(joint.geometry(frames), q), forward(joint, frames, q), atol=1e-13)


@TYPES
def test_motion_leaves_the_zero_pose_where_it_is_and_nan_gives_nan(joint: JointType) -> None:
    geometry = joint.geometry(random_frames(np.random.default_rng(4)))
    np.testing.assert_allclose(joint.forward(geometry, np.array(0.0)), geometry.T_parent_child_zero, atol=1e-14)
    if joint.states:
        assert np.all(np.isnan(joint.axis_motion(np.array([np.nan]))))


def test_a_revolute_joint_turns_points_about_its_axis_by_the_right_hand() -> None:
    geometry = JointGeometry(np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), se3.translation([2.0, 0, 0]))
    T = JOINT_TYPES["revolute"].forward(geometry, np.array(np.pi / 2))
    np.testing.assert_allclose(T[:3, 3], [1, 1, 0], atol=1e-15)


def test_a_prismatic_joint_goes_along_its_axis_and_does_not_turn() -> None:
    zero = se3.exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    geometry = JointGeometry(np.array([0.0, 1, 0]), None, zero)
    T = JOINT_TYPES["prismatic"].forward(geometry, np.array(0.25))
    np.testing.assert_allclose(T, se3.translation([0, 0.25, 0]) @ zero, atol=1e-15)


@MOVABLE
@pytest.mark.parametrize("by_pose", [True, False])
def test_a_start_of_exact_data_is_the_joint_itself(joint: JointType, by_pose: bool) -> None:
    rng = np.random.default_rng(5)
    frames, q = random_frames(rng, 6), rng.uniform(-0.6, 0.6, (6, 40))
    T, weights = forward(joint, frames, q), np.ones((6, 40))
    starts = joint.starts(T, weights) if by_pose else joint.position_starts(T[..., :3, 3], weights)
    for start in starts:
        M = se3.inverse(start.T_parent_axis)[:, None] @ T
        zero = start.T_axis_child[:, None]
        found = joint.axis_state(M, zero) if by_pose else joint.axis_state_of_position(M[..., :3, 3], zero[..., :3, 3])
        error = forward(joint, start, found)[..., :3, 3] - T[..., :3, 3]
        assert np.abs(error).max() < 1e-5  # m: the regularised circle fit's own rounding


def test_a_revolute_start_needs_no_radius() -> None:
    revolute, rng = JOINT_TYPES["revolute"], np.random.default_rng(6)
    frames = JointFrames(se3.exp(rng.normal(size=6)), se3.pose(se3.exp_so3(rng.normal(size=3)), np.zeros(3)))
    T = forward(revolute, frames, rng.uniform(-0.5, 0.5, 30))
    start = revolute.starts(T, np.ones(30))[0]
    axis, found = frames.T_parent_axis[:3, 2], start.T_parent_axis[:3, 2]
    assert np.linalg.norm(np.cross(axis, found)) < 1e-9
    between = start.T_parent_axis[:3, 3] - frames.T_parent_axis[:3, 3]
    assert np.linalg.norm(np.cross(between, axis)) < 1e-9  # m


def test_a_far_hinge_that_hardly_turned_is_as_good_as_a_slide() -> None:
    revolute = JOINT_TYPES["revolute"]
    far, near = (JointFrames(np.eye(4), se3.translation([r * FAR_HINGE_M, 0, 0])) for r in (1.1, 0.9))
    little, much = np.array(0.9 * STRAIGHT_TURN_RAD), np.array(1.1 * STRAIGHT_TURN_RAD)
    assert revolute.is_degenerate(far, little)
    assert not revolute.is_degenerate(near, little)
    assert not revolute.is_degenerate(far, much)


def test_an_axis_that_is_no_unit_vector_is_refused() -> None:
    with pytest.raises(InvalidData, match="unit vector"):
        JointGeometry(np.array([0.0, 0, 2]), None, np.eye(4))


def test_a_movable_joint_without_an_axis_is_refused() -> None:
    with pytest.raises(InvalidData, match="needs an axis"):
        JOINT_TYPES["prismatic"].frames(JointGeometry(None, None, np.eye(4)))
