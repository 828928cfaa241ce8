"""Selection: rigid noise is called rigid, real motion by its type, and what each criterion counts."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import poses
from test_pairwise import noisy, simulated_pairs, tracks_of

from station.errors import InvalidData
from station.fit.comparison import fit_types
from station.fit.pairwise import fit_joint
from station.fit.selection import CRITERIA, correlation_time, score_fits
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray

TYPES = tuple(JOINT_TYPES)


def types_of(T: FloatArray, criterion: str = "evidence") -> list[str]:
    tracks = tracks_of(T)
    scores = score_fits(fit_types(tracks, TYPES, quickly=True), tracks, criterion)
    return [scores.best_type(pair) for pair in range(len(T))]


@pytest.mark.parametrize("frames", [50, 100, 200, 400])
def test_noisy_rigid_parts_are_called_rigid_each_time(frames: int) -> None:
    rng = np.random.default_rng(frames)
    _, _, T = simulated_pairs(rng, "rigid", pairs=50, frames=frames)
    assert types_of(noisy(rng, T)) == ["rigid"] * 50  # 200 of 200 over the four lengths


def test_long_noisy_rigid_tracks_are_called_rigid() -> None:
    rng = np.random.default_rng(20)
    _, _, T = simulated_pairs(rng, "rigid", pairs=10, frames=1000)
    assert types_of(noisy(rng, T)) == ["rigid"] * 10


@pytest.mark.parametrize(
    ("name", "travel", "arm"),
    [("prismatic", 0.05, 0.3), ("revolute", np.radians(10), 0.3), ("revolute", np.radians(10), 0.0),
     ("revolute", np.radians(10), 0.65), ("revolute", np.radians(300), 0.3)],
)  # fmt: skip
def test_small_motions_are_called_by_their_type(name: str, travel: float, arm: float) -> None:
    rng = np.random.default_rng(21)
    _, _, T = simulated_pairs(rng, name, travel=travel, arm=arm)
    assert types_of(noisy(rng, T)) == [name] * 20


def test_aic_with_honest_states_does_not_mistake_motion_for_rest() -> None:
    rng = np.random.default_rng(22)
    _, _, T = simulated_pairs(rng, "revolute", pairs=6)
    for criterion in CRITERIA:
        assert "rigid" not in types_of(noisy(rng, T), criterion), criterion


def test_probabilities_are_those_of_the_scores() -> None:
    rng = np.random.default_rng(23)
    _, _, T = simulated_pairs(rng, "prismatic", pairs=2, travel=0.02)
    tracks = tracks_of(noisy(rng, T))
    scores = score_fits(fit_types(tracks, TYPES, quickly=True), tracks, "evidence")
    probability = scores.probabilities(0)
    assert sum(probability.values()) == pytest.approx(1)
    assert max(probability, key=lambda name: probability[name]) == scores.best_type(0)
    between = scores.by_type["rigid"][0] - scores.by_type["prismatic"][0]
    assert np.log(probability["prismatic"] / probability["rigid"]) == pytest.approx(0.5 * between)


def test_errors_that_change_slowly_count_for_fewer_frames() -> None:
    rng, joint = np.random.default_rng(24), JOINT_TYPES["rigid"]
    white = rng.normal(size=(2, 400, 6))
    slow = white.copy()
    for t in range(1, 400):  # a first-order process: its correlation time is (1 + a) / (1 - a)
        slow[:, t] = 0.9 * slow[:, t - 1] + np.sqrt(1 - 0.81) * white[:, t]
    for errors, low, high in ((white, 1.0, 1.3), (slow, 10.0, 35.0)):
        T = poses(0.02 * errors[..., 3:], 0.003 * errors[..., :3])
        tracks = tracks_of(T)
        fits = {"rigid": fit_joint(joint, tracks, by_pose=True)}
        time = correlation_time(fits, tracks, {"rigid": np.zeros(2)})
        assert np.all((low <= time) & (time <= high))


def test_an_unknown_criterion_lists_the_choices() -> None:
    with pytest.raises(InvalidData, match=r"evidence.*aicc"):
        score_fits({}, tracks_of(np.tile(np.eye(4), (1, 3, 1, 1))), "bayes")
