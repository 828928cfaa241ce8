"""Rigid subclusters: parts that don't move against each other become one body (paper, Table I).

Table I absorbs a rigid offset q into the joints at its ends, o <- o q and so on. Here the offset becomes the part's
mount in its body, T_body_part, and the joints are fitted anew between bodies; the effect is the same, and all parts'
frames are used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from station.fit.bodies import Group
from station.fit.structure import components, outward
from station.kinematics import se3
from station.logs import FloatArray

IntArray = NDArray[np.intp]


def singles(parts: int) -> tuple[Group, ...]:
    """Each part a body of its own."""
    return tuple(Group((k,), se3.identity(1)) for k in range(parts))


def merged(groups: Sequence[Group], edges: IntArray, T_a_b: FloatArray) -> tuple[Group, ...]:
    """Groups that rigid joints connect, made one; mounts are chained along the joints.

    Args:
        groups: bodies so far.
        edges: (E, 2) pairs of groups that are rigid to each other, a forest.
        T_a_b: (E, 4, 4) pose of each pair's second in its first.
    """
    label = components(len(groups), edges)
    return tuple(_merged_group(groups, root, label, edges, T_a_b) for root in sorted(set(label)))


def _merged_group(groups: Sequence[Group], root: int, label: list[int], edges: IntArray, T_a_b: FloatArray) -> Group:
    poses = {root: np.eye(4)}
    for parent, child, edge in outward(root, edges):
        step = T_a_b[edge] if edges[edge, 0] == parent else se3.inverse(T_a_b[edge])
        poses[child] = poses[parent] @ step
    inside = [k for k in range(len(groups)) if label[k] == root]
    members = [part for k in inside for part in groups[k].members]
    mounts = np.concatenate([poses[k] @ groups[k].mounts for k in inside])
    order: list[int] = sorted(range(len(members)), key=members.__getitem__)
    mounts = mounts[order]
    return Group(tuple(members[i] for i in order), se3.inverse(mounts[0]) @ mounts)
