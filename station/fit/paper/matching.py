"""Matches the joint types to the relative motions of pairs of parts (paper, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from station.fit.paper.joints import PaperJoint
from station.fit.paper.steps import PaperSteps
from station.fit.parallel import pieces
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray


@dataclass(frozen=True, eq=False)
class Match:
    """The best of each joint type for one pair of parts.

    Attributes:
        T_parent_child: (T, 4, 4) the pair's relative poses.
        joints: by type.
        costs: by type, summed over frames.
        scores: by type, lower is better.
    """

    T_parent_child: FloatArray
    joints: Mapping[str, PaperJoint]
    costs: Mapping[str, float]
    scores: Mapping[str, float]

    @property
    def best(self) -> str:
        """The type with the lowest score (Algorithm 1, line 21); the first of equals."""
        return min(self.scores, key=self.scores.__getitem__)

    @property
    def joint(self) -> PaperJoint:
        """The joint of the best type."""
        return self.joints[self.best]

    @property
    def states(self) -> FloatArray:
        """(T,) states of the best type's joint (line 22), angles without jumps of 2 pi from frame to frame."""
        q = self.joint.ik(self.T_parent_child)
        return np.unwrap(q) if JOINT_TYPES[self.best].unit == "rad" else q

    @property
    def probabilities(self) -> dict[str, float]:
        """exp(-score / 2), normalised over the types."""
        scores = np.array(list(self.scores.values()))
        odds = np.exp(-0.5 * (scores - scores.min()))
        return dict(zip(self.scores, (odds / odds.sum()).tolist(), strict=True))


def match_joints(
    T_parent_child: FloatArray, joint_types: Sequence[str], steps: PaperSteps, rng: np.random.Generator
) -> list[Match]:
    """Fit every joint type to the poses (P, T, 4, 4) of each pair and score it; `rng` draws the starts' time points."""
    starts = [{name: steps.starts[name](x, rng) for name in joint_types} for x in T_parent_child]
    fits = {name: _fitted([of_pair[name] for of_pair in starts], T_parent_child, steps) for name in joint_types}
    return [_match(x, {name: fit[i] for name, fit in fits.items()}, steps) for i, x in enumerate(T_parent_child)]


def _fitted(
    starts: Sequence[PaperJoint], T_parent_child: FloatArray, steps: PaperSteps
) -> list[tuple[PaperJoint, float]]:
    """Joints of the starts' type with the least sums of costs over frames (line 19), and these sums."""
    kind: type[PaperJoint] = type(starts[0])
    found: list[tuple[PaperJoint, float]] = []
    for piece in pieces(*T_parent_child.shape[:2]):  # memory asks for pieces
        rows: list[int] = piece.tolist()
        x = T_parent_child[rows]
        joint = steps.optimiser(kind.batch([starts[i] for i in rows]), x, steps.cost)
        costs, _ = steps.cost(joint.fk(joint.ik(x)), x)
        found += [(joint.take(i), total) for i, total in enumerate(costs.sum(axis=-1).tolist())]
    return found


def _match(T_parent_child: FloatArray, fits: Mapping[str, tuple[PaperJoint, float]], steps: PaperSteps) -> Match:
    score = steps.criterion.score
    return Match(
        T_parent_child=T_parent_child,
        joints={name: joint for name, (joint, _) in fits.items()},
        costs={name: total for name, (_, total) in fits.items()},
        scores={name: score(joint, total, len(T_parent_child)) for name, (joint, total) in fits.items()},
    )
