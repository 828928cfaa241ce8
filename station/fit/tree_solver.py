"""Least squares on one branch of a tree: Gauss-Newton, damped where it must be, poses that don't fit weighted down.

Frames are worked on in chunks, on all cores; their sums are made in order, so that results don't depend on the cores.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from station.fit.frame_states import with_likely_states
from station.fit.parallel import each
from station.fit.skeleton import Skeleton, TreeModel, with_moved_states, with_parameters
from station.fit.tree_elimination import UNOBSERVED, Eliminated, eliminated
from station.fit.tree_equations import equations, leverages
from station.fit.tree_motion import tree_poses
from station.fit.tree_residuals import Measured, heat_of, inlier_weights, pose_costs, tree_residuals
from station.logs import FloatArray

Found = TypeVar("Found")

ITERATIONS = 25
# Times that states of frames that don't fit are sought anew with better parameters.
ROUNDS = 3
# Settled with the step that promises to change chi squared by less than this: what is left after it is of second order.
SETTLED = 0.1
# Rounds of the parts' noise, and the relative change of a deviation that asks for another.
NOISE_ROUNDS, NOISE_CHANGE = 2, 0.1
# Numbers measured that would tell of a part's noise as much as is known before, and the least share that is left when
# the parameters have taken theirs.
NOISE_PRIOR, LEAST_LEFT = 20.0, 0.1
# Damping is relative; none until a step fails. Below the least it is none again.
DAMPING_FALL, DAMPING_RISE, DAMPING_FIRST, DAMPING_LEAST, DAMPING_MAX = 0.1, 10.0, 1e-3, 1e-5, 1e4
# Numbers in the arrays of one chunk of frames, 8 bytes each. Fewer, and calls cost more than numbers do.
CHUNK_NUMBERS = 2_500_000
# Numbers of couplings that are kept between the uses of a linearisation, 8 bytes each; the rest is made anew.
HELD_NUMBERS = 20_000_000


@dataclass(frozen=True, eq=False)
class Problem:
    """A branch and what was measured of it, in chunks of frames."""

    skeleton: Skeleton
    measured: Measured

    @property
    def chunks(self) -> list[slice]:
        """Frames that are worked on at once."""
        T, K = self.measured.seen.shape
        n, s = self.skeleton.parameters, self.skeleton.states
        size = max(CHUNK_NUMBERS // (200 * K + (s + 20) * (n + s)), 1)
        return [slice(start, min(start + size, T)) for start in range(0, T, size)]

    def chi2(self, model: TreeModel) -> FloatArray:
        """(T, K) whitened squared residuals."""

        def of_chunk(rows: slice) -> FloatArray:
            poses = tree_poses(self.skeleton, model.take(rows))
            return tree_residuals(self.measured.take(rows), poses.parts).chi2

        return np.concatenate(each(of_chunk, self.chunks))

    def linearised(self, model: TreeModel, inlier: FloatArray, damping: float) -> Linearised:
        """Equations at a model, poses weighted by `inlier` (T, K)."""

        def of_chunk(rows: slice) -> Eliminated:
            found = equations(self.skeleton, model.take(rows), self.measured.take(rows), inlier[rows])
            return eliminated(self.skeleton, found, damping)

        def of_chunk_if_it_fits(rows: slice) -> Eliminated:
            found = of_chunk(rows)
            numbers = sum(Z[0].size for Z in found.Z)
            return found if rows.stop * numbers <= HELD_NUMBERS else replace(found, Z=())

        found = each(of_chunk_if_it_fits, self.chunks)
        return Linearised(
            H=np.sum([f.H for f in found], axis=0),
            g=np.sum([f.g for f in found], axis=0),
            unreduced=np.sum([f.unreduced for f in found], axis=0),
            promise=float(np.sum([f.promise for f in found])),
            observed=float(np.sum([f.observed for f in found])),
            damping=damping,
            rows=tuple(self.chunks),
            held=tuple(found),
            again=of_chunk,
        )

    def spread_of(self, solution: Solution) -> FloatArray:
        """(K, 2) spread by the residuals: one step of the restricted likelihood, from the spread that there is.

        Numbers that were measured count less what the states of their frames take up, and less an even share of the
        parameters. Where residuals don't tell which part is noisy, all keep their proportions.
        """
        K = len(self.measured.spread)

        def of_chunk(work: tuple[slice, Eliminated]) -> FloatArray:
            rows, held = work
            some, weight = self.measured.take(rows), solution.inlier[rows][..., None]
            found, taken = leverages(self.skeleton, solution.model.take(rows), some, held.root)
            left = (np.arange(6) < some.dimensions[..., None]) - np.minimum(weight * taken, 1.0)
            return (weight * np.stack([found**2, np.maximum(left, 0.0)])).reshape(2, -1, K, 2, 3).sum(axis=(1, 4))

        square, freedoms = np.sum(each(of_chunk, list(zip(self.chunks, solution.last.held, strict=True))), axis=0)
        left = max(1 - self.skeleton.parameters / max(float(freedoms.sum()), 1.0), LEAST_LEFT)
        return self.measured.spread * np.sqrt((square + NOISE_PRIOR) / (freedoms * left + NOISE_PRIOR))


@dataclass(frozen=True, eq=False)
class Linearised:
    """Equations of all frames.

    Attributes:
        H: (n, n) of the parameters, states eliminated.
        g: (n,).
        unreduced: (n,) diagonal of H before the states were eliminated.
        promise: half of what the states alone promise to take off the weighted squared residuals.
        observed: numbers of states that were observed, over all frames.
        damping: relative, that they were made with.
        rows: frames of each chunk.
        held: eliminated states of each chunk.
        again: makes those of which not all was kept.
    """

    H: FloatArray
    g: FloatArray
    unreduced: FloatArray
    promise: float
    observed: float
    damping: float
    rows: Sequence[slice]
    held: Sequence[Eliminated]
    again: Callable[[slice], Eliminated]

    def each_chunk(self, function: Callable[[Eliminated], Found]) -> list[Found]:
        """Results of a function of the eliminated states of each chunk."""

        def of_chunk(work: tuple[slice, Eliminated]) -> Found:
            rows, held = work
            return function(held if held.Z else self.again(rows))

        return each(of_chunk, list(zip(self.rows, self.held, strict=True)))

    def step(self) -> FloatArray:
        """(n,) change of the parameters; their columns are scaled so that one damping suits metres and radians."""
        scale = 1 / np.sqrt(np.where(self.unreduced > 0, self.unreduced, 1.0))
        scaled = self.H * np.outer(scale, scale) + (self.damping + UNOBSERVED) * np.eye(len(scale))
        return -scale * np.linalg.solve(scaled, scale * self.g)

    def states_step(self, step: FloatArray) -> FloatArray:
        """(T, s) best change of the states for a change of the parameters."""
        return np.concatenate(self.each_chunk(lambda chunk: chunk.states_step(step)))


@dataclass(frozen=True, eq=False)
class Solution:
    """Where least squares ended.

    Attributes:
        model: parameters and states.
        chi2: (T, K) whitened squared residuals.
        inlier: (T, K) probability that a pose is no outlier.
        last: equations, of a point as near to the end as makes no difference.
    """

    model: TreeModel
    chi2: FloatArray
    inlier: FloatArray
    last: Linearised


def solve(problem: Problem, model: TreeModel) -> tuple[Problem, Solution]:
    """The likeliest parameters and states; and the problem with the noise that each part turned out to have."""
    solution = _settled(problem, model)
    for _ in range(NOISE_ROUNDS):  # better weights may tell the noise better
        spread = problem.spread_of(solution)
        change = np.abs(np.log(spread / problem.measured.spread))
        if not np.any(change > NOISE_CHANGE):
            break
        problem = replace(problem, measured=replace(problem.measured, spread=spread))
        solution = _settled(problem, solution.model)
    return problem, solution


def _settled(problem: Problem, model: TreeModel) -> Solution:
    """All refined together; where frames don't fit then, their states sought anew, and again."""
    solution = _refined(problem, model)
    for _ in range(ROUNDS):  # better parameters may tell better states, and these better parameters
        heat = heat_of(problem.measured, solution.chi2)
        hot = problem.measured.hotter(heat)
        likely = with_likely_states(problem.skeleton, solution.model, hot, solution.chi2 / heat)
        if likely is solution.model:
            break
        solution = _refined(problem, likely)
    return solution


def _refined(problem: Problem, model: TreeModel) -> Solution:
    """Damped Gauss-Newton from a start."""
    skeleton, chi2, damping = problem.skeleton, problem.chi2(model), 0.0
    for left in reversed(range(ITERATIONS)):  # each step starts where the last one ended
        heat = heat_of(problem.measured, chi2)
        hot = problem.measured.hotter(heat)
        inlier = inlier_weights(hot, chi2 / heat)
        last = replace(problem, measured=hot).linearised(model, inlier, damping)
        step = last.step()
        promise = 2 * last.promise - float(last.g @ step)
        tried = with_moved_states(skeleton, with_parameters(skeleton, model, step), last.states_step(step))
        tried_chi2 = problem.chi2(tried)
        better = np.sum(pose_costs(hot, tried_chi2 / heat) - pose_costs(hot, chi2 / heat)) <= 0
        if better:
            model, chi2 = tried, tried_chi2
        if promise <= SETTLED or not left:
            break
        if better:
            damping = damping * DAMPING_FALL if damping > DAMPING_LEAST else 0.0
        else:
            damping = min(max(damping * DAMPING_RISE, DAMPING_FIRST), DAMPING_MAX)
    return Solution(model, chi2, inlier, last if damping == 0 else problem.linearised(model, inlier, 0.0))
