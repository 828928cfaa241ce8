"""Noise of simulated poses: a registry of models, each drawn in se(3) and put on the right of a pose.

The paper (IV-C) says that noise is uniform in the Lie algebra se(3), with the magnitudes (eps_T, eps_R). Algorithm 2
contradicts that in three ways, which are mended here:

- Lines 4-5 draw one delta for all parts of a frame. On poses `T_world_part` it would move the whole object and leave
  all poses relative to each other untouched: no noise at all for a learner. Here every pose has its own.
- Line 5 puts it on the left. The paper's x is the inverse of a pose here (its PLACEOBJECTS has `x_b = fk * x_a`, its
  Algorithm 1 `x_b * x_a^-1`), and on the left of that is on the right of `T_world_part`: in the part's own frame, where
  a tracker errs. On the other side a turn would swing a part by its distance from the world's origin, up to 5 m.
- Line 6 moves the root by the noise of its observation, so that the object stands still where nothing is noisy. Here
  the root's steps are drawn apart from the noise, and are in its own frame: on the right of the pose, as printed. Read
  with the x of line 5 they would be on the left, and swing the object about the world's origin.

Line 4 writes `T(v) * R(w)`, the text says se(3): `exp([v, w])` is taken. Both agree to first order in w.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from numbers import Integral, Real
from typing import ClassVar

import numpy as np

from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray

# Of [v, w], what a planar motion has: x, y, and the turn about z.
PLANAR = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 1.0])

# Of any magnitude: with more, poses soon are no numbers.
MOST = 1e6


@dataclass(frozen=True)
class Noise(ABC):
    """How a tracker errs. A new model is a subclass and a line in `NOISE_MODELS`; the tests then cover it.

    Attributes:
        translation_m: magnitude for each axis of the position [m]; what it is of, the model says.
        rotation_rad: magnitude about each axis [rad].

    Raises:
        InvalidData: for a magnitude that is negative or not finite.
    """

    name: ClassVar[str]
    # The frame that poses are told in: "camera" for a model that depends on where the camera is.
    reference: ClassVar[str] = "world"

    translation_m: float = 0.001
    rotation_rad: float = 0.01

    def __post_init__(self) -> None:
        check_magnitude(self.translation_m, "noise of translation", "m")
        check_magnitude(self.rotation_rad, "noise of rotation", "rad")

    @property
    def scale(self) -> FloatArray:
        """(6,) magnitudes of [v (m), w (rad)]."""
        return np.repeat([float(self.translation_m), float(self.rotation_rad)], 3)

    @abstractmethod
    def draws(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """(*shape, n) random numbers for that many poses; they don't depend on the magnitudes."""

    @property
    @abstractmethod
    def variance(self) -> float:
        """Of each of the six numbers for magnitude 1; infinite if it has none."""

    def unit_twists(self, draws: FloatArray) -> FloatArray:
        """(..., 6) noise of magnitude 1 for draws (..., n)."""
        return draws

    def viewed(self, T_world_part: FloatArray) -> FloatArray:
        """(..., T, K, 4, 4) poses in the frame that they are told in: `reference`."""
        return T_world_part

    def apply(self, T_ref_part: FloatArray, draws: FloatArray, *, planar: bool = False) -> FloatArray:
        """(..., 4, 4) poses with the noise of `draws` (..., n) on them; planar: in the part's xy plane alone."""
        return T_ref_part @ se3.exp(self.unit_twists(draws) * self.scale * (PLANAR if planar else 1.0))

    def covariance(self, T_ref_part: FloatArray) -> FloatArray:
        """(..., 6, 6) of the right perturbation [m, rad] of poses (..., 4, 4)."""
        return np.broadcast_to(np.diag(self.variance * self.scale**2), (*T_ref_part.shape[:-2], 6, 6))

    def perturbed(self, T_ref_part: FloatArray, rng: np.random.Generator, *, planar: bool = False) -> FloatArray:
        """(..., 4, 4) the poses as a tracker sees them."""
        return self.apply(T_ref_part, self.draws(rng, T_ref_part.shape[:-2]), planar=planar)


@dataclass(frozen=True)
class UniformNoise(Noise):
    """Uniform in se(3), each of the six numbers between plus and minus its magnitude (paper, IV-C): a box.

    The magnitudes are (eps_T, eps_R) of Algorithm 2; the standard deviations are those by the root of three.
    """

    name = "uniform"

    @property
    def variance(self) -> float:
        return 1 / 3

    def draws(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        return rng.uniform(-1.0, 1.0, (*shape, 6))


@dataclass(frozen=True)
class GaussianNoise(Noise):
    """Normal in se(3); the magnitudes are standard deviations for each axis."""

    name = "gaussian"

    @property
    def variance(self) -> float:
        return 1.0

    def draws(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        return rng.standard_normal((*shape, 6))


@dataclass(frozen=True)
class StudentNoise(Noise):
    """Student's t in se(3), of several variables: now and then a pose is far off in all six numbers.

    The magnitudes are its scale for each axis: of a normal deviation over the root of chi-square by its freedom.

    Attributes:
        freedom: degrees of freedom, 1 or more; the fewer, the heavier the tails: no variance below 3, no mean at 1.

    Raises:
        InvalidData: for magnitudes or degrees of freedom that are none.
    """

    name = "student"

    freedom: int = 3

    def __post_init__(self) -> None:
        Noise.__post_init__(self)
        check_count(self.freedom, "degrees of freedom", 1)

    @property
    def variance(self) -> float:
        return self.freedom / (self.freedom - 2) if self.freedom > 2 else math.inf

    def draws(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        return rng.standard_normal((*shape, 6 + self.freedom))

    def unit_twists(self, draws: FloatArray) -> FloatArray:
        """(..., 6): six normal deviations over the root of the mean square of the others."""
        return draws[..., :6] / np.sqrt(np.mean(draws[..., 6:] ** 2, axis=-1, keepdims=True))


def check_magnitude(value: object, what: str, unit: str) -> None:
    """Raise InvalidData unless the value is a finite number of 0 or more."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InvalidData(f"{what} is {value!r}; want a number of {unit}, 0 or more")
    if not math.isfinite(value) or value < 0:
        raise InvalidData(f"{what} is {float(value):g} {unit}; want a finite number, 0 or more")
    if float(value) > MOST:
        raise InvalidData(f"{what} is {float(value):g} {unit}; want {MOST:g} at most")


def check_count(value: object, what: str, least: int) -> None:
    """Raise InvalidData unless the value is a whole number and no less than the least."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise InvalidData(f"{what}: have {value!r}; want a whole number, {least} or more")


def check_share(value: object, what: str) -> None:
    """Raise InvalidData unless the value is a number from 0 to less than 1."""
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 <= float(value) < 1:
        raise InvalidData(f"share of {what} is {value!r}; want a number from 0 to less than 1")
