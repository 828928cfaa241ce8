"""The noise of each part of a tree, by what its poses are off and by how they change."""

from __future__ import annotations

import numpy as np

from station.fit.noise import chi2_median
from station.fit.parallel import each
from station.fit.skeleton import TreeModel
from station.fit.tree_elimination import FrameStates
from station.fit.tree_equations import leverages
from station.fit.tree_problem import Linearised, Problem
from station.fit.tree_residuals import Measured
from station.kinematics import se3
from station.logs import FloatArray

# Numbers measured that would tell of a part's noise as much as is known before, and the least share that is left when
# the parameters have taken theirs.
NOISE_PRIOR, LEAST_LEFT = 20.0, 0.1
# Variance of differences of white noise of variance 1: of neighbours, of their differences, and of these.
DIFFERENCED = (2.0, 6.0, 20.0)
MEDIAN = float(chi2_median(np.array(3.0)))

# Exact poses spread by nothing; this, as a factor of what was given, keeps them from dividing by it.
LEAST_SPREAD = 1e-9


def spread_of(problem: Problem[Measured], model: TreeModel, inlier: FloatArray, last: Linearised) -> FloatArray:
    """(K, 2) spread by the residuals: one step of the restricted likelihood, from the spread that there is.

    Numbers that were measured count less what the states of their frames take up, and less an even share of the
    parameters. Where residuals don't tell which part is noisy, all keep their proportions; a part of which they tell
    nothing is as noisy as the others, and if they tell nothing of any, as the orientation of a ball on a short arm, no
    noisier than its changes from frame to frame.

    Args:
        problem: with the spread that there is.
        model: that the residuals are from.
        inlier: (T, K) weights.
        last: equations with these weights.
    """
    K = len(problem.measured.spread)

    def of_chunk(work: tuple[slice, FrameStates]) -> FloatArray:
        rows, held = work
        some, weight = problem.measured.take(rows), inlier[rows][..., None]
        found, taken = leverages(problem.skeleton, model.take(rows), some, held.root)
        left = (np.arange(6) < some.dimensions[..., None]) - np.minimum(weight * taken, 1.0)
        return (weight * np.stack([found**2, np.maximum(left, 0.0)])).reshape(2, -1, K, 2, 3).sum(axis=(1, 4))

    square, freedoms = np.sum(each(of_chunk, list(zip(last.rows, last.held, strict=True))), axis=0)
    freedoms *= max(1 - problem.skeleton.parameters / max(float(freedoms.sum()), 1.0), LEAST_LEFT)
    before = np.ones(2)
    if freedoms[:, 1].sum() < NOISE_PRIOR:
        before[1] = _by_changes(problem.measured)
    usual = (square.sum(axis=0) + NOISE_PRIOR * before) / (freedoms.sum(axis=0) + NOISE_PRIOR)
    found = problem.measured.spread * np.sqrt((square + NOISE_PRIOR * usual) / (freedoms + NOISE_PRIOR))
    return np.maximum(found, LEAST_SPREAD)


def _by_changes(measured: Measured) -> float:
    """Variance of whitened orientations by their changes between neighbouring frames: the motion is in it, at least in
    differences of differences, so that it is a bound; the middle one of all parts.
    """
    found: list[float] = []
    for k in range(len(measured.spread)):  # parts are seen in different frames
        rows = np.flatnonzero(measured.dimensions[:, k] == 6)
        R, W = measured.T_ref_part[rows, k, :3, :3], measured.whitener[rows, k, 3:, 3:] * measured.per_row[k, 3]
        change, least = se3.log_so3(R[1:] @ np.swapaxes(R[:-1], -1, -2)), np.inf
        for variance in DIFFERENCED:
            if not len(change):
                break
            square = np.sum((W[: len(change)] @ change[..., None])[..., 0] ** 2, axis=-1)
            least = min(least, float(np.median(square)) / (variance * MEDIAN))
            change = np.diff(change, axis=0)
        found.append(least)
    known = [x for x in found if np.isfinite(x)]
    return float(np.median(known)) if known else 1.0
