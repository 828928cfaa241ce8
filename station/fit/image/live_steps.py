"""Least squares of one frame's states on its corners, the tree known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.image.corner_data import CornerData
from station.fit.image.live_chain import Chain
from station.fit.noise import INLIER_ABOVE
from station.fit.skeleton import TreeModel, with_moved_states
from station.fit.tree_equations import equations
from station.fit.tree_motion import tree_poses
from station.kinematics import se3
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

MOST_STEPS = 20
# A step that promises less than this, in squared deviations, is the last one.
SMALL_GAIN = 1e-2
# The same where robust steps follow.
ROUGH_GAIN = 10.0
# Added to the equations: a state that nothing tells stays where it is. Of a deviation of 1 rad, or 1 m.
RIDGE = 1.0
DAMPING_FACTOR, LARGEST_DAMPING = 10.0, 1e6
FIRST_DAMPING = 1e-4  # share of the diagonal, after a step that led nowhere


@dataclass(frozen=True, eq=False)
class Still:
    """A root that stands still, as the frames before tell it.

    Attributes:
        T_ref_root: (4, 4).
        information: (6, 6) of its right perturbation.
    """

    T_ref_root: FloatArray
    information: FloatArray

    def off(self, T_ref_root: FloatArray) -> FloatArray:
        """(6,) right twist from there to a pose (4, 4)."""
        return se3.log(se3.inverse(self.T_ref_root) @ T_ref_root)


@dataclass(frozen=True, eq=False)
class Solved:
    """States of one frame at a minimum.

    Attributes:
        model: the tree there.
        T_ref_part: (K, 4, 4) its parts.
        chi2: (M,) squared residuals of the markers in deviations; 0 unseen.
        inlier: (M,) probability that each is no outlier; 0 unseen.
        cost: -2 log likelihood, with that of the root where it stood.
        information: (s + 6, s + 6) of the states and of the root's right perturbation, with what was known of it, a
            step before.
    """

    model: TreeModel
    T_ref_part: FloatArray
    chi2: FloatArray
    inlier: FloatArray
    cost: float
    information: FloatArray

    @property
    def good(self) -> BoolArray:
        """(M,) seen, and no outlier."""
        return self.inlier > INLIER_ABOVE

    def root_information(self) -> FloatArray:
        """(6, 6) of the root's pose, with the states free."""
        s = len(self.information) - 6
        H = self.information
        return H[s:, s:] - H[s:, :s] @ np.linalg.solve(H[:s, :s] + RIDGE * np.eye(s), H[:s, s:])


def solved(chain: Chain, data: CornerData, start: TreeModel, still: Still | None, *, trusting: bool = True) -> Solved:
    """The minimum that a start leads to.

    Args:
        chain: the tree.
        data: corners of one frame.
        start: its states.
        still: what is known of the root's pose beside; None for nothing.
        trusting: whether no marker is taken for an outlier at first: far from the minimum all look like some.
    """
    at = _Place.of(chain, data, start, still)
    if trusting:
        at, _ = _descended(chain, data, at, still, robust=False)
    at, information = _descended(chain, data, at, still, robust=True)
    inlier = data.inliers(at.chi2)[0]
    return Solved(at.model, at.T_ref_part[0], at.chi2[0], inlier, at.cost(data, robust=True), information)


def _descended(
    chain: Chain, data: CornerData, at: _Place, still: Still | None, *, robust: bool
) -> tuple[_Place, FloatArray]:
    """The minimum near a place, and the second derivatives (n, n) of half the cost a step before it.

    Gauss-Newton steps, damped where one leads uphill; roughly where more steps follow, robust ones.
    """
    damping, enough = 0.0, SMALL_GAIN if robust else ROUGH_GAIN
    information, g = _equations(chain, data, at, still, robust=robust)
    for _ in range(MOST_STEPS):  # a step needs the last
        damped = information + RIDGE * np.eye(len(g)) + np.diag(damping * np.diagonal(information))
        step: FloatArray = -np.asarray(np.linalg.solve(damped, g), dtype=np.float64)
        there = _Place.of(chain, data, with_moved_states(chain.skeleton, at.model, step[None]), still)
        better = there.cost(data, robust=robust) <= at.cost(data, robust=robust)
        at = there if better else at
        if -float(step @ g) < enough or damping > LARGEST_DAMPING:
            break
        damping = damping / DAMPING_FACTOR if better else max(damping * DAMPING_FACTOR, FIRST_DAMPING)
        if better:
            information, g = _equations(chain, data, at, still, robust=robust)
    return at, information


@dataclass(frozen=True, eq=False)
class _Place:
    """A model, its parts (1, K, 4, 4), the squared residuals there (1, M), the root's twist (6,) from where it stood,
    and that in units of what is known of it, squared.
    """

    model: TreeModel
    T_ref_part: FloatArray
    chi2: FloatArray
    off: FloatArray
    off_squared: float

    @staticmethod
    def of(chain: Chain, data: CornerData, model: TreeModel, still: Still | None) -> _Place:
        parts = tree_poses(chain.skeleton, model).parts
        off = np.zeros(6) if still is None else still.off(model.T_ref_root[0])
        off_squared = 0.0 if still is None else float(off @ still.information @ off)
        return _Place(model, parts, data.chi2(parts, model.shared), off, off_squared)

    def cost(self, data: CornerData, *, robust: bool) -> float:
        return float((data.costs(self.chi2) if robust else self.chi2).sum()) + self.off_squared


def _equations(
    chain: Chain, data: CornerData, at: _Place, still: Still | None, *, robust: bool
) -> tuple[FloatArray, FloatArray]:
    """(n, n) second derivatives and (n,) gradient of half the cost by the states and the root's pose.

    The root is near where it stood, so that its twist from there changes by the perturbation itself.
    """
    weights = data.weights(at.chi2) if robust else data.seen.astype(np.float64)
    found = equations(chain.skeleton, at.model, data, weights)
    H, g = found.H_ss[0], found.g_s[0]
    if still is not None:
        H[-6:, -6:] += still.information
        g[-6:] += still.information @ at.off
    return H, g
