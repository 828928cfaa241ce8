"""The scale of each marker's noise, by what its corners are off."""

from __future__ import annotations

import numpy as np

from station.fit.image.corner_data import CornerData
from station.fit.image.views import COORDINATES
from station.fit.parallel import each
from station.fit.skeleton import TreeModel
from station.fit.tree_elimination import FrameStates
from station.fit.tree_equations import moved_by
from station.fit.tree_problem import Problem
from station.fit.tree_solver import Solution
from station.logs import FloatArray

# Coordinates that would tell of a marker's noise as much as the others', and of all as much as what was stated.
NOISE_PRIOR = 20.0
# Share of coordinates that is left at least when the parameters have taken theirs.
LEAST_LEFT = 0.1
# Exact corners spread by nothing; this keeps them from dividing by it.
LEAST_SCALE = 1e-9


def scales_of(problem: Problem[CornerData], solution: Solution) -> FloatArray:
    """(M,) scale by the residuals: one step of the restricted likelihood, from the scale that there is.

    Coordinates count less what the states of their frames take up, and less an even share of the parameters. A marker
    of which little was seen is as noisy as the others.
    """
    skeleton, data, markers = problem.skeleton, problem.measured, len(problem.measured.scale)
    inliers = data.inliers(solution.chi2)

    def of_chunk(work: tuple[slice, FrameStates]) -> FloatArray:
        rows, held = work
        taken = _leverages(problem, solution.model, rows, held.root)
        weight = inliers[rows]
        left = np.maximum(COORDINATES * data.seen[rows] - taken, 0.0)
        return np.stack([weight * solution.chi2[rows], weight * left]).sum(axis=1)

    last = solution.last
    square, freedoms = np.sum(each(of_chunk, list(zip(last.rows, last.held, strict=True))), axis=0).reshape(2, markers)
    freedoms = freedoms * max(1 - skeleton.parameters / max(float(freedoms.sum()), 1.0), LEAST_LEFT)
    usual = (square.sum() + NOISE_PRIOR) / (freedoms.sum() + NOISE_PRIOR)
    found = data.scale * np.sqrt((square + NOISE_PRIOR * usual) / (freedoms + NOISE_PRIOR))
    return np.maximum(found, LEAST_SCALE)


def _leverages(problem: Problem[CornerData], model: TreeModel, rows: slice, root: FloatArray) -> FloatArray:
    """(T, M) how many of each sighting's coordinates its frame's own states take up: trace of B H_ss^-1 B^T.

    B is the derivative by the states, R^T R = H_ss^-1 with R the root (T, s, s).
    """
    skeleton, data, some = problem.skeleton, problem.measured.take(rows), model.take(rows)
    moved = moved_by(skeleton, some)
    _, by = data.derivatives(moved.poses.parts, model.shared, moved.centre)
    taken = np.zeros(data.shape)
    for m, k in enumerate(data.part.tolist()):  # markers differ in what moves them
        twists = moved.bodies[skeleton.body_of[k]]
        R_t = np.ascontiguousarray(np.swapaxes(root[..., twists.states], -1, -2))
        taken[:, m] = np.sum((by[:, m] @ (twists.by_states @ R_t)) ** 2, axis=(-2, -1))
    return taken
