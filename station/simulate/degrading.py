"""What else goes wrong with poses: wrong ones, and frames in which a part is not seen."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.logs import FloatArray
from station.simulate.noise import PLANAR
from station.simulate.options import SimulationOptions

# How far off along each axis a wrong pose may be [m]; its orientation is any.
OUTLIER_M = 0.5
# Two numbers that decide, six of the wrong pose.
NUMBERS = 8


def degrading_draws(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """(*shape, 8) random numbers for that many poses."""
    return rng.uniform(0.0, 1.0, (*shape, NUMBERS))


def degraded(T_ref_part: FloatArray, u: FloatArray, options: SimulationOptions) -> FloatArray:
    """(..., 4, 4) poses, some replaced by wrong ones and some NaN, for draws u (..., 8).

    A share s chooses the poses whose number is below s: more outliers are the same ones and others.
    """
    found = T_ref_part.copy()
    wrong = u[..., 0] < options.outliers
    if wrong.any():
        scale = np.repeat([OUTLIER_M, np.pi], 3) * (PLANAR if options.planar_noise else 1.0)
        v, w = np.split((2 * u[wrong, 2:] - 1) * scale, 2, axis=-1)
        found[wrong] = found[wrong] @ se3.pose(se3.exp_so3(w), v)
    found[u[..., 1] < options.missing] = np.nan
    return found
