"""The optimiser of Algorithm 1, line 19."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from station.logs import FloatArray

# A function of a step (k,) with its gradient (k,).
Objective = Callable[[FloatArray], tuple[float, FloatArray]]
# An objective and the step (k,) to start from, to the step where it is least.
Optimiser = Callable[[Objective, FloatArray], FloatArray]

# Largest entry of the gradient [1/m, 1/rad] at the end. Over frames a curvature of 1e5 and more adds up: what is left
# is below 1e-6 m and rad.
GRADIENT_TOLERANCE = 0.1
# Iterations at most; most fits take 20 to 100, a prismatic joint's up to 300, along valleys in which it hardly changes.
ITERATIONS = 300


def bfgs(objective: Objective, step: FloatArray) -> FloatArray:
    """BFGS, with SciPy's line search; the paper says no more than "standard function optimization algorithms"."""
    found = minimize(
        objective, step, jac=True, method="BFGS", options={"gtol": GRADIENT_TOLERANCE, "maxiter": ITERATIONS}
    )
    return np.asarray(found.x, dtype=np.float64)
