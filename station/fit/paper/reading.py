"""Reads the paper's skeleton as the station holds trees: rooted, with signs and zeros, and the joints' states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.paper.cost import Cost
from station.fit.paper.elimination import Edge, Skeleton
from station.fit.paper.matching import Match
from station.fit.structure import outward
from station.kinematics import se3
from station.kinematics.tree import Joint
from station.logs import FloatArray, PoseLog

IntArray = NDArray[np.intp]


def still_body(parts: PoseLog, skeleton: Skeleton, cost: Cost) -> int:
    """The body whose naming part's poses cost least against their mean, the first of equals."""

    def spread(part: int) -> float:
        T = parts.T_ref_part[:, part]
        mean = se3.pose(se3.project_to_so3(T[:, :3, :3].mean(axis=0)), T[:, :3, 3].mean(axis=0))
        return float(cost(np.broadcast_to(mean, T.shape), T)[0].sum())

    spreads = [spread(group.members[0]) for group in skeleton.groups]
    return int(np.argmin(spreads))


def oriented(skeleton: Skeleton, root: int) -> Skeleton:
    """The skeleton with its edges from the root outward, each after the one that it hangs from."""
    pairs = np.array([(edge.parent, edge.child) for edge in skeleton.edges], dtype=np.intp).reshape(-1, 2)
    edges = [
        skeleton.edges[i] if skeleton.edges[i].parent == a else skeleton.edges[i].inverted()
        for a, _, i in outward(root, pairs)
    ]
    return replace(skeleton, edges=tuple(edges))


@dataclass(frozen=True, eq=False)
class ReadJoint:
    """A joint as the tree holds it, and its states (T,) in the kept frames."""

    joint: Joint
    q: FloatArray


def read_joint(edge: Edge, match: Match, names: Sequence[str], criterion: str) -> ReadJoint:
    """The joint of an edge between bodies of these names, zero in the first frame, its larger excursion positive.

    Its states, residuals and scores are those of the pair of parts that the edge was fitted to.
    """
    first, q = float(match.states[0]), match.states - match.states[0]
    geometry = edge.joint.geometry(first)
    rotation_rad, translation_m = _rms(match)
    joint = Joint(
        name=f"{names[edge.parent]}__{names[edge.child]}",
        type=edge.joint.name,
        parent=names[edge.parent],
        child=names[edge.child],
        axis_parent=geometry.axis_parent,
        point_parent_m=geometry.point_parent_m,
        T_parent_child_zero=geometry.T_parent_child_zero,
        state_min=float(q.min()),
        state_max=float(q.max()),
        scores={"criterion": criterion, **match.scores},
        probability=match.probabilities,
        rms_rotation_rad=rotation_rad,
        rms_translation_m=translation_m,
        frames=len(q),
        outliers=0,
    )
    sign = 1 if q.max() >= -q.min() else -1
    return ReadJoint(joint.with_sign(sign), sign * q)


def _rms(match: Match) -> tuple[float, float]:
    """Root mean squares of the residuals' norms, of rotation [rad] and of translation [m]."""
    T_model = match.joint.fk(match.joint.ik(match.T_parent_child))
    turn = se3.angle(np.swapaxes(T_model[:, :3, :3], -1, -2) @ match.T_parent_child[:, :3, :3])
    shift = T_model[:, :3, 3] - match.T_parent_child[:, :3, 3]
    return float(np.sqrt(np.mean(turn**2))), float(np.sqrt(3 * np.mean(shift**2)))
