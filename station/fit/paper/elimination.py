"""Rigid subclusters eliminated: parts with rigid joints become one body, and the joints around absorb the offsets.

Table I, in the order of (18-22): an offset prepended multiplies `o` or `c` on its right, one appended `o` or `r` on its
left and turns `u`. With fk = T_parent_child what is prepended is on the child's end, what is appended on the parent's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.bodies import Group
from station.fit.paper.joints import PaperJoint
from station.fit.subclusters import merged, singles
from station.kinematics import se3

IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Edge:
    """A joint from one part to another, or, once rigid joints are eliminated, from one body's naming part to another's.

    `match` is the row of the pair that it was fitted to.
    """

    parent: int
    child: int
    joint: PaperJoint
    match: int

    def inverted(self) -> Edge:
        """The same joint from child to parent."""
        return Edge(self.child, self.parent, self.joint.inverted(), self.match)


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bodies, and the movable joints between their naming (first) parts; ends of edges are bodies here."""

    groups: tuple[Group, ...]
    edges: tuple[Edge, ...]


# Number of parts and the spanning tree's edges, to bodies and movable joints.
Elimination = Callable[[int, Sequence[Edge]], Skeleton]


def eliminate_rigid(parts: int, edges: Sequence[Edge]) -> Skeleton:
    """The tree of bodies of a tree of parts."""
    rigid = [edge for edge in edges if edge.joint.name == "rigid"]
    pairs = np.array([(edge.parent, edge.child) for edge in rigid], dtype=np.intp).reshape(-1, 2)
    T_a_b = np.array([edge.joint.fk(np.zeros(1))[0] for edge in rigid]).reshape(-1, 4, 4)
    groups = merged(singles(parts), pairs, T_a_b)
    place = {part: (body, i) for body, group in enumerate(groups) for i, part in enumerate(group.members)}
    moving = [_absorbed(edge, groups, place) for edge in edges if edge.joint.name != "rigid"]
    return Skeleton(groups, tuple(moving))


def _absorbed(edge: Edge, groups: Sequence[Group], place: dict[int, tuple[int, int]]) -> Edge:
    (a, i), (b, j) = place[edge.parent], place[edge.child]
    joint = edge.joint.with_parent_offset(groups[a].mounts[i])
    return Edge(a, b, joint.with_child_offset(se3.inverse(groups[b].mounts[j])), edge.match)
