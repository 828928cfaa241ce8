"""Looks at pairs that start where earlier looks ended, and pairs that are not looked at again."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated import noisy_log, simulated_tree

from station.fit import comparison
from station.fit.bodies import bodies_of_log, pair_tracks
from station.fit.known_joints import KnownJoints
from station.fit.learner import learn
from station.fit.pair_model import PairTracks
from station.fit.pairwise import fit_types, told_by_pose
from station.logs import FloatArray, PoseLog

IntArray = NDArray[np.intp]
TYPES = ("rigid", "prismatic", "revolute", "screw", "spherical")
PAIRS = np.array([[0, 1], [1, 2], [0, 2]])


def made_log(seed: int, *, bodies: int = 3, frames: int = 120) -> PoseLog:
    rng = np.random.default_rng([61, seed])
    truth = simulated_tree(rng, bodies=bodies, frames=frames, trackers=(1, 2), root_moves=seed % 2 == 0)
    return noisy_log(rng, truth, sigma_m=0.002, sigma_rad=0.02, missing=0.1)


def tracks_of(log: PoseLog, pairs: IntArray) -> PairTracks:
    return pair_tracks(bodies_of_log(log), pairs)


def known_of(log: PoseLog) -> KnownJoints:
    """Joints of all types, as a fit from scratch finds them."""
    tracks = tracks_of(log, PAIRS)
    fits = fit_types(tracks, TYPES)
    frames = {name: fit.model.frames for name, fit in fits.items()}
    return KnownJoints(PAIRS, np.ones(len(PAIRS), dtype=bool), told_by_pose(tracks), frames)


def worst_chi2(log: PoseLog, pairs: IntArray, known: KnownJoints) -> FloatArray:
    """(types,) how much larger squared residuals are from known joints in a single step than from scratch."""
    tracks = tracks_of(log, pairs)
    again = fit_types(tracks, TYPES, iterations=1, known=known.of(pairs, TYPES))
    scratch = fit_types(tracks, TYPES)
    cost = {name: [float(np.median(f[name].residual[..., :3] ** 2)) for f in (again, scratch)] for name in TYPES}
    return np.array([one / two for one, two in cost.values()])


def test_a_look_from_known_joints_ends_where_that_from_scratch_does() -> None:
    log = made_log(1)
    assert np.all(worst_chi2(log, PAIRS, known_of(log)) < 1.05)


def test_joints_are_known_in_whichever_order_a_pair_is_named() -> None:
    """Not quite as well: a parent's errors count otherwise than a child's."""
    log = made_log(1)
    assert np.all(worst_chi2(log, PAIRS[:, ::-1], known_of(log)) < 1.1)


def test_joints_are_known_by_the_bodies_new_numbers() -> None:
    known = known_of(made_log(1))
    found = known.renumbered(np.array([1, -1, 0])).of(np.array([[0, 1], [1, 2]]), TYPES)
    assert found.known.tolist() == [True, False]
    there = known.turned().frames["revolute"].T_parent_axis[2]
    np.testing.assert_array_equal(found.frames["revolute"].T_parent_axis[0], there)


def test_joints_told_by_positions_alone_are_not_known_from_their_child() -> None:
    known = known_of(made_log(1))
    by_position = KnownJoints(PAIRS, known.known, np.zeros(3, dtype=bool), known.frames)
    assert by_position.of(PAIRS, TYPES).known.all()
    assert not by_position.of(PAIRS[:, ::-1], TYPES).known.any()


@pytest.mark.parametrize("seed", range(6))
def test_pairs_that_a_first_look_puts_aside_would_be_no_joints(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    log = made_log(seed, bodies=4)
    found = learn(log).tree
    monkeypatch.setattr(comparison, "SCREEN_MARGIN", np.inf)
    monkeypatch.setattr(comparison, "SCREEN_MISFIT", np.inf)
    wanted = learn(log).tree
    assert found.rigid_groups == wanted.rigid_groups
    assert [(j.parent, j.child, j.type) for j in found.joints] == [(j.parent, j.child, j.type) for j in wanted.joints]
