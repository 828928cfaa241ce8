"""Matches the joint types to the relative motion of two parts (paper, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from station.fit.paper.cost import Cost
from station.fit.paper.joints import PaperJoint
from station.fit.paper.optimiser import Objective, Optimiser
from station.fit.paper.steps import PaperSteps
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
) -> Match:
    """Fit every joint type to a pair's poses (T, 4, 4) and score it; `rng` draws the starts' time points."""
    fits = {
        name: fit_joint(steps.starts[name](T_parent_child, rng), T_parent_child, steps.cost, steps.optimiser)
        for name in joint_types
    }
    score = steps.criterion.score
    return Match(
        T_parent_child=T_parent_child,
        joints={name: joint for name, (joint, _) in fits.items()},
        costs={name: total for name, (_, total) in fits.items()},
        scores={name: score(joint, total, len(T_parent_child)) for name, (joint, total) in fits.items()},
    )


def fit_joint(
    start: PaperJoint, T_parent_child: FloatArray, cost: Cost, optimiser: Optimiser
) -> tuple[PaperJoint, float]:
    """The joint of the start's type with the least sum of costs over frames (line 19), and that sum."""
    joint = start.moved(optimiser(objective_of(start, T_parent_child, cost), np.zeros(start.parameters)))
    costs, _ = cost(joint.fk(joint.ik(T_parent_child)), T_parent_child)
    return joint, float(costs.sum())


def objective_of(start: PaperJoint, T_parent_child: FloatArray, cost: Cost) -> Objective:
    """Sum over frames of the cost of fk(ik(x)) against x, of a step away from `start`."""

    def objective(step: FloatArray) -> tuple[float, FloatArray]:
        joint = start.moved(step)
        q = joint.ik(T_parent_child)
        costs, along_fk = cost(joint.fk(q), T_parent_child)
        return float(costs.sum()), start.chart(step).T @ joint.gradient(T_parent_child, q, along_fk)

    return objective
