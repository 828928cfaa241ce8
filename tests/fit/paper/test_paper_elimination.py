"""Rigid subclusters eliminated: the same motion of the bodies, told by fewer joints."""

from __future__ import annotations

import numpy as np

from station.fit.paper.elimination import Edge, eliminate_rigid
from station.fit.paper.joints import PaperPrismatic, PaperRevolute, PaperRigid
from station.kinematics import se3
from tests.fit.simulated import poses


def test_the_bodies_move_as_the_parts_did() -> None:
    """0 -rigid- 1 =revolute= 2 -rigid- 3 -rigid- 4 =prismatic= 5: joints at first and other members, turned anyhow."""
    rng = np.random.default_rng(0)
    T = poses(rng.normal(size=(8, 3)), rng.uniform(-0.5, 0.5, (8, 3)))
    edges = [
        Edge(1, 0, PaperRigid(T[0]), 0),
        Edge(2, 1, PaperRevolute(T[1], T[2]), 1),
        Edge(2, 3, PaperRigid(T[3]), 2),
        Edge(4, 3, PaperRigid(T[4]), 3),
        Edge(4, 5, PaperPrismatic(T[5], np.array([0.6, 0.8, 0.0])), 4),
    ]
    q = rng.uniform(-1, 1, (2, 9))
    # Chained part by part, from the first one.
    T_0_1 = np.linalg.inv(T[0])
    T_0_2 = T_0_1 @ np.linalg.inv(edges[1].joint.fk(q[0]))
    T_0_4 = T_0_2 @ T[3] @ np.linalg.inv(T[4])
    T_0_5 = T_0_4 @ edges[4].joint.fk(q[1])

    skeleton = eliminate_rigid(6, edges)
    assert [group.members for group in skeleton.groups] == [(0, 1), (2, 3, 4), (5,)]
    assert [(edge.parent, edge.child, edge.joint.name, edge.match) for edge in skeleton.edges] == [
        (1, 0, "revolute", 1),
        (1, 2, "prismatic", 4),
    ]
    turn, slide = (edge.joint for edge in skeleton.edges)
    np.testing.assert_allclose(se3.inverse(turn.fk(q[0])), T_0_2, atol=1e-13)
    np.testing.assert_allclose(se3.inverse(turn.fk(q[0])) @ slide.fk(q[1]), T_0_5, atol=1e-13)


def test_a_tree_of_rigid_joints_alone_is_one_body() -> None:
    T = poses(np.ones(3), np.ones(3))
    skeleton = eliminate_rigid(3, [Edge(0, 2, PaperRigid(T), 1), Edge(1, 2, PaperRigid(T), 2)])
    assert [group.members for group in skeleton.groups] == [(0, 1, 2)]
    assert skeleton.edges == ()
