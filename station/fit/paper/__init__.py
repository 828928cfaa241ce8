"""The paper's method, step by step, each step replaceable (paper, Figure 3)."""

from __future__ import annotations

from station.fit.paper.cost import Weights, weighted_cost
from station.fit.paper.criterion import PAPER_AIC, Criterion
from station.fit.paper.pipeline import learn_paper
from station.fit.paper.steps import PaperSteps, low_pass, unsmoothed

__all__ = [
    "PAPER_AIC",
    "Criterion",
    "PaperSteps",
    "Weights",
    "learn_paper",
    "low_pass",
    "unsmoothed",
    "weighted_cost",
]
