"""Whether lengths come out right: fitted lengths of a mechanism against the same ones, known otherwise.

Poses from markers are as long as the markers are said to be: a size that is wrong by a percent makes every fitted
length wrong by a percent, and no angle. Hence lengths that are known: a spindle's lead, the distance of two axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError

FloatArray = NDArray[np.float64]

# A scale is off if it is by more than this many standard deviations and by more than this share.
SIGMAS, LEAST_SHARE = 3.0, 0.005
# rad. Axes nearer to parallel than this have no common normal that is well defined: their distance is a point's.
PARALLEL_RAD = float(np.radians(10.0))


@dataclass(frozen=True)
class KnownLength:
    """A length that was fitted and is known.

    Attributes:
        what: in words.
        ratio: fitted length over the known one.
        std: of the ratio.
    """

    what: str
    ratio: float
    std: float


@dataclass(frozen=True)
class Scale:
    """How much too long all fitted lengths are.

    Attributes:
        ratio: fitted over known, 1.01 for lengths that are 1 % too long.
        std: of the ratio, widened where the lengths disagree.
        lengths: what it comes from.
    """

    ratio: float
    std: float
    lengths: tuple[KnownLength, ...]

    @property
    def off(self) -> bool:
        """Whether the markers' size is wrong beyond chance, by an amount that matters."""
        return abs(self.ratio - 1) > max(SIGMAS * self.std, LEAST_SHARE)

    @property
    def verdict(self) -> str:
        """In words."""
        said = f"lengths are {100 * (self.ratio - 1):+.2f} % off, +- {100 * self.std:.2f} %"
        if self.off:
            way = "too large" if self.ratio > 1 else "too small"
            return (
                f"{said}: measure the markers' black squares (size_mm seems {way}, by a factor of {self.ratio:.4f}), "
                f"the known length, and the camera's calibration"
            )
        if SIGMAS * self.std > LEAST_SHARE:
            return f"{said}: nothing is seen to be wrong, but half a percent would not be seen either"
        return f"{said}: the markers' size is right"


def combine_lengths(lengths: Sequence[KnownLength]) -> Scale:
    """Weighted mean of the ratios; raises CalibrationError without any."""
    if not lengths:
        raise CalibrationError("no length is known; give the distance of two joints' axes, or move a prismatic joint")
    ratio, std = np.array([(length.ratio, length.std) for length in lengths]).T
    if not (np.all(std > 0) and np.all(np.isfinite(ratio))):
        raise CalibrationError("a length without a standard deviation tells no scale")
    weight = std**-2
    mean = float(np.sum(weight * ratio) / np.sum(weight))
    birge = float(np.sum(weight * (ratio - mean) ** 2)) / max(len(lengths) - 1, 1)
    return Scale(mean, float(np.sqrt(max(birge, 1.0) / np.sum(weight))), tuple(lengths))


@dataclass(frozen=True, eq=False)
class Axis:
    """A joint's axis in some body's coordinates.

    Attributes:
        direction: (3,) of unit length.
        point_m: (3,) a point of it.
        direction_std_rad, point_std_m: square roots of the traces over the two degrees of freedom across it.
    """

    direction: FloatArray
    point_m: FloatArray
    direction_std_rad: float
    point_std_m: float


def axis_distance(a: Axis, b: Axis) -> tuple[float, float]:
    """Distance of two axes [m] and its standard deviation.

    Along the common normal; of nearly parallel axes that of b's point from a's axis. The standard deviation takes
    points and directions for independent, each direction with the lever that it has.
    """
    between = b.point_m - a.point_m
    normal = np.cross(a.direction, b.direction)
    sine = float(np.linalg.norm(normal))
    along_a = float(between @ a.direction)
    if sine < np.sin(PARALLEL_RAD):
        across = between - along_a * a.direction
        distance, levers = float(np.linalg.norm(across)), (along_a, 0.0)
    else:
        distance = abs(float(between @ normal)) / sine
        cosine = float(a.direction @ b.direction)
        along_b = float(between @ b.direction)
        # where the common normal meets each axis, from its point
        levers = ((along_a - cosine * along_b) / sine**2, (cosine * along_a - along_b) / sine**2)
    variance = (a.point_std_m**2 + b.point_std_m**2) / 2
    variance += ((levers[0] * a.direction_std_rad) ** 2 + (levers[1] * b.direction_std_rad) ** 2) / 2
    return distance, float(np.sqrt(variance))
