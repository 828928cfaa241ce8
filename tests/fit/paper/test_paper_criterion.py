"""Likelihood and AIC as the paper has them (16, 24), what the weights must be, and what they can't mend."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from station.errors import InvalidData
from station.fit.paper import PAPER_AIC, Criterion, PaperSteps, Weights, unsmoothed, weighted_cost
from station.fit.paper.joints import PaperJoint
from station.fit.paper.matching import match_joints
from station.logs import FloatArray
from tests.fit.simulated import poses

TYPES = ("rigid", "prismatic", "revolute")
SIGMA_RAD, SIGMA_M = np.radians(1.0), 0.002
FRAMES, TRIALS = 40, 8


def with_states(joint: PaperJoint, cost: float, frames: int) -> float:
    """AIC with honest parameters and one more for each frame's state."""
    honest = {"rigid": 6, "prismatic": 7, "revolute": 9}[joint.name]
    return cost + 2 * (honest + (0 if joint.name == "rigid" else frames))


COUNTING_STATES = Criterion("aic-with-states", with_states)


def rigid_pair(rng: np.random.Generator) -> FloatArray:
    zero = poses(rng.normal(size=3), rng.uniform(-0.3, 0.3, 3))
    return zero @ poses(SIGMA_RAD * rng.normal(size=(FRAMES, 3)), SIGMA_M * rng.normal(size=(FRAMES, 3)))


def chosen(criterion: Criterion, weights: Weights) -> list[str]:
    steps = PaperSteps(smoothing=unsmoothed, cost=weighted_cost(weights), criterion=criterion)
    rngs = [np.random.default_rng(seed) for seed in range(TRIALS)]
    return [match_joints(rigid_pair(rng)[None], TYPES, steps, rng)[0].best for rng in rngs]


def test_the_cost_is_minus_twice_the_log_likelihood_with_the_weights_of_the_noise() -> None:
    """Differences of costs against differences of SciPy's Gaussian log densities."""
    rng = np.random.default_rng(0)
    w, v = 0.02 * rng.normal(size=(30, 3)), 0.003 * rng.normal(size=(30, 3))
    costs, _ = weighted_cost(Weights.of_noise(0.02, 0.003))(np.broadcast_to(np.eye(4), (30, 4, 4)), poses(w, v))
    density = multivariate_normal(cov=np.diag([0.003**2] * 3 + [0.02**2] * 3)).logpdf(np.concatenate([v, w], axis=-1))
    np.testing.assert_allclose(costs - costs[0], -2 * (density - density[0]), atol=1e-9)


def test_aic_counts_6_9_and_12_parameters() -> None:
    rng = np.random.default_rng(0)
    (match,) = match_joints(rigid_pair(rng)[None], TYPES, PaperSteps(), rng)
    penalties = [match.scores[name] - match.costs[name] for name in TYPES]
    np.testing.assert_allclose(penalties, [12, 18, 24], atol=1e-9)


def test_aic_never_chooses_rigid_for_noisy_rigid_parts() -> None:
    """With the true noise as weights: a state takes up one direction of each frame's noise, 40 for at most 12."""
    assert "rigid" not in chosen(PAPER_AIC, Weights.of_noise(SIGMA_RAD, SIGMA_M))


def test_with_the_states_counted_rigid_is_always_chosen() -> None:
    assert set(chosen(COUNTING_STATES, Weights.of_noise(SIGMA_RAD, SIGMA_M))) == {"rigid"}


def test_weights_that_overrate_the_noise_let_aic_choose_rigid() -> None:
    """The cost falls with the square of the overrating: what rigid chooses is the weights, not the data."""
    assert set(chosen(PAPER_AIC, Weights.of_noise(5 * SIGMA_RAD, 5 * SIGMA_M))) == {"rigid"}


def test_probabilities_are_those_of_the_scores() -> None:
    rng = np.random.default_rng(3)
    (match,) = match_joints(rigid_pair(rng)[None], TYPES, PaperSteps(), rng)
    assert sum(match.probabilities.values()) == pytest.approx(1)
    odds = match.probabilities["revolute"] / match.probabilities["prismatic"]
    assert -2 * np.log(odds) == pytest.approx(match.scores["revolute"] - match.scores["prismatic"])


@pytest.mark.parametrize("c, d", [(0.0, 1.0), (1.0, -1.0), (np.inf, 1.0), (1.0, np.nan)])
def test_weights_that_are_none_are_refused(c: float, d: float) -> None:
    with pytest.raises(InvalidData, match="both positive and finite"):
        Weights(c, d)
    with pytest.raises(InvalidData, match="both positive"):
        Weights.of_noise(0.0, 0.001)
