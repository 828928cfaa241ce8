"""The evidence: stated probabilities are the shares that are right, and what is not told costs nothing."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from station.fit.bodies import bodies_of_log, pair_tracks, with_reference
from station.fit.comparison import fit_types
from station.fit.evidence import evidence
from station.fit.learner import Fit, learn_all
from station.fit.selection import score_fits
from station.logs import PoseLog
from tests.benchmarks.made_joints import single_joint, watch

STD_M, STD_RAD = 0.003, 0.02
TRIALS = 240


def small_motion(trial: int) -> tuple[str, PoseLog]:
    """A joint that moved by little, at random; from below the noise to well above."""
    rng = np.random.default_rng([120, trial])
    kind = ("rigid", "prismatic", "revolute")[trial % 3]
    travel = np.exp(rng.uniform(*np.log([0.005, 0.06] if kind == "prismatic" else [0.01, 0.2])))
    made = single_joint(rng, kind, frames=100, travel=float(travel), arm_m=float(rng.uniform(0.05, 1.0)))
    return kind, watch(rng, made.T_ref_part, STD_M, STD_RAD).log


@cache
def stated_and_right() -> tuple[np.ndarray, np.ndarray]:
    """Of the joints that were reported: probability of the type given, and whether that is right."""
    found: list[tuple[float, bool]] = []
    kinds, logs = zip(*(small_motion(trial) for trial in range(TRIALS)), strict=True)
    for kind, fit in zip(kinds, learn_all(logs), strict=True):
        assert isinstance(fit, Fit)
        for joint in fit.tree.joints:
            assert joint.probability is not None
            found.append((joint.probability[joint.type], joint.type == kind))
    stated, right = np.array(found).T
    return stated, right


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.8), (0.8, 0.98), (0.98, 1.0)])
def test_the_stated_probability_is_the_share_that_is_right(low: float, high: float) -> None:
    """Within three standard errors; where all is nearly certain one miss is allowed."""
    stated, right = stated_and_right()
    some = (low <= stated) & (stated <= high)
    expected = stated[some].mean()
    error = max(np.sqrt(expected * (1 - expected) / some.sum()), 0.5 / some.sum())
    assert some.sum() >= 10
    assert abs(right[some].mean() - expected) < 3 * error


def test_what_the_data_do_not_tell_costs_nothing() -> None:
    """A slide that turned out to be none is worse than a rigid joint, but by less than if all data told it."""
    rng = np.random.default_rng(121)
    made = single_joint(rng, "rigid", frames=200, travel=0.0, arm_m=0.3)
    log = watch(rng, made.T_ref_part, STD_M, STD_RAD).log
    tracks = pair_tracks(with_reference(bodies_of_log(log), "world"), np.array([[0, 1]]))
    fits = fit_types(tracks, ("rigid", "prismatic"), quickly=False)
    plain = evidence(fits, tracks).in_full
    schwarz = 3 * np.log(200 * 6)  # of the direction and the spread, if all data told them
    assert 0 < plain["prismatic"][0] - plain["rigid"][0] < schwarz


def test_scores_of_free_pairs_and_of_certain_ones_are_finite() -> None:
    for trial in (1, 2):
        _, log = small_motion(trial)
        tracks = pair_tracks(with_reference(bodies_of_log(log), "world"), np.array([[0, 1]]))
        types = ("rigid", "prismatic", "revolute", "screw", "spherical")
        scores = score_fits(fit_types(tracks, types, quickly=False), tracks, "evidence")
        assert all(np.isfinite(score).all() for score in scores.by_type.values())
