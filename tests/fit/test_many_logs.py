"""Logs that are learned side by side: the same fits as one after another, each with its own error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import noisy_log, simulated_tree

from station.errors import InvalidData
from station.fit.learner import Fit, learn, learn_all
from station.fit.options import METHODS, FitOptions
from station.kinematics.tree_json import to_json
from station.logs import PoseLog


def made_log(seed: int, *, bodies: int = 3, frames: int = 60, trackers: int = 1, told: bool = False) -> PoseLog:
    """`told` if the log knows its noise."""
    rng = np.random.default_rng([97, seed])
    truth = simulated_tree(rng, bodies=bodies, frames=frames, trackers=(trackers, trackers), root_moves=seed % 2 == 0)
    return noisy_log(rng, truth, sigma_m=0.002, sigma_rad=0.02, missing=0.1 * (seed % 3), camera_like=told)


def assert_the_same(found: Fit | InvalidData, wanted: Fit) -> None:
    assert isinstance(found, Fit)
    assert to_json(found.tree) == to_json(wanted.tree)
    np.testing.assert_array_equal(found.states.q, wanted.states.q)
    np.testing.assert_array_equal(found.states.std, wanted.states.std)


def test_logs_that_are_learned_together_give_the_fits_that_each_alone_gives() -> None:
    """Of scenes of several sizes, with noise that is known and that is not, of several numbers of parts and frames."""
    logs = [
        *(made_log(seed) for seed in range(4)),
        made_log(4, bodies=2, frames=90),
        made_log(5, bodies=4, trackers=2),
        made_log(6, told=True),
        made_log(7, told=True),
    ]
    wide = logs[1].T_ref_part.copy()
    wide[..., :3, 3] *= 8
    logs.append(replace(logs[1], T_ref_part=wide))
    for found, log in zip(learn_all(logs), logs, strict=True):
        assert_the_same(found, learn(log))


@pytest.mark.parametrize("method", METHODS)
def test_a_log_that_cannot_be_fitted_costs_no_other_its_fit(method: str) -> None:
    good, options = [made_log(seed) for seed in (1, 4)], FitOptions(method=method)
    T = good[0].T_ref_part.copy()
    T[2:] = np.nan
    short = replace(good[0], T_ref_part=T)
    first, error, last = learn_all([good[0], short, good[1]], options)
    assert isinstance(error, InvalidData)
    with pytest.raises(InvalidData) as alone:
        learn(short, options)
    assert str(alone.value) == str(error)
    for found, log in zip((first, last), good, strict=True):
        assert_the_same(found, learn(log, options))


def test_of_no_logs_there_are_no_fits() -> None:
    assert learn_all([]) == []
