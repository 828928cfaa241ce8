"""How well the axes of a sweep's cells can be known at all, and what error to expect of that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from station.errors import InvalidData
from station.experiments.fits import simulated
from station.experiments.grid import Cell
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from station.tree_bounds import JointBound, tree_bounds

# Of each Gaussian error: a median over all is then good to a percent.
DRAWS = 501


def cell_bounds(cell: Cell, tree: KinematicTree) -> tuple[JointBound, ...]:
    """Cramer-Rao bounds of the joints of what a cell simulates; none where its noise has no covariance in space.

    They are of Gaussian noise with the covariance that the cell's noise has: see `station.tree_bounds` for what that
    means of another noise. Outliers count as any other pose, though they tell nothing: with them the bound is too low.
    """
    made, options = simulated(cell, tree), cell.options
    if options.planar_noise:
        return ()
    try:
        return tree_bounds(
            made.tree,
            made.truth,
            made.states,
            options.noise.covariance(made.truth.T_ref_part),
            root_moves=options.root == "moving",
            seen=made.log.seen,
        )
    except InvalidData:  # there is no noise, or it has no variance
        return ()


def median_error(covariances: Sequence[FloatArray]) -> float | None:
    """Median length of errors that are Gaussian with these covariances, a share of each; None of none.

    Args:
        covariances: (n, n) each, n > 0; infinite ones count as infinite errors.
    """
    if not covariances:
        return None
    draws = np.random.default_rng(0).standard_normal((DRAWS, len(covariances[0])))
    lengths = [_lengths(covariance, draws) for covariance in covariances]
    return float(np.median(np.concatenate(lengths)))


def _lengths(covariance: FloatArray, draws: FloatArray) -> FloatArray:
    if not np.isfinite(covariance).all():
        return np.full(len(draws), np.inf)
    values, vectors = np.linalg.eigh(covariance)
    return np.linalg.norm(draws * np.sqrt(np.maximum(values, 0.0)) @ vectors.T, axis=-1)
