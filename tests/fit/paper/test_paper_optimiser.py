"""The optimiser of Algorithm 1, line 19: where it ends, against SciPy's BFGS; that pairs don't disturb each other."""

from __future__ import annotations

import numpy as np
import pytest

from station.fit.paper.cost import Weights, curvature_of, weighted_cost
from station.fit.paper.joints import PaperJoint, PaperPrismatic, PaperRevolute, PaperRigid
from station.fit.paper.optimiser import bfgs, one_by_one, scoring
from station.logs import FloatArray
from tests.fit.simulated import poses

SIGMA_RAD, SIGMA_M = np.radians(1.0), 0.002
COST = weighted_cost(Weights.of_noise(SIGMA_RAD, SIGMA_M))
FRAMES, PAIRS = 40, 4


def true_joints(rng: np.random.Generator) -> tuple[PaperJoint, ...]:
    """A batch of each type."""
    a, b, c, d = poses(rng.normal(size=(4, PAIRS, 3)), rng.uniform(-0.3, 0.3, (4, PAIRS, 3)))
    u = rng.normal(size=(PAIRS, 3))
    return PaperRigid(a), PaperPrismatic(b, u / np.linalg.norm(u, axis=-1, keepdims=True)), PaperRevolute(c, d)


def watched(rng: np.random.Generator, joint: PaperJoint) -> FloatArray:
    """(P, T, 4, 4) of joints that move by half a metre or by 60 degrees, under noise."""
    q = rng.uniform(0, 0.5 if joint.name == "prismatic" else 1.0, (PAIRS, FRAMES))
    shape = (PAIRS, FRAMES, 3)
    return joint.fk(q) @ poses(SIGMA_RAD * rng.normal(size=shape), SIGMA_M * rng.normal(size=shape))


def totals(joint: PaperJoint, x: FloatArray) -> FloatArray:
    return COST(joint.fk(joint.ik(x)), x)[0].sum(axis=-1)


def both_ends(seed: int, kind: int) -> tuple[PaperJoint, PaperJoint, FloatArray]:
    """By our optimiser and by BFGS, from joints off by some centimetres and degrees; and the poses."""
    rng = np.random.default_rng([seed, kind])
    joint = true_joints(rng)[kind]
    x = watched(rng, joint)
    start = joint.moved(0.03 * rng.normal(size=(PAIRS, joint.parameters)))
    return scoring(start, x, COST), one_by_one(bfgs)(start, x, COST), x


@pytest.mark.parametrize("kind", [0, 2])
@pytest.mark.parametrize("seed", range(3))
def test_it_ends_where_bfgs_does(kind: int, seed: int) -> None:
    ours, theirs, x = both_ends(seed, kind)
    np.testing.assert_allclose(totals(ours, x), totals(theirs, x), rtol=1e-8)  # what BFGS leaves
    assert np.all(totals(ours, x) <= totals(theirs, x) * (1 + 1e-11))
    q = ours.ik(x) - theirs.ik(x)
    np.testing.assert_allclose(q - q.mean(axis=-1, keepdims=True), 0, atol=2e-5)  # rad: a thousandth of the noise


@pytest.mark.parametrize("seed", range(3))
def test_a_slide_ends_no_worse_than_by_bfgs(seed: int) -> None:
    """Under equation 21 o goes metres along u until its lever takes up errors of orientation: either way is a minimum,
    and the better one of the two is taken, wherever BFGS ends.
    """
    ours, theirs, x = both_ends(seed, 1)
    assert np.all(totals(ours, x) <= totals(theirs, x) * (1 + 1e-8))  # what is left along the valley
    twin = ours.twin
    assert twin is not None and np.all(totals(ours, x) <= totals(twin, x))
    lever_m, lever_of_bfgs_m = (
        np.abs(np.sum(joint.arrays[0][:, :3, 3] * joint.arrays[1], axis=-1)) for joint in (ours, theirs)
    )
    np.testing.assert_allclose(lever_m, lever_of_bfgs_m, rtol=0.02)
    assert np.all(lever_m > 1.0)
    along = np.sum(ours.arrays[1] * theirs.arrays[1], axis=-1)
    assert np.all(np.abs(along) > np.cos(0.002))  # rad: a tenth of the noise


@pytest.mark.parametrize("kind", range(3))
def test_what_becomes_of_a_pair_does_not_depend_on_those_beside_it(kind: int) -> None:
    rng = np.random.default_rng(kind)
    joint = true_joints(rng)[kind]
    x = watched(rng, joint)
    start = joint.moved(0.03 * rng.normal(size=(PAIRS, joint.parameters)))
    alone = scoring(start.take(np.array([2])), x[2:3], COST)
    for one, among in zip(alone.arrays, scoring(start, x, COST).arrays, strict=True):
        np.testing.assert_allclose(one[0], among[2], atol=1e-8)  # m, rad: rounding along what changes nothing


def test_the_curvature_of_the_paper_s_cost_is_that_of_its_two_terms() -> None:
    curvature = curvature_of(weighted_cost(Weights(c=700.0, d=3e4)))
    np.testing.assert_allclose(curvature, np.diag([6e4] * 3 + [2800.0] * 3), rtol=1e-9, atol=1e-6)
