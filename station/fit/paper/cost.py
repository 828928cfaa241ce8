"""The cost of a model's poses against measured ones: the paper's squared distance (16) and its gradient (17, 29).

The gradient is the corrected one of station.kinematics.metric. The paper prints no numbers for the weights c and d.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from station.errors import InvalidData
from station.kinematics import metric, se3
from station.logs import FloatArray

# Model poses and measured poses, (..., 4, 4) each, to costs (...,) and their gradients (..., 6) along right
# perturbations [m, rad] of the model. Near zero the cost is to grow with the square of the distance.
Cost = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]

# Noise per axis of a relative pose of two 2-inch markers half a metre from a webcam, about.
DEFAULT_NOISE_RAD = np.radians(1.0)
DEFAULT_NOISE_M = 0.002
# Of differences of a cost's gradient [m, rad].
CURVATURE_STEP = 1e-4


@dataclass(frozen=True)
class Weights:
    """Weights of (16): `c` of the rotation [1 / rad^2], `d` of the translation [1 / m^2].

    Raises:
        InvalidData: unless both are positive and finite.
    """

    c: float
    d: float

    def __post_init__(self) -> None:
        if not (0 < self.c < np.inf and 0 < self.d < np.inf):
            raise InvalidData(f"weights are c = {self.c:g} and d = {self.d:g}; want both positive and finite")

    @classmethod
    def of_noise(cls, sigma_rad: float, sigma_m: float) -> Weights:
        """The weights with which (16), summed over frames, is -2 log likelihood up to a constant.

        `c = 1 / (2 sigma_rad^2)`, since the squared Frobenius norm is twice the squared angle, and `d = 1 / sigma_m^2`.

        Args:
            sigma_rad: rotation noise per axis of the relative poses of two parts; of independent equal parts it is
                sqrt(2) times that of one.
            sigma_m: their translation noise per axis, which holds the parent's rotation noise times the distance.
        """
        if not (sigma_rad > 0 and sigma_m > 0):
            raise InvalidData(f"noise is {sigma_rad:g} rad and {sigma_m:g} m; want both positive")
        return cls(1 / (2 * sigma_rad**2), 1 / sigma_m**2)


DEFAULT_WEIGHTS = Weights.of_noise(DEFAULT_NOISE_RAD, DEFAULT_NOISE_M)


def weighted_cost(weights: Weights) -> Cost:
    """The paper's squared distance with these weights (`metric.squared_distance`, `metric.twist_gradient`)."""

    def cost(T_model: FloatArray, T_measured: FloatArray) -> tuple[FloatArray, FloatArray]:
        gradient = metric.twist_gradient(T_model, T_measured, c=weights.c, d=weights.d)
        # The gradient is 2d times the shift and -4c times the rotation vector: no second logarithm for the distance.
        shift, turn = np.sum(gradient[..., :3] ** 2, axis=-1), np.sum(gradient[..., 3:] ** 2, axis=-1)
        return shift / (4 * weights.d) + turn / (8 * weights.c), gradient

    return cost


def curvature_of(cost: Cost) -> FloatArray:
    """(6, 6) second derivative of a cost along right perturbations [m, rad] of a model that meets its pose.

    By central differences of the gradient, whose step is exact to rounding for (16): 2d and 4c on the diagonal.
    """
    steps = CURVATURE_STEP * np.concatenate([np.eye(6), -np.eye(6)])
    _, gradient = cost(se3.exp(steps), se3.identity(len(steps)))
    slope = (gradient[:6] - gradient[6:]) / (2 * CURVATURE_STEP)
    return 0.5 * (slope + slope.T)
