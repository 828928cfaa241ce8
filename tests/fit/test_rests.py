"""Long rests: a tracker that stands still errs alike in all frames, and a pose that is kept is one observation."""

from __future__ import annotations

import numpy as np
import pytest

from station.fit.asking import answered
from station.fit.bodies import bodies_of_log
from station.fit.comparison import compare_pairs
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.rests import LEAST_AT_REST, frames_to_count
from station.kinematics import se3
from station.logs import FloatArray
from tests.benchmarks.made_joints import poses, random_poses
from tests.benchmarks.made_rests import chain_that_rests, turn_of, watch_resting
from tests.benchmarks.made_trees import mistakes

STD_M, STD_RAD = 0.001, 0.01
FRAMES, CHAINS = 160, 4


def swung(rng: np.random.Generator, frames: int, start: int, stop: int) -> FloatArray:
    """(1, T, 4, 4) of a part that swings by 0.6 rad on an arm of 0.3 m, with independent noise, little to the eye."""
    q = turn_of(frames, start, stop, 0.6)
    T = poses(q * np.array([0.0, 0.0, 1.0]), np.zeros(3)) @ poses(np.zeros(3), np.array([0.3, 0.0, 0.0]))
    noise = rng.normal(size=(frames, 6)) * np.repeat([1e-4, 1e-3], 3)
    return (T @ poses(noise[:, 3:], noise[:, :3]))[None]


@pytest.mark.parametrize(("moving", "told", "trackers"), [(0.8, True, 2), (0.5, True, 2), (0.6, False, 1)])
def test_a_chain_is_found_whose_trackers_err_alike_as_long_as_they_rest(
    moving: float, told: bool, trackers: int
) -> None:
    """Nine tenths, or all but a hundredth, of the errors' variance go with the pose."""
    wrong = {}
    for seed in range(CHAINS):
        rng = np.random.default_rng([180, seed])
        made = chain_that_rests(rng, bodies=3, frames=FRAMES, moving=moving, trackers=trackers)
        by_pose = 0.9 if seed % 2 else 0.99
        fit = learn(watch_resting(rng, made, STD_M, STD_RAD, by_pose=by_pose, told=told))
        wrong[seed] = mistakes(fit.tree, made) or fit.tree.warnings
    assert not any(wrong.values()), wrong


def test_a_joint_that_leaves_the_motion_out_is_no_better_an_edge_than_one_that_explains_it() -> None:
    """Base and forearm turn about one axis as long as the elbow rests: 30 % of the frames are outliers of that."""
    for seed in range(CHAINS):
        rng = np.random.default_rng([181, seed])
        made = chain_that_rests(rng, bodies=3, frames=FRAMES, moving=0.6, trackers=1)
        log = watch_resting(rng, made, STD_M, STD_RAD, by_pose=0.9)
        pairs, options = np.array([[0, 2], [1, 2]]), FitOptions()
        table = answered(compare_pairs(bodies_of_log(log), pairs, options.joint_types, options.criterion))
        past_the_elbow, elbow = table.scores.misfit / table.counted
        assert past_the_elbow > elbow + 5  # -2 log likelihood of a frame; a pose tells some 60


def test_frames_at_rest_count_as_many_as_those_in_motion() -> None:
    counted = frames_to_count(swung(np.random.default_rng(183), 500, 100, 200), np.ones((1, 500), dtype=bool))[0]
    assert counted[105:195].mean() > 0.95  # it turns back slowly
    assert 90 <= counted.sum() - counted[100:200].sum() <= 110
    assert 40 <= counted[200:].sum() <= 90  # spread over both rests


def test_a_motion_without_rests_counts_whole() -> None:
    rng = np.random.default_rng(184)
    for start, stop in ((0, 500), (0, 450)):
        assert frames_to_count(swung(rng, 500, start, stop), np.ones((1, 500), dtype=bool)).all()


@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_independent_noise_of_a_pair_that_only_rests_counts_whole(outliers: float) -> None:
    rng = np.random.default_rng(185)
    T = np.concatenate([swung(rng, 300, 0, 0) for _ in range(20)])
    gross = rng.uniform(size=T.shape[:2]) < outliers
    T[gross] = random_poses(rng, 0.5, *T.shape[:2])[gross]
    share = frames_to_count(T, np.ones(T.shape[:2], dtype=bool)).mean(axis=-1)
    assert np.all(share == 1) if not outliers else np.mean(share == 1) >= 0.9


def test_few_frames_in_motion_thin_no_rest_and_short_rests_stay() -> None:
    rng = np.random.default_rng(186)
    seen = np.ones((1, 300), dtype=bool)
    assert frames_to_count(swung(rng, 300, 100, 105), seen).all()
    short = frames_to_count(swung(rng, 300, 100, 120), seen)[0]
    assert short[:90].sum() + short[130:].sum() >= LEAST_AT_REST - 5


def test_what_was_not_seen_does_not_count() -> None:
    rng = np.random.default_rng(187)
    T, seen = swung(rng, 300, 100, 200), rng.uniform(size=(1, 300)) < 0.7
    T[~seen] = np.eye(4)
    counted = frames_to_count(T, seen)
    assert not counted[~seen].any()
    np.testing.assert_array_equal(counted[seen], frames_to_count(T[seen][None], np.ones((1, seen.sum()), bool))[0])
    assert not frames_to_count(T[:, :5], np.zeros((1, 5), dtype=bool)).any()


def test_exact_poses_at_rest_count_as_many_as_those_in_motion() -> None:
    T = se3.identity(1, 300)
    T[0, 100:150, 0, 3] = np.linspace(0, 0.2, 50)
    T[0, 150:, 0, 3] = 0.2
    assert frames_to_count(T, np.ones((1, 300), dtype=bool)).sum() == pytest.approx(100, abs=10)
