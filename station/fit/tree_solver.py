"""Least squares on one branch of a tree: Gauss-Newton, damped where it must be, poses that don't fit weighted down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.frame_states import with_likely_states
from station.fit.skeleton import TreeModel, with_moved_states, with_parameters
from station.fit.tree_noise import spread_of
from station.fit.tree_problem import Data, Linearised, Problem
from station.fit.tree_residuals import Measured
from station.logs import FloatArray

IntArray = NDArray[np.intp]

STEPS = 25
# Times that states of frames that don't fit are sought anew with better parameters.
ROUNDS = 3
# Settled with the step that promises to change chi squared by less than this: what is left after it is of second order.
SETTLED = 0.1
# It is near enough for the noise to be told by what is left, and for states to be sought anew.
NEAR = 30.0
# A frame that a step makes dearer by more, in -2 log likelihood, is looked into.
DEARER = 1.0
# Rounds of the parts' noise, and the relative change of a deviation that asks for another.
NOISE_ROUNDS, NOISE_CHANGE = 3, 0.1
# Damping is relative; none until a step fails. Below the least it is none again.
DAMPING_FALL, DAMPING_RISE, DAMPING_FIRST, DAMPING_LEAST, DAMPING_MAX = 0.1, 10.0, 1e-3, 1e-5, 1e4


# Problem, model before a step, model after it, frames: the model after it with better states in these.
Mended = Callable[[Problem[Data], TreeModel, TreeModel, IntArray], TreeModel]


@dataclass(frozen=True, eq=False)
class Solution:
    """Where least squares ended.

    Attributes:
        model: parameters and states.
        chi2: (T, C) whitened squared residuals.
        inlier: (T, C) probability that each is no outlier.
        last: equations, of a point as near to the end as makes no difference.
        settled: whether the last step promised next to nothing.
    """

    model: TreeModel
    chi2: FloatArray
    inlier: FloatArray
    last: Linearised
    settled: bool


def solve(problem: Problem[Measured], model: TreeModel) -> tuple[Problem[Measured], Solution]:
    """The likeliest parameters and states; and the problem with the noise that each part turned out to have."""
    solution = _settled(problem, model, NEAR)
    for _ in range(NOISE_ROUNDS):  # better weights may tell the noise better
        spread = spread_of(problem, solution.model, solution.inlier, solution.last)
        change = np.abs(np.log(spread / problem.measured.spread))
        if not np.any(change > NOISE_CHANGE):
            break
        problem = replace(problem, measured=replace(problem.measured, spread=spread))
        solution = refined(problem, solution.model, steps=1)  # it tells the noise as well as where it would settle
    return problem, _settled(problem, solution.model, SETTLED)


def unmoved(problem: Problem[Measured], model: TreeModel) -> Solution:
    """A model as it is, as if it were where least squares ended."""
    chi2 = problem.chi2(model)
    inlier = problem.measured.weights(chi2)
    return Solution(model, chi2, inlier, problem.linearised(model, inlier, 0.0), settled=True)


def _settled(problem: Problem[Measured], model: TreeModel, enough: float) -> Solution:
    """All refined together; where frames don't fit then, their states sought anew, and again."""
    solution = refined(problem, model, enough=enough)
    for _ in range(ROUNDS):  # better parameters may tell better states, and these better parameters
        heat = problem.measured.heat(solution.chi2)
        hot = problem.measured.hotter(heat)
        likely = with_likely_states(problem.skeleton, solution.model, hot, solution.chi2 / heat)
        if likely is solution.model:
            break
        solution = refined(problem, likely, enough=enough)
    return solution


def refined(
    problem: Problem[Data],
    model: TreeModel,
    mended: Mended[Data] | None = None,
    *,
    steps: int = STEPS,
    enough: float = SETTLED,
) -> Solution:
    """Damped Gauss-Newton from a start.

    Args:
        problem: a branch and what was measured.
        model: where to start.
        mended: has the states of frames (n,) sought anew, which a step made dearer: given the problem, the model before
            the step, and after. A step goes too far in a few frames long before it does in all.
        steps: at most.
        enough: settled with the step that promises to change chi squared by no more.
    """
    skeleton, data, chi2, damping = problem.skeleton, problem.measured, problem.chi2(model), 0.0
    while True:
        heat = data.heat(chi2)
        hot = data.hotter(heat)
        inlier = hot.weights(chi2 / heat)
        last = replace(problem, measured=hot).linearised(model, inlier, damping)
        step = last.step()
        promise = 2 * last.reduced.promise - float(last.reduced.g @ step)
        tried = with_moved_states(skeleton, with_parameters(skeleton, model, step), last.states_step(step))
        tried_chi2 = problem.chi2(tried)
        if mended is not None:
            rows = np.flatnonzero(np.sum(hot.costs(tried_chi2 / heat) - hot.costs(chi2 / heat), axis=-1) > DEARER)
            if rows.size:
                tried = mended(replace(problem, measured=hot), model, tried, rows)
                tried_chi2 = problem.chi2(tried)
        dearer = float(np.sum(hot.costs(tried_chi2 / heat) - hot.costs(chi2 / heat)))
        better = dearer + problem.prior.cost(tried.shared) - problem.prior.cost(model.shared) <= 0
        if better:
            model, chi2 = tried, tried_chi2
        settled, steps = promise <= enough and damping <= DAMPING_LEAST, steps - 1
        if settled or not steps:
            break
        damping = _damping(damping, better=better)
        del last  # the largest of all; there is no room for two
    last = last if damping == 0 else problem.linearised(model, inlier, 0.0)
    return Solution(model, chi2, inlier, last, settled)


def _damping(damping: float, *, better: bool) -> float:
    """The next step's: more after one that made nothing better."""
    if not better:
        return min(max(damping * DAMPING_RISE, DAMPING_FIRST), DAMPING_MAX)
    return damping * DAMPING_FALL if damping > DAMPING_LEAST else 0.0
