"""The paper's joints (18-23): kinematics, gradients, reversal and Table I, against their definitions in matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.fit.paper.cost import Weights, weighted_cost
from station.fit.paper.joints import PaperJoint, PaperPrismatic, PaperRevolute, PaperRigid
from station.fit.paper.optimiser import objective_of
from station.kinematics import metric
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray
from tests.fit.simulated import poses

COST = weighted_cost(Weights(c=700.0, d=3e4))
FRAMES = 12


def random_poses(rng: np.random.Generator, *batch: int) -> FloatArray:
    return poses(rng.normal(size=(*batch, 3)), rng.uniform(-0.5, 0.5, (*batch, 3)))


def joints(rng: np.random.Generator) -> tuple[PaperJoint, ...]:
    a, b, c, d = random_poses(rng, 4)
    u = rng.normal(size=3)
    return PaperRigid(a), PaperPrismatic(b, u / np.linalg.norm(u)), PaperRevolute(c, d)


def states(rng: np.random.Generator, joint: PaperJoint) -> FloatArray:
    return np.zeros(FRAMES) if joint.name == "rigid" else rng.uniform(-1.5, 1.5, FRAMES)


@pytest.mark.parametrize("seed", range(3))
def test_fk_is_what_equations_18_20_and_22_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rigid, prismatic, revolute = joints(rng)
    for q in rng.uniform(-2, 2, 4):
        slide, turn = np.eye(4), np.eye(4)
        slide[:3, 3] = q * prismatic.u
        turn[:3, :3] = Rotation.from_euler("z", q).as_matrix()
        np.testing.assert_allclose(rigid.fk(np.array([q]))[0], rigid.o)
        np.testing.assert_allclose(prismatic.fk(np.array([q]))[0], slide @ prismatic.o, atol=1e-14)
        np.testing.assert_allclose(revolute.fk(np.array([q]))[0], revolute.r @ turn @ revolute.c, atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_ik_undoes_fk(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for joint in joints(rng):
        q = states(rng, joint)
        np.testing.assert_allclose(joint.ik(joint.fk(q)), q, atol=1e-12)


def test_the_prismatic_ik_is_equation_21_off_the_joint_too() -> None:
    rng = np.random.default_rng(4)
    _, joint, _ = joints(rng)
    x = random_poses(rng, FRAMES)
    expected = (x @ np.linalg.inv(joint.o))[:, :3, 3] @ joint.u
    np.testing.assert_allclose(joint.ik(x), expected, atol=1e-13)


def test_the_revolute_ik_is_the_turn_about_z_nearest_to_the_rotation() -> None:
    """Oracle: the angle with the largest trace of R_z(q)^T R, over a fine grid."""
    rng = np.random.default_rng(5)
    _, _, joint = joints(rng)
    x = random_poses(rng, FRAMES)
    R = (np.linalg.inv(joint.r) @ x @ np.linalg.inv(joint.c))[:, :3, :3]
    grid = np.linspace(-np.pi, np.pi, 20001)
    traces = np.einsum("gij,tij->tg", Rotation.from_euler("z", grid[:, None]).as_matrix(), R)
    np.testing.assert_allclose(joint.ik(x), grid[traces.argmax(axis=-1)], atol=2e-4)  # rad, half the grid's step


@pytest.mark.parametrize("kind", range(3))
@pytest.mark.parametrize("seed", range(4))
def test_the_gradient_through_fk_and_ik_is_the_finite_difference(kind: int, seed: int) -> None:
    """Noisy poses, far off the joint, and a step far from the start."""
    rng = np.random.default_rng(seed)
    joint = joints(rng)[kind]
    x = joint.fk(states(rng, joint)) @ poses(0.2 * rng.normal(size=(FRAMES, 3)), 0.1 * rng.normal(size=(FRAMES, 3)))
    objective = objective_of(joint, x, COST)
    step = 0.4 * rng.normal(size=joint.parameters)
    h = 1e-6  # m, rad: rounding and curvature cost the same here
    numeric = [(objective(step + e)[0] - objective(step - e)[0]) / (2 * h) for e in h * np.eye(joint.parameters)]
    gradient = objective(step)[1]
    np.testing.assert_allclose(gradient, numeric, atol=1e-7 * np.abs(gradient).max())


def test_parameters_are_counted_as_in_footnote_5() -> None:
    for joint in joints(np.random.default_rng(0)):
        assert joint.parameters == {"rigid": 6, "prismatic": 9, "revolute": 12}[joint.name]


@pytest.mark.parametrize("seed", range(3))
def test_table_1_absorbs_offsets_on_either_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    offset = random_poses(rng)
    for joint in joints(rng):
        q = states(rng, joint)
        np.testing.assert_allclose(joint.with_child_offset(offset).fk(q), joint.fk(q) @ offset, atol=1e-13)
        np.testing.assert_allclose(joint.with_parent_offset(offset).fk(q), offset @ joint.fk(q), atol=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_turned_round_is_the_inverse_motion_for_the_same_states(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for joint in joints(rng):
        q = states(rng, joint)
        np.testing.assert_allclose(joint.inverted().fk(q), np.linalg.inv(joint.fk(q)), atol=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_the_geometry_moves_as_the_joint_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for joint in joints(rng):
        q, zero = states(rng, joint), 0.3
        geometry = joint.geometry(zero)
        T = JOINT_TYPES[joint.name].forward(geometry, q - zero)
        np.testing.assert_allclose(T, joint.fk(q), atol=1e-13)
        if geometry.point_parent_m is not None and geometry.axis_parent is not None:
            along = (T[:, :3, 3] - geometry.point_parent_m) @ geometry.axis_parent
            np.testing.assert_allclose(along, 0, atol=1e-13)  # the point nearest to the child


def test_the_cost_is_the_metric_s_squared_distance() -> None:
    rng = np.random.default_rng(6)
    u, v = random_poses(rng, 2, FRAMES)
    costs, gradients = COST(u, v)
    np.testing.assert_allclose(costs, metric.squared_distance(u, v, c=700.0, d=3e4), rtol=1e-12)
    np.testing.assert_allclose(gradients, metric.twist_gradient(u, v, c=700.0, d=3e4))


def test_the_relative_pose_of_algorithm_1_as_printed_is_none() -> None:
    """x^b (x^a)^-1 with poses in the world changes with where the object is; (x^a)^-1 x^b does not."""
    rng = np.random.default_rng(7)
    x_a, x_b, elsewhere = random_poses(rng, 3)
    here, there = x_b @ np.linalg.inv(x_a), (elsewhere @ x_b) @ np.linalg.inv(elsewhere @ x_a)
    assert np.abs(here - there).max() > 0.1
    here, there = np.linalg.inv(x_a) @ x_b, np.linalg.inv(elsewhere @ x_a) @ (elsewhere @ x_b)
    np.testing.assert_allclose(here, there, atol=1e-14)
