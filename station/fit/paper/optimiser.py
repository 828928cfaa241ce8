"""The optimiser of Algorithm 1, line 19: what it is asked, and two that answer.

The paper says no more than "standard function optimization algorithms". Both here follow the gradient (17) down from
the starts of Algorithm 1. `scoring` goes by the curvature that the cost itself has, all pairs at once; `bfgs` learns a
curvature from the gradients that it meets, one pair after the other, and takes several times as long to the same
minima.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from station.fit.paper.cost import Cost, curvature_of
from station.fit.paper.joints import PaperJoint
from station.logs import FloatArray

IntArray = NDArray[np.intp]

# A batch of joints of one type to start from, the poses (P, T, 4, 4) of their pairs, and a cost, to the joints with the
# least sums of costs over frames.
Optimiser = Callable[[PaperJoint, FloatArray, Cost], PaperJoint]

# A function of a step (k,) with its gradient (k,).
Objective = Callable[[FloatArray], tuple[float, FloatArray]]
# An objective and the step (k,) to start from, to the step where it is least.
Minimiser = Callable[[Objective, FloatArray], FloatArray]

# A pair is settled when a step promises to lower its cost by less than this share of it, or of 1.
SETTLED = 1e-12
# Steps at most. Joints that explain a motion take 4 to 10, slides more along the valley in which o moves along u; types
# that don't explain it take up to all of them.
STEPS = 300
# Damping is relative to the curvature's diagonal. Some parameters change nothing: it is never none.
DAMPING_START, DAMPING_FALL, DAMPING_RISE, DAMPING_MIN, DAMPING_MAX = 1e-3, 0.1, 10.0, 1e-9, 1e9
# Curvature along a number, as a share of the most along any of the joint's, that is no more than rounding.
TOLD_ABOVE = 1e-14

# Of BFGS: largest entry of the gradient [1/m, 1/rad] at the end. Over frames a curvature of 1e5 and more adds up: what
# is left is below 1e-6 m and rad.
GRADIENT_TOLERANCE = 0.1
# Iterations at most; most fits take 20 to 100, a prismatic joint's up to 300, along valleys in which it hardly changes.
ITERATIONS = 300


@dataclass(frozen=True, eq=False)
class _Place:
    """Joints of P pairs, the sums of their costs (P,), their gradients (P, k) and curvatures (P, k, k)."""

    joint: PaperJoint
    total: FloatArray
    gradient: FloatArray
    curvature: FloatArray

    def with_rows(self, rows: IntArray, some: _Place) -> _Place:
        arrays = [array.copy() for array in (self.total, self.gradient, self.curvature)]
        for array, changed in zip(arrays, (some.total, some.gradient, some.curvature), strict=True):
            array[rows] = changed
        return _Place(self.joint.with_rows(rows, some.joint), *arrays)

    def take(self, rows: IntArray) -> _Place:
        return _Place(self.joint.take(rows), self.total[rows], self.gradient[rows], self.curvature[rows])


def scoring(start: PaperJoint, T_parent_child: FloatArray, cost: Cost) -> PaperJoint:
    """Gauss and Newton's steps by the cost's own curvature (`curvature_of`), with Levenberg and Marquardt's damping.

    Of a joint that has a twin it goes on from there as well, and keeps the better one of the two. What becomes of a
    pair doesn't depend on those beside it.
    """
    found = _descended(start, T_parent_child, cost)
    twin = found.joint.twin
    if twin is None:
        return found.joint
    other = _descended(twin, T_parent_child, cost)
    better = np.flatnonzero(other.total < found.total)
    return found.joint.with_rows(better, other.joint.take(better))


def _descended(start: PaperJoint, T_parent_child: FloatArray, cost: Cost) -> _Place:
    metric = curvature_of(cost)
    place = _at(start, T_parent_child, cost, metric)
    damping = np.full(len(place.total), DAMPING_START)
    left = np.arange(len(place.total))
    for _ in range(STEPS):  # each step starts where the last one ended
        here = place.take(left)
        step, promise = _step(here, damping[left])
        there = _at(here.joint.moved(step), T_parent_child[left], cost, metric)
        better = there.total <= here.total
        place = place.with_rows(left[better], there.take(np.flatnonzero(better)))
        kept = (here.total - there.total) / np.maximum(promise, np.finfo(float).tiny)
        factor = np.where(better, np.clip(1 - (2 * kept - 1) ** 3, DAMPING_FALL, 2.0), DAMPING_RISE)
        damping[left] = np.clip(damping[left] * factor, DAMPING_MIN, DAMPING_MAX)
        left = left[promise > SETTLED * np.maximum(here.total, 1.0)]
        if not left.size:
            break
    return place


def _at(joint: PaperJoint, T_parent_child: FloatArray, cost: Cost, metric: FloatArray) -> _Place:
    q = joint.ik(T_parent_child)
    costs, along_fk = cost(joint.fk(q), T_parent_child)
    J = joint.slopes(T_parent_child, q)
    P, _, T, k = J.shape
    weighed = (metric @ J.reshape(P, 6, T * k)).reshape(P, 6 * T, k)
    J_t = np.swapaxes(J.reshape(P, 6 * T, k), -1, -2)
    along = np.swapaxes(along_fk, -1, -2).reshape(P, 6 * T, 1)
    return _Place(joint, costs.sum(axis=-1), (J_t @ along)[..., 0], J_t @ weighed)


def _step(place: _Place, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Step (P, k), each number in units of its own curvature, and by how much it promises to lower the cost (P,)."""
    square = np.diagonal(place.curvature, axis1=-2, axis2=-1)
    told = square > TOLD_ABOVE * square.max(axis=-1, keepdims=True)
    unit = np.where(told, 1 / np.sqrt(np.where(told, square, 1.0)), 0.0)
    scaled, g = place.curvature * (unit[:, :, None] * unit[:, None, :]), place.gradient * unit
    step = -np.linalg.solve(scaled + damping[:, None, None] * np.eye(g.shape[-1]), g[..., None])
    promise = -np.sum(step[..., 0] * (g + 0.5 * (scaled @ step)[..., 0]), axis=-1)
    return np.asarray(step[..., 0] * unit, dtype=np.float64), np.asarray(promise, dtype=np.float64)


def one_by_one(minimise: Minimiser) -> Optimiser:
    """An optimiser of functions of numbers, which takes one pair after the other."""

    def optimiser(start: PaperJoint, T_parent_child: FloatArray, cost: Cost) -> PaperJoint:
        joints = [start.take(i) for i in range(len(T_parent_child))]
        steps = [
            minimise(objective_of(joint, x, cost), np.zeros(joint.parameters))
            for joint, x in zip(joints, T_parent_child, strict=True)
        ]
        return start.moved(np.stack(steps))

    return optimiser


def objective_of(start: PaperJoint, T_parent_child: FloatArray, cost: Cost) -> Objective:
    """Sum over frames (T, 4, 4) of the cost of fk(ik(x)) against x, of a step away from the joint `start`."""

    def objective(step: FloatArray) -> tuple[float, FloatArray]:
        joint = start.moved(step)
        q = joint.ik(T_parent_child)
        costs, along_fk = cost(joint.fk(q), T_parent_child)
        gradient = np.einsum("ti,itk->k", along_fk, joint.slopes(T_parent_child, q))
        return float(costs.sum()), start.chart(step).T @ gradient

    return objective


def bfgs(objective: Objective, step: FloatArray) -> FloatArray:
    """BFGS, with SciPy's line search."""
    found = minimize(
        objective, step, jac=True, method="BFGS", options={"gtol": GRADIENT_TOLERANCE, "maxiter": ITERATIONS}
    )
    return np.asarray(found.x, dtype=np.float64)
