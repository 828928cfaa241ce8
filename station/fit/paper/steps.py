"""The steps of the paper's pipeline, each one replaceable (paper, Figure 3 and section III-A)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from station.fit.paper.cost import DEFAULT_WEIGHTS, Cost, weighted_cost
from station.fit.paper.criterion import PAPER_AIC, Criterion
from station.fit.paper.elimination import Elimination, eliminate_rigid
from station.fit.paper.optimiser import Optimiser, scoring
from station.fit.paper.starts import STARTS, Start
from station.fit.structure import LEAST_WEIGHT, spanning_forest
from station.logs import FloatArray, PoseLog
from station.smoothing import smooth

IntArray = NDArray[np.intp]

# A log in which every part has every frame, to another one of the same frames.
Smoothing = Callable[[PoseLog], PoseLog]
# Number of parts, pairs (P, 2) of them, and their scores (P,), to the pairs (rows) that make a tree.
Structure = Callable[[int, IntArray, FloatArray], IntArray]

# The paper states no cut-off of its low-pass filter. This share of the frame rate, 3 Hz of a 30 Hz webcam, is above
# what an arm does that moves slowly enough to be tracked, and leaves sqrt(0.1 / 0.5) = 0.45 of white noise.
CUTOFF_SHARE = 0.1


def low_pass(log: PoseLog, cutoff_share: float = CUTOFF_SHARE) -> PoseLog:
    """The poses through a zero-phase low-pass filter (IV-D) with its cut-off at this share of the frame rate."""
    rate_hz = 1 / float(np.median(np.diff(log.t_s)))
    return smooth(log, cutoff_share * rate_hz)


def unsmoothed(log: PoseLog) -> PoseLog:
    """The poses as they are: for simulated ones, which the paper smooths as little."""
    return log


def spanning_tree(parts: int, pairs: IntArray, scores: FloatArray) -> IntArray:
    """The minimum spanning tree of all pairs (III-A).

    Scores are moved below zero, since only such pairs are edges of the station's forest; the tree stays the same. (A
    score of zero, left as it is, would be no edge for SciPy, and its pair be lost without a word.)
    """
    return spanning_forest(parts, pairs, scores - scores.max() - LEAST_WEIGHT)


@dataclass(frozen=True)
class PaperSteps:
    """What stands in each box of Figure 3; perception is what made the log.

    Attributes:
        smoothing: of the poses, after frames with an unseen part are discarded.
        starts: what each joint type's fit starts from; its keys are the joint types that there are.
        cost: of model poses against measured ones, with its gradient.
        optimiser: of pairs' costs over their joints' parameters.
        criterion: scores the joint types of a pair.
        structure: chooses the pairs that are joined.
        elimination: makes bodies of rigidly joined parts.
        seed: of the random time points of the starts.
    """

    smoothing: Smoothing = low_pass
    starts: Mapping[str, Start] = field(default_factory=lambda: dict(STARTS))
    cost: Cost = weighted_cost(DEFAULT_WEIGHTS)  # noqa: RUF009 (a function, and as such not to be changed)
    optimiser: Optimiser = scoring
    criterion: Criterion = PAPER_AIC
    structure: Structure = spanning_tree
    elimination: Elimination = eliminate_rigid
    seed: int = 0
