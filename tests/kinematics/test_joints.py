"""Joint types: every type in the registry moves as it says, inverts its motion and starts a fit near the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointGeometry, JointType

TYPES = pytest.mark.parametrize("joint", JOINT_TYPES.values(), ids=JOINT_TYPES)
MOVABLE = pytest.mark.parametrize("joint", [j for j in JOINT_TYPES.values() if j.states], ids=lambda j: j.name)


def random_frames(joint: JointType, rng: np.random.Generator, *batch: int) -> JointFrames:
    poses = (se3.exp(0.7 * rng.normal(size=(*batch, 6))) for _ in range(2))
    return JointFrames(*poses, 0.1 * rng.normal(size=(*batch, joint.form_freedoms)))


def forward(joint: JointType, frames: JointFrames, q: np.ndarray) -> np.ndarray:
    M = joint.axis_motion(q, frames.form[..., None, :])
    return frames.T_parent_axis[..., None, :, :] @ M @ frames.T_axis_child[..., None, :, :]


@TYPES
def test_the_state_s_twists_are_what_a_change_of_state_does(joint: JointType) -> None:
    rng, step = np.random.default_rng(0), 1e-6
    q, form = rng.uniform(-2, 2, (7, joint.states)), 0.1 * rng.normal(size=joint.form_freedoms)
    M = joint.axis_motion(q, form)
    for i, twist in enumerate(joint.state_twists(form).T):
        moved = joint.axis_motion(joint.moved(q, step * np.eye(joint.states)[i]), form)
        np.testing.assert_allclose(se3.log(se3.inverse(M) @ moved) / step, np.tile(twist, (7, 1)), atol=1e-8)
    for i, twists in enumerate(np.moveaxis(joint.form_twists(q, form), -1, 0)):
        moved = joint.axis_motion(q, form + step * np.eye(joint.form_freedoms)[i])
        np.testing.assert_allclose(se3.log(se3.inverse(M) @ moved) / step, twists, atol=1e-8)


@TYPES
def test_moved_axes_are_those_of_the_motion(joint: JointType) -> None:
    rng = np.random.default_rng(3)
    q, form = rng.uniform(-2, 2, (4, 5, joint.states)), 0.1 * rng.normal(size=(4, joint.form_freedoms))
    F = se3.exp(rng.normal(size=(4, 1, 6)))
    F[..., :3, 3] = 0.0
    moved = F @ joint.axis_motion(q, form[:, None])
    R, shift = joint.moved_axes(np.moveaxis(F[:, 0, :3, :3], 0, -1), q, form)
    np.testing.assert_allclose(np.moveaxis(R, (0, 1), (-2, -1)), moved[..., :3, :3], atol=1e-14)
    np.testing.assert_allclose(np.moveaxis(shift, 0, -1), moved[..., :3, 3], atol=1e-14)


@TYPES
def test_a_motion_with_one_state_is_the_exponential_of_its_twist(joint: JointType) -> None:
    for q in (-2.0, -1e-9, 0.0, 0.4, 3.0):
        xi = joint.state_twists(np.full(joint.form_freedoms, 0.05)) @ np.full(joint.states, q)
        twist = np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = se3.hat3(xi[3:]), xi[:3]
        M = joint.axis_motion(np.full(joint.states, q), np.full(joint.form_freedoms, 0.05))
        np.testing.assert_allclose(M, expm(twist), atol=1e-14)


@TYPES
def test_free_directions_are_as_many_as_parameters_and_move_the_pose_independently_of_the_state(
    joint: JointType,
) -> None:
    rng = np.random.default_rng(1)
    frames, q = random_frames(joint, rng), rng.uniform(-1, 1, (8, joint.states))
    T = forward(joint, frames, q)
    columns, step = [], 1e-6

    def column(moved: JointFrames, moved_q: np.ndarray) -> None:
        columns.append(se3.log(se3.inverse(T) @ forward(joint, moved, moved_q)).ravel() / step)

    for axis in joint.axis_freedoms:
        column(replace(frames, T_parent_axis=frames.T_parent_axis @ se3.exp(step * np.eye(6)[axis])), q)
    for axis in joint.child_freedoms:
        column(replace(frames, T_axis_child=se3.exp(step * np.eye(6)[axis]) @ frames.T_axis_child), q)
    for i in range(joint.form_freedoms):
        column(replace(frames, form=frames.form + step * np.eye(joint.form_freedoms)[i]), q)
    for t, i in np.ndindex(q.shape):
        dq = np.zeros_like(q)
        dq[t, i] = step
        column(frames, joint.moved(q, dq))
    assert len(joint.axis_freedoms) + len(joint.child_freedoms) + joint.form_freedoms == joint.parameters
    # A direction that the states could take over would lower the rank by one.
    assert np.linalg.matrix_rank(np.stack(columns), tol=1e-3) == len(columns)


def states_of(joint: JointType, rng: np.random.Generator, size: float, count: int) -> np.ndarray:
    """States as `forward` takes them."""
    q = rng.uniform(-size, size, (count, max(joint.states, 1)))
    return q if joint.states > 1 else q[:, 0] * joint.states


@TYPES
def test_inverse_undoes_forward(joint: JointType) -> None:
    rng = np.random.default_rng(2)
    geometry = joint.geometry(random_frames(joint, rng))
    q = states_of(joint, rng, 3 / np.sqrt(max(joint.states, 1)), 50)
    np.testing.assert_allclose(joint.inverse(geometry, joint.forward(geometry, q)), q, atol=1e-13)


@TYPES
def test_geometry_and_frames_tell_the_same_motion(joint: JointType) -> None:
    rng = np.random.default_rng(3)
    frames = joint.frames(joint.geometry(random_frames(joint, rng)))
    q = rng.uniform(-1, 1, (9, joint.states))
    public = q if joint.states > 1 else q.sum(axis=-1)
    np.testing.assert_allclose(joint.forward(joint.geometry(frames), public), forward(joint, frames, q), atol=1e-13)


@TYPES
def test_motion_leaves_the_zero_pose_where_it_is_and_nan_gives_nan(joint: JointType) -> None:
    geometry = joint.geometry(random_frames(joint, np.random.default_rng(4)))
    zero = np.zeros(joint.states if joint.states > 1 else ())
    np.testing.assert_allclose(joint.forward(geometry, zero), geometry.T_parent_child_zero, atol=1e-14)
    if joint.states:
        unknown = joint.axis_motion(np.full((1, joint.states), np.nan), np.zeros(joint.form_freedoms))
        assert np.all(np.isnan(unknown))


def test_a_revolute_joint_turns_points_about_its_axis_by_the_right_hand() -> None:
    geometry = JointGeometry(np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), se3.translation([2.0, 0, 0]))
    T = JOINT_TYPES["revolute"].forward(geometry, np.array(np.pi / 2))
    np.testing.assert_allclose(T[:3, 3], [1, 1, 0], atol=1e-15)


def test_a_prismatic_joint_goes_along_its_axis_and_does_not_turn() -> None:
    zero = se3.exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    geometry = JointGeometry(np.array([0.0, 1, 0]), None, zero)
    T = JOINT_TYPES["prismatic"].forward(geometry, np.array(0.25))
    np.testing.assert_allclose(T, se3.translation([0, 0.25, 0]) @ zero, atol=1e-15)


def misses(joint: JointType, start: JointFrames, T: np.ndarray, *, by_pose: bool) -> float:
    """Largest distance [m] of positions from a start's, at its best states."""
    M = se3.inverse(start.T_parent_axis)[..., None, :, :] @ T
    zero, form = start.T_axis_child[..., None, :, :], start.form[..., None, :]
    by_position = joint.axis_state_of_position(M[..., :3, 3], zero[..., :3, 3], form)
    found = joint.axis_state(M, zero, form) if by_pose else by_position
    return float(np.abs(forward(joint, start, found)[..., :3, 3] - T[..., :3, 3]).max())


@MOVABLE
@pytest.mark.parametrize("by_pose", [True, False])
def test_a_start_of_exact_data_is_the_joint_itself(joint: JointType, by_pose: bool) -> None:
    rng = np.random.default_rng(5)
    frames, q = random_frames(joint, rng, 6), rng.uniform(-0.6, 0.6, (6, 40, joint.states))
    T, weights = forward(joint, frames, q), np.ones((6, 40))
    starts = joint.starts(T, weights) if by_pose else joint.position_starts(T[..., :3, 3], weights)
    found = [misses(joint, start, T, by_pose=by_pose) for start in starts]
    if joint.form_freedoms:  # some readings take a pitch that is not there; test_screw has those of positions
        assert not by_pose or min(found) < 1e-9
    else:
        bent_line = joint.name == "revolute" and by_pose  # the last one is for arcs that are nearly straight
        assert max(found[:-1] if bent_line else found) < 1e-5  # m: the regularised circle fit's own rounding


@TYPES
@pytest.mark.parametrize("by_pose", [True, False])
def test_starts_of_many_joints_are_those_of_each(joint: JointType, by_pose: bool) -> None:
    rng = np.random.default_rng(6)
    frames, q = random_frames(joint, rng, 2, 3), rng.uniform(-0.6, 0.6, (2, 3, 30, joint.states))
    T = forward(joint, frames, q) @ se3.exp(0.01 * rng.normal(size=(2, 3, 30, 6)))
    weights = rng.uniform(0.5, 1, (2, 3, 30))

    def starts(some: np.ndarray, its: np.ndarray) -> tuple[JointFrames, ...]:
        return joint.starts(some, its) if by_pose else joint.position_starts(some[..., :3, 3], its)

    for together, alone in zip(starts(T, weights), starts(T[1, 2], weights[1, 2]), strict=True):
        np.testing.assert_allclose(together.take((1, 2)).T_parent_axis, alone.T_parent_axis, atol=1e-9)
        np.testing.assert_allclose(together.take((1, 2)).T_axis_child, alone.T_axis_child, atol=1e-9)
        np.testing.assert_allclose(together.take((1, 2)).form, alone.form, atol=1e-9)


@TYPES
@pytest.mark.parametrize("noise", [0.0, 1e-12, 1e-3])
def test_starts_of_parts_that_do_not_move_are_poses(joint: JointType, noise: float) -> None:
    rng = np.random.default_rng(7)
    T = se3.exp(rng.normal(size=(4, 1, 6))) @ se3.exp(noise * rng.normal(size=(4, 25, 6)))
    weights = np.ones((4, 25))
    for start in (*joint.starts(T, weights), *joint.position_starts(T[..., :3, 3], weights)):
        for pose in (start.T_parent_axis, start.T_axis_child):
            R = pose[..., :3, :3]
            np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.tile(np.eye(3), (4, 1, 1)), atol=1e-12)
            assert np.all(np.isfinite(pose))
        assert np.all(np.isfinite(start.form))


def retold(joint: JointType, frames: JointFrames, q: np.ndarray, dq: np.ndarray, how: str) -> tuple:
    if how == "from_zero":
        return joint.from_zero(frames, q, dq, np.full(joint.states, 0.4))
    return getattr(joint, how)(frames, q, dq)


@TYPES
@pytest.mark.parametrize("how", ["reversed", "upright", "from_zero"])
def test_a_joint_told_otherwise_moves_the_same_and_so_do_changes_of_its_states(joint: JointType, how: str) -> None:
    rng, step = np.random.default_rng(8), 1e-6
    frames, q = random_frames(joint, rng), rng.uniform(-1, 1, (5, joint.states))
    dq = rng.normal(size=(5, joint.states, 2))
    again, its_q, its_dq = retold(joint, frames, q, dq, how)
    T, its_T = forward(joint, frames, q), forward(joint, again, its_q)
    np.testing.assert_allclose(its_T, se3.inverse(T) if how == "reversed" else T, atol=1e-13)
    _, moved, _ = retold(joint, frames, joint.moved(q, step * dq[..., 1]), dq, how)
    expected = forward(joint, again, joint.moved(its_q, step * its_dq[..., 1]))
    np.testing.assert_allclose(forward(joint, again, moved), expected, atol=1e-11)  # second order: step^2


@TYPES
def test_an_upright_joint_is_told_in_full_by_its_geometry(joint: JointType) -> None:
    rng = np.random.default_rng(9)
    q = rng.uniform(-1, 1, (5, joint.states))
    frames, q, _ = joint.upright(random_frames(joint, rng), q, np.zeros((5, joint.states, 0)))
    public = q if joint.states > 1 else q.sum(axis=-1)
    np.testing.assert_allclose(joint.forward(joint.geometry(frames), public), forward(joint, frames, q), atol=1e-13)


@TYPES
@pytest.mark.parametrize("size", [0.0, 1e-9, 0.3, 3.0, 5.0])
def test_changes_of_the_columns_are_those_of_finite_differences(joint: JointType, size: float) -> None:
    rng, step = np.random.default_rng(10), 1e-6
    q = size / np.sqrt(max(joint.states, 1)) * rng.choice([-1.0, 1.0], (6, joint.states))
    dq = rng.normal(size=(6, joint.states, 3))
    numeric = [(joint.moved(q, step * dq[..., i]) - joint.moved(q, -step * dq[..., i])) / (2 * step) for i in range(3)]
    np.testing.assert_allclose(joint.column_changes(q, dq), np.stack(numeric, axis=-1), atol=1e-8)
    # Information is the inverse of covariance, whichever numbers both are about.
    root = rng.normal(size=(6, joint.states, joint.states)) + 3 * np.eye(joint.states)
    root_of_columns = joint.column_changes(q, root)
    covariance = root_of_columns @ np.swapaxes(root_of_columns, -1, -2)
    information = joint.column_information(q, np.linalg.inv(root @ np.swapaxes(root, -1, -2)))
    np.testing.assert_allclose(information @ covariance, np.zeros_like(covariance) + np.eye(joint.states), atol=1e-9)


def test_a_revolute_start_needs_no_radius() -> None:
    revolute, rng = JOINT_TYPES["revolute"], np.random.default_rng(6)
    frames = JointFrames.plain(se3.exp(rng.normal(size=6)), se3.pose(se3.exp_so3(rng.normal(size=3)), np.zeros(3)))
    T = forward(revolute, frames, rng.uniform(-0.5, 0.5, (30, 1)))
    start = revolute.starts(T, np.ones(30))[0]
    axis, found = frames.T_parent_axis[:3, 2], start.T_parent_axis[:3, 2]
    assert np.linalg.norm(np.cross(axis, found)) < 1e-9
    between = start.T_parent_axis[:3, 3] - frames.T_parent_axis[:3, 3]
    assert np.linalg.norm(np.cross(between, axis)) < 1e-9  # m


def test_a_hinge_s_state_is_told_by_the_position_where_the_arm_is_long() -> None:
    """Noise of 3 mm and 1 deg at 2 m: the orientation alone would tell it to 1 deg, the position to 0.1 deg."""
    revolute, rng = JOINT_TYPES["revolute"], np.random.default_rng(13)
    zero = se3.pose(np.eye(3), [2.0, 0.0, 0.5])
    q = rng.uniform(-np.pi, np.pi, 500)
    noise = se3.exp(rng.normal(size=(500, 6)) * np.repeat([0.003, np.radians(1.0)], 3))
    found = revolute.axis_state(se3.rotation_z(q) @ zero @ noise, zero, np.zeros(0))[:, 0]
    assert np.degrees(np.std(np.angle(np.exp(1j * (found - q))))) < 0.12  # deg


@pytest.mark.parametrize("radius_m", [0.5, 2.0])
def test_a_hinge_whose_arc_is_as_good_as_straight_starts_from_the_bent_line(radius_m: float) -> None:
    """Exact but for the arc's sagitta, a thousandth of its length here: axis and centre to a few thousandths."""
    revolute, rng = JOINT_TYPES["revolute"], np.random.default_rng(14)
    T_parent_axis, T_axis_child = se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6))
    T_axis_child[:3, 3] = [radius_m, 0.0, 0.0]
    frames = JointFrames.plain(T_parent_axis, T_axis_child)
    start = revolute.starts(forward(revolute, frames, np.linspace(0, 0.016, 50)[:, None]), np.ones(50))[-1]
    assert np.linalg.norm(np.cross(start.T_parent_axis[:3, 2], T_parent_axis[:3, 2])) < 0.01
    off = start.T_parent_axis[:3, 3] - T_parent_axis[:3, 3]
    assert np.linalg.norm(np.cross(off, T_parent_axis[:3, 2])) < 0.01 * radius_m


def test_a_joint_that_needs_a_pitch_is_refused_without() -> None:
    with pytest.raises(InvalidData, match="screw joint needs a pitch"):
        JOINT_TYPES["screw"].frames(JointGeometry(np.array([0.0, 0, 1]), np.zeros(3), np.eye(4)))


def test_an_axis_that_is_no_unit_vector_is_refused() -> None:
    with pytest.raises(InvalidData, match="unit vector"):
        JointGeometry(np.array([0.0, 0, 2]), None, np.eye(4))


def test_a_movable_joint_without_an_axis_is_refused() -> None:
    with pytest.raises(InvalidData, match="needs an axis"):
        JOINT_TYPES["prismatic"].frames(JointGeometry(None, None, np.eye(4)))
