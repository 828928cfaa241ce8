"""What can be asked of a simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from station.errors import InvalidData
from station.simulate.motions import MOTIONS
from station.simulate.noise import Noise, UniformNoise, check_magnitude

ROOTS = ("moving", "static")


@dataclass(frozen=True)
class SimulationOptions:
    """How an object moves and how it is watched.

    Attributes:
        frames: number of times.
        inflation: I of the paper's IV-C: I virtual trackers near each part, rigidly attached; K parts become K (1 + I).
        noise: one of `NOISE_MODELS` with its magnitudes.
        motion: key of `MOTIONS`: "walk", Algorithm 2's bounded random walk, or "smooth".
        root: "moving", perturbed at every step, or "static".
        planar: a 2D object: placed, moved and watched in the world's xy plane.
        outliers: share of poses that are replaced by wrong ones.
        missing: share of poses that are not seen.
        rate_hz: frames a second.
        nearby_m: how far from its part a virtual tracker may be along each axis [m].
        root_step_m: largest step of a moving root along each axis [m].
        root_step_rad: largest turn of a moving root about each axis [rad].
        known_noise: whether the log tells the covariance of its noise, as a good tracker does; else it is None.

    Raises:
        InvalidData: for values that can't be, with those that can.
    """

    frames: int = 100
    inflation: int = 0
    noise: Noise = field(default_factory=UniformNoise)
    motion: str = "walk"
    root: str = "moving"
    planar: bool = False
    outliers: float = 0.0
    missing: float = 0.0
    rate_hz: float = 30.0
    nearby_m: float = 0.1
    root_step_m: float = 0.02
    root_step_rad: float = 0.05
    known_noise: bool = False

    def __post_init__(self) -> None:
        _check_count(self.frames, "frames", 1)
        _check_count(self.inflation, "inflation", 0)
        if not isinstance(self.noise, Noise):
            raise InvalidData(f"noise is {self.noise!r}; want a model such as UniformNoise(0.001, 0.01)")
        for name, choices in (("motion", tuple(MOTIONS)), ("root", ROOTS)):
            value = getattr(self, name)
            if value not in choices:
                raise InvalidData(f"{name} '{value}' is unknown; choose one of {', '.join(choices)}")
        for name in ("outliers", "missing"):
            _check_share(getattr(self, name), name)
        for name, unit in (("rate_hz", "Hz"), ("nearby_m", "m"), ("root_step_m", "m"), ("root_step_rad", "rad")):
            check_magnitude(getattr(self, name), name, unit)
        if not self.rate_hz > 0:
            raise InvalidData("rate_hz is 0; want more frames a second")
        if self.planar and self.noise.reference == "camera":
            raise InvalidData("a camera's noise is not planar; choose another noise for a planar object")


def _check_count(value: int, what: str, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InvalidData(f"{what} is {value!r}; want a whole number, {least} or more")


def _check_share(value: float, what: str) -> None:
    check_magnitude(value, f"share of {what}", "1")
    if not value < 1 or math.isnan(value):
        raise InvalidData(f"share of {what} is {value:g}; want 0 or more and less than 1")
