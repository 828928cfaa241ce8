"""Algorithm 1's starts: right on exact data as corrected, wrong as printed, and the weakness that stays."""

from __future__ import annotations

import numpy as np
import pytest

from station.fit.paper.cost import DEFAULT_WEIGHTS, weighted_cost
from station.fit.paper.joints import PaperRevolute
from station.fit.paper.optimiser import bfgs, one_by_one, scoring
from station.fit.paper.starts import circumcentre, start_prismatic, start_revolute, start_rigid, three_times
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray
from tests.fit.simulated import poses

COST = weighted_cost(DEFAULT_WEIGHTS)
FRAMES = 60


def hinge(rng: np.random.Generator, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """(T, 4, 4) exact poses of a child that turns by 80 deg, and (2, 3) the axis and a point of it."""
    axis, point = np.array([0.36, -0.48, 0.8]), np.array([0.1, -0.2, 0.15])
    across = np.array([0.8, 0.6, 0.0])
    turn = np.radians(80.0) * np.linspace(0, 1, FRAMES)[:, None] * axis
    zero = poses(rng.normal(size=3), radius_m * across)
    return poses(np.zeros(3), point) @ poses(turn, np.zeros((FRAMES, 3))) @ zero, np.stack([axis, point])


def total(joint: PaperRevolute, x: FloatArray) -> float:
    return float(COST(joint.fk(joint.ik(x)), x)[0].sum())


def as_printed(x: FloatArray, start: PaperRevolute) -> PaperRevolute:
    """Lines 15 and 16 to the letter: the circumcentre and the plane's directions start c, and r is x_i c^-1."""
    i = int(np.argmin(np.abs(start.ik(x))))
    return PaperRevolute(x[i] @ se3.inverse(start.r), start.r)


def test_three_times_differ() -> None:
    rng = np.random.default_rng(0)
    drawn = [three_times(3, rng) for _ in range(50)]
    assert all(sorted(times) == [0, 1, 2] for times in drawn)
    assert len(set(drawn)) > 1


def test_the_circumcentre_is_equally_far_from_all_corners() -> None:
    for corners in np.random.default_rng(1).normal(size=(20, 3, 2)):
        radii = np.linalg.norm(corners - circumcentre(corners), axis=-1)
        np.testing.assert_allclose(radii, radii[0])


def test_positions_on_a_line_have_their_mean_for_a_circumcentre() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 6.0]])
    np.testing.assert_allclose(circumcentre(corners), corners.mean(axis=0))
    np.testing.assert_allclose(circumcentre(np.ones((3, 2))), np.ones(2))


@pytest.mark.parametrize("seed", range(5))
def test_the_revolute_start_is_exact_on_exact_data(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, (axis, point) = hinge(rng, radius_m=0.3)
    start = start_revolute(x, rng)
    assert abs(abs(start.r[:3, 2] @ axis) - 1) < 1e-9
    assert np.linalg.norm(np.cross(start.r[:3, 3] - point, axis)) < 1e-6  # m, to the axis
    assert total(start, x) < 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_the_revolute_start_as_printed_is_wrong_on_exact_data(seed: int) -> None:
    """The circumcentre in c, in the child's frame: the start meets one pose, and is off by much in the others."""
    rng = np.random.default_rng(seed)
    x, _ = hinge(rng, radius_m=0.3)
    assert total(as_printed(x, start_revolute(x, rng)), x) > 1e4  # -2 log likelihood of 60 frames; 360 would be noise


@pytest.mark.parametrize("seed", range(5))
def test_the_revolute_start_fails_for_a_child_on_the_axis(seed: int) -> None:
    """Its positions are all one, but for noise; the rotations, which the closed form asks, are not."""
    rng = np.random.default_rng(seed)
    x, (axis, _) = hinge(rng, radius_m=0.0)
    x = x @ poses(np.radians(1.0) * rng.normal(size=(FRAMES, 3)), 0.002 * rng.normal(size=(FRAMES, 3)))
    off = np.degrees(np.arccos(min(1.0, abs(start_revolute(x, rng).r[:3, 2] @ axis))))
    by_rotations = JOINT_TYPES["revolute"].starts(x, np.ones(FRAMES))[0].T_parent_axis[:3, 2]
    assert off > 5.0  # deg
    assert np.degrees(np.arccos(min(1.0, abs(by_rotations @ axis)))) < 2.0  # deg: 1 deg of noise in 60 frames


@pytest.mark.parametrize("seed", range(3))
def test_prismatic_and_rigid_starts_are_exact_on_exact_data(seed: int) -> None:
    rng = np.random.default_rng(seed)
    o, u = poses(rng.normal(size=3), rng.normal(size=3)), np.array([0.6, 0.0, -0.8])
    x = poses(np.zeros((FRAMES, 3)), np.linspace(0, 0.2, FRAMES)[:, None] * u) @ o
    prismatic = start_prismatic(x, rng)
    np.testing.assert_allclose(np.abs(prismatic.u), np.abs(u), atol=1e-12)
    assert COST(prismatic.fk(prismatic.ik(x)), x)[0].sum() < 1e-12
    np.testing.assert_array_equal(start_rigid(np.tile(o, (FRAMES, 1, 1)), rng).o, o)


def test_poses_that_are_all_one_have_starts_of_each_type() -> None:
    rng = np.random.default_rng(0)
    x = np.tile(poses(rng.normal(size=3), rng.normal(size=3)), (5, 1, 1))
    for start in (start_rigid, start_prismatic, start_revolute):
        for optimiser in (scoring, one_by_one(bfgs)):
            begun = start(x, rng)
            joint = optimiser(type(begun).batch([begun]), x[None], COST)
            assert COST(joint.fk(joint.ik(x[None])), x[None])[0].sum() < 1e-12
