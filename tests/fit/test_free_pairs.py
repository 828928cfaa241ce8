"""Free pairs: what nothing joins is a forest, what errs slowly or is hardly straight is a joint all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.bodies import bodies_of_log, pair_tracks, with_reference
from station.fit.free_pairs import log_odds_of_free
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.pairwise import fit_types
from station.logs import PoseLog
from tests.benchmarks.made_joints import Faults, poses, random_poses, single_joint, watch
from tests.benchmarks.nulls import Cell, free_motion, true_poses
from tests.benchmarks.read_fits import ALL_TYPES, found_type

STD_M, STD_RAD = 0.002, 0.01


def moving(kind: str, seed: int, *, parts: int = 2, frames: int = 200) -> PoseLog:
    rng = np.random.default_rng([130, seed])
    return watch(rng, true_poses(rng, Cell(kind, parts, frames, (2.0, 0.6))), STD_M, STD_RAD).log


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("kind", ["smooth", "walk", "jumps"])
def test_parts_that_move_freely_are_a_forest(kind: str, parts: int) -> None:
    for seed in range(3):
        tree = learn(moving(kind, seed, parts=parts)).tree
        assert tree.joints == () and len(tree.trees) == 2
        assert any("free" in warning for warning in tree.warnings)


@pytest.mark.parametrize(("parts", "frames"), [(1, 20), (2, 20), (2, 200)])
def test_bodies_that_move_freely_are_no_pair_that_does(parts: int, frames: int) -> None:
    """Trackers of one body, which itself goes anywhere, under noise up to 30 mm and 10 deg: one body each time."""
    for noise in ((0.1, 0.05), (3.0, 2.0), (30.0, 10.0)):
        for seed in range(4):
            rng = np.random.default_rng([131, seed])
            T = true_poses(rng, Cell("rigid", parts, frames, noise))
            log = watch(rng, T, 1e-3 * noise[0], float(np.radians(noise[1]))).log
            assert found_type(learn(log).tree) == "rigid"


def test_two_objects_in_one_log_are_two_trees() -> None:
    """Two hinges, each with a base that moves freely."""
    rng = np.random.default_rng(132)
    both = []
    for _ in range(2):
        made = single_joint(rng, "revolute", frames=200, travel=1.2, arm_m=0.2)
        both.append(
            free_motion(rng, "smooth", 200)[:, None]
            @ np.stack([np.tile(np.eye(4), (200, 1, 1)), made.T_ref_part[:, 0]], 1)
        )
    log = watch(rng, np.concatenate(both, axis=1), STD_M, STD_RAD).log
    tree = learn(replace(log, parts=("a", "lid_a", "b", "lid_b"))).tree
    assert sorted(tuple(sorted(trunk)) for trunk in tree.trees) == [("a", "lid_a"), ("b", "lid_b")]
    assert [joint.type for joint in tree.joints] == ["revolute", "revolute"]


def test_errors_that_last_for_seconds_leave_a_hinge_a_hinge() -> None:
    rng = np.random.default_rng(133)
    made = single_joint(rng, "revolute", frames=300, travel=1.0, arm_m=0.4)
    log = watch(rng, made.T_ref_part, 0.004, 0.03, Faults(error_frames=40.0)).log
    assert found_type(learn(log).tree) == "revolute"


@pytest.mark.parametrize("size", [1.0, 1e3])
def test_how_large_a_thing_is_does_not_make_it_free(size: float) -> None:
    rng = np.random.default_rng(134)
    made = single_joint(rng, "revolute", frames=100, travel=1.0, arm_m=0.4 * size, lever_m=0.2 * size)
    assert found_type(learn(watch(rng, made.T_ref_part, STD_M * size, STD_RAD).log).tree) == "revolute"


def test_a_part_in_the_middle_of_a_ball_joint_is_one_where_balls_are_candidates() -> None:
    """Positions that stay and orientations that turn are one; by other types they are free."""
    rng = np.random.default_rng(135)
    made = single_joint(rng, "spherical", frames=200, travel=1.0, arm_m=0.0)
    log = watch(rng, made.T_ref_part, STD_M, STD_RAD).log
    assert found_type(learn(log, FitOptions(joint_types=ALL_TYPES)).tree) == "spherical"
    assert found_type(learn(log).tree) == "free"


def test_free_can_be_asked_for_among_the_scores() -> None:
    rng = np.random.default_rng(136)
    made = single_joint(rng, "prismatic", frames=100, travel=0.2, arm_m=0.1)
    log = watch(rng, made.T_ref_part, STD_M, STD_RAD).log
    (joint,) = learn(log, FitOptions(joint_types=("rigid", "prismatic", "revolute", "free"))).tree.joints
    assert joint.scores is not None and joint.probability is not None
    assert joint.scores["free"] > joint.scores["prismatic"] and joint.probability["free"] < 0.01


def test_a_body_that_is_seen_rarely_among_others_is_no_harm() -> None:
    """Few frames of one part, and a part that was seen with no other."""
    rng = np.random.default_rng(137)
    T = np.stack([free_motion(rng, "smooth", 200), random_poses(rng, 0.5, 200)], axis=1)
    T = np.concatenate([T, T[:, :1] @ poses(np.zeros(3), np.array([0.1, 0.0, 0.0]))], axis=1)
    log = watch(rng, T, STD_M, STD_RAD).log
    seen = log.T_ref_part.copy()
    seen[9:, 1] = np.nan
    tree = learn(replace(log, T_ref_part=seen, parts=("a", "rare", "b"))).tree
    assert tree.rigid_groups == (("a", "b"),) and tree.joints == ()
    assert any("rare was seen in 9" in warning for warning in tree.warnings)


def test_what_makes_a_pair_free_is_not_what_is_looked_at_beside_it() -> None:
    """Half of a pair's frames, with all frames of another one beside it, and alone: the lag is of its own frames."""
    rng = np.random.default_rng(136)
    made = single_joint(rng, "revolute", frames=200, travel=0.25, arm_m=0.2)
    T = np.concatenate([made.T_ref_part[:, :1], free_motion(rng, "walk", 200)[:, None]], axis=1)
    log = watch(rng, T, STD_M, STD_RAD).log
    seen = np.array(log.T_ref_part)
    seen[::2, 0] = np.nan
    bodies = with_reference(bodies_of_log(replace(log, T_ref_part=seen)), log.reference)
    both, alone = (pair_tracks(bodies, np.array(pairs)) for pairs in ([[0, 1], [0, 2]], [[0, 1]]))
    odds = [
        log_odds_of_free(fit_types(tracks, ["rigid"])["rigid"], None, tracks, np.ones(len(tracks.seen)))
        for tracks in (both, alone)
    ]
    assert odds[0][0] == pytest.approx(odds[1][0], rel=1e-6)
