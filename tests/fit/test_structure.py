"""Spanning forest, roots, and rigid subclusters."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import noisy_log, simulated_tree

from station.fit.bodies import Group
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.structure import components, depths, outward, shallowest, spanning_forest
from station.fit.subclusters import merged, singles
from station.kinematics import se3
from tests.benchmarks.random_trees import BODIES, try_tree

CHAIN = np.array([[0, 1], [1, 2], [2, 3], [3, 4]], dtype=np.intp)


def test_the_lightest_edges_that_connect_are_taken() -> None:
    pairs = np.array([[0, 1], [0, 2], [1, 2]], dtype=np.intp)
    assert spanning_forest(3, pairs, np.array([-10.0, -5.0, -8.0])).tolist() == [0, 2]


def test_equal_and_extreme_weights_lose_no_edge() -> None:
    pairs = np.array([[0, 1], [1, 2], [2, 3]], dtype=np.intp)
    assert len(spanning_forest(4, pairs, np.array([-7.0, -7.0, -7.0]))) == 3
    assert len(spanning_forest(4, pairs, np.array([-1e9, -1e-9, -5.0]))) == 3


def test_pairs_that_explain_nothing_are_no_edges() -> None:
    pairs = np.array([[0, 1], [1, 2], [0, 2]], dtype=np.intp)
    assert spanning_forest(3, pairs, np.array([-4.0, 3.0, np.inf])).tolist() == [0]
    assert spanning_forest(3, pairs, np.full(3, np.inf)).tolist() == []


def test_the_middle_of_a_chain_makes_the_shallowest_tree() -> None:
    assert shallowest(range(5), CHAIN) == 2
    assert depths(0, CHAIN) == {0: 0, 1: 1, 2: 2, 3: 3, 4: 4}


def test_outward_names_parents_before_children() -> None:
    assert [(a, b) for a, b, _ in outward(2, CHAIN)] == [(2, 1), (2, 3), (1, 0), (3, 4)]


def test_components_are_told_by_their_least_node() -> None:
    assert components(5, CHAIN[[0, 2]]) == [0, 0, 2, 2, 4]


def test_merged_parts_keep_their_relative_poses() -> None:
    """Table I: a rigid offset on either side is absorbed, also through parts that were joined before."""
    rng = np.random.default_rng(30)
    T_world = se3.exp(rng.normal(size=(5, 6)))
    edges = np.array([[4, 2], [2, 0]], dtype=np.intp)
    T_a_b = se3.inverse(T_world[edges[:, 0]]) @ T_world[edges[:, 1]]
    groups = merged(singles(5), edges, T_a_b)
    assert [group.members for group in groups] == [(0, 2, 4), (1,), (3,)]
    np.testing.assert_allclose(groups[0].mounts, se3.inverse(T_world[0]) @ T_world[[0, 2, 4]], atol=1e-12)
    more = merged(groups, np.array([[0, 2]], dtype=np.intp), (se3.inverse(T_world[0]) @ T_world[3])[None])
    assert [group.members for group in more] == [(0, 2, 3, 4), (1,)]
    np.testing.assert_allclose(more[0].mounts, se3.inverse(T_world[0]) @ T_world[[0, 2, 3, 4]], atol=1e-12)


def test_a_body_is_named_by_its_first_part() -> None:
    groups = merged(
        (Group((3,), se3.identity(1)), Group((1,), se3.identity(1))), np.array([[0, 1]], dtype=np.intp), np.eye(4)[None]
    )
    assert groups[0].members == (1, 3)


@pytest.mark.parametrize("number", [86, 148])
def test_edges_compare_by_misfit_whatever_the_noise_of_their_ends(number: int) -> None:
    """Of 200 random trees the two in which, by likelihood alone, a pair of which one end is known better crowds out a
    true joint.
    """
    assert try_tree((0, number, FitOptions().joint_types, BODIES)).wrong == {}


def test_edges_compare_by_misfit_however_far_their_joints_went() -> None:
    """A chain of four at 4 mm and 2 deg, in which a true joint goes far and a pair beyond it does not."""
    rng = np.random.default_rng([11, 4, 1])
    truth = simulated_tree(rng, bodies=4, frames=100, trackers=(1, 1))
    log = noisy_log(rng, truth, sigma_m=0.004, sigma_rad=np.radians(2.0))
    body = dict(zip(log.parts, truth.body_of, strict=True))
    found = {frozenset((body[joint.parent], body[joint.child])) for joint in learn(log).tree.joints}
    assert found == {frozenset(joint[:2]) for joint in truth.joints}
