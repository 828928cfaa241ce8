"""All joints, mounts and states of one tree at once, from all its trackers.

A link whose one marker is seen at a bad angle is held by its neighbours: each joint leaves one number a frame free, or
three, instead of six. Least squares on the joints' and mounts' parameters with each frame's states, and the root's
pose if the root moves, eliminated (tree_equations, tree_solver). What hangs from different joints of a root that
stands still shares no number, and is fitted apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.noise import INLIER_ABOVE, time_of_correlation
from station.fit.pairwise import parameter_covariance, small_inverse
from station.fit.skeleton import Skeleton, TreeModel, branches
from station.fit.tree_elimination import FrameStates
from station.fit.tree_motion import tree_poses
from station.fit.tree_problem import Linearised, Problem
from station.fit.tree_residuals import Measured, tree_residuals
from station.fit.tree_solver import Solution, solve, unmoved
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class TreeFit:
    """The refined tree.

    Attributes:
        model: parameters and states.
        covariance: (n, n) of the parameters, in the order of `Skeleton`'s columns.
        state_covariance: (T, s, s) of each joint's states, as `JointType.moved` changes them, but for one constant
            change of all frames alike: where their zero is, is a choice. NaN for states that nothing observed.
        inlier: (T, K) probability that a part's pose is one; 0 unseen.
        spread: (K, 2) deviations of position and orientation that the parts turned out to have, as multiples of what
            was said; about 1 where that and the structure are right, and large where parts move otherwise than the tree
            allows. It is in the covariances already, and in those of the parameters so is the number of frames that
            repeat an error.
    """

    model: TreeModel
    covariance: FloatArray
    state_covariance: tuple[FloatArray, ...]
    inlier: FloatArray
    spread: FloatArray


def refine_tree(
    skeleton: Skeleton, model: TreeModel, measured_of: Callable[[Sequence[int]], Measured], *, move: bool = True
) -> TreeFit:
    """Least squares from a start; poses that don't fit are weighted down as outliers of the scene.

    Args:
        skeleton: joints, bodies and K parts.
        model: parameters and states to start from.
        measured_of: what was measured of some of the parts; asked for branch by branch, as it is large.
        move: False leaves the start as it is, and tells how well it is known.
    """
    T_ref_root, frames = model.T_ref_root, list(model.frames)
    q, mounts, inlier = model.q.copy(), model.mounts.copy(), np.zeros((len(model.q), len(skeleton.body_of)))
    covariance, spread = np.zeros((skeleton.parameters, skeleton.parameters)), np.ones((len(skeleton.body_of), 2))
    state_covariance: list[FloatArray] = [np.zeros((len(q), 0, 0))] * len(skeleton.joints)
    for branch in branches(skeleton):
        fit = _refine_branch(branch.skeleton, branch.model(skeleton, model), measured_of(branch.parts), move=move)
        columns, parts = branch.columns(skeleton), list(branch.parts)
        T_ref_root, covariance[columns[:, None], columns] = fit.model.T_ref_root, fit.covariance
        q[:, branch.state_columns(skeleton)], mounts[parts] = fit.model.q, fit.model.mounts
        inlier[:, parts], spread[parts] = fit.inlier, fit.spread
        for i, j in enumerate(branch.joints):
            frames[j], state_covariance[j] = fit.model.frames[i], fit.state_covariance[i]
    refined = TreeModel(T_ref_root, tuple(frames), q, mounts)
    return TreeFit(refined, covariance, tuple(state_covariance), inlier, spread)


def _refine_branch(skeleton: Skeleton, model: TreeModel, measured: Measured, *, move: bool) -> TreeFit:
    problem = Problem(skeleton, measured)
    problem, solution = solve(problem, model) if move else (problem, unmoved(problem, model))
    measured, scale = problem.measured, _scale(problem, solution)
    covariance = parameter_covariance(solution.last.reduced.H, solution.last.reduced.unreduced) * scale
    covariance *= _repeats(skeleton, measured, solution)
    states = state_covariances(skeleton, solution.last, covariance, scale)
    return TreeFit(solution.model, covariance, states, solution.inlier, np.sqrt(scale) * measured.spread)


def _scale(problem: Problem[Measured], solution: Solution) -> float:
    """Variance of whitened residuals, by the numbers measured less those that were fitted."""
    fitted = problem.skeleton.parameters + solution.last.reduced.observed
    freedoms = float(np.sum(solution.inlier * problem.measured.dimensions)) - fitted
    square = float(np.sum(solution.inlier * solution.chi2))
    return square / freedoms if freedoms > 0 else 1.0


def _repeats(skeleton: Skeleton, measured: Measured, solution: Solution) -> float:
    """Frames in which an error repeats itself: what is shared by all frames is known so much less; at least 1."""
    whitened = tree_residuals(measured, tree_poses(skeleton, solution.model).parts).whitened
    good = solution.inlier > INLIER_ABOVE
    frames, times = good.sum(axis=0), np.ones(len(skeleton.body_of))
    for k in np.flatnonzero(frames):  # memory asks for this loop
        dimensions = measured.dimensions[:, k].max(keepdims=True)
        times[k] = time_of_correlation(whitened[None, :, k], good[None, :, k], dimensions)[0]
    return float(np.sum(frames * times) / max(np.sum(frames), 1))


def state_covariances(
    skeleton: Skeleton, last: Linearised, covariance: FloatArray, scale: float
) -> tuple[FloatArray, ...]:
    """(T, s, s) of each joint's states: their own, and what they share, less its part that is the same in all frames.

    With c_t the change of a frame's states by the parameters' errors, a shift of zero changes all c_t alike. The shift
    that fits best is their mean, weighted by the states' own information; what deviates from it is no choice.
    """
    slices = [skeleton.state_columns(j) for j in range(len(skeleton.joints))]

    def sums(chunk: FrameStates) -> list[tuple[FloatArray, FloatArray]]:
        coupling = chunk.coupling()
        told = [_information(chunk.root[..., c], chunk.told[:, c]) for c in slices]
        return [(W.sum(axis=0), np.einsum("tij,tjn->in", W, coupling[:, c])) for W, c in zip(told, slices, strict=True)]

    found = last.each_chunk(sums)
    totals = [[np.sum([chunk[j][i] for chunk in found], axis=0) for i in (0, 1)] for j in range(len(slices))]
    means: list[FloatArray] = [np.linalg.pinv(W, hermitian=True) @ mean for W, mean in totals]

    def of_chunk(chunk: FrameStates) -> list[FloatArray]:
        coupling, spread = chunk.coupling(), chunk.coupling_times(covariance)
        varying = [coupling[:, c] - mean for c, mean in zip(slices, means, strict=True)]
        spreads = [spread[:, c] - mean @ covariance for c, mean in zip(slices, means, strict=True)]
        shared = [a @ np.swapaxes(b, -1, -2) for a, b in zip(spreads, varying, strict=True)]
        own = [np.swapaxes(chunk.root[..., c], -1, -2) @ chunk.root[..., c] for c in slices]
        both = [chunk.told[:, c, None] & chunk.told[:, None, c] for c in slices]
        return [np.where(told, scale * a + b, np.nan) for a, b, told in zip(own, shared, both, strict=True)]

    chunks = last.each_chunk(of_chunk)
    return tuple(np.concatenate([chunk[j] for chunk in chunks]) for j in range(len(slices)))


def _information(root: FloatArray, told: BoolArray) -> FloatArray:
    """(T, s, s) information of some states with all others free, from the root's columns (T, S, s); 0 if unobserved."""
    own = np.swapaxes(root, -1, -2) @ root
    known: BoolArray = np.all(told, axis=-1, keepdims=True)
    return small_inverse(own) * known[..., None]
