"""What can be asked of a simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from station.errors import InvalidData
from station.logs import SHARPEST
from station.simulate.motions import MOTIONS
from station.simulate.noise import Noise, UniformNoise, check_count, check_magnitude, check_share

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
        planar: a 2D object: placed and moved in the world's xy plane. It is watched in space: a fit takes the noise for
            alike in all directions.
        outliers: share of poses that are replaced by wrong ones.
        missing: share of poses that are not seen.
        rate_hz: frames a second.
        nearby_m: how far from its part a virtual tracker may be along each axis [m].
        root_step_m: largest step of a moving root along each axis [m].
        root_step_rad: largest turn of a moving root about each axis [rad].
        known_noise: whether the log tells the covariance of its noise, as a good tracker does; else it is None.
        planar_noise: whether what is seen of a planar object stays in the plane as well, as in the paper's 2D.

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
    planar_noise: bool = False

    def __post_init__(self) -> None:
        check_count(self.frames, "frames", 1)
        check_count(self.inflation, "inflation", 0)
        _check_noise(self.noise)
        for name, choices in (("motion", tuple(MOTIONS)), ("root", ROOTS)):
            value = getattr(self, name)
            if value not in choices:
                raise InvalidData(f"{name} '{value}' is unknown; choose one of {', '.join(choices)}")
        check_share(self.outliers, "outliers")
        check_share(self.missing, "missing poses")
        for name, unit in (("rate_hz", "Hz"), ("nearby_m", "m"), ("root_step_m", "m"), ("root_step_rad", "rad")):
            check_magnitude(getattr(self, name), name, unit)
        if not self.rate_hz > 0:
            raise InvalidData("rate_hz is 0; want some frames a second")
        if self.planar_noise:
            self._check_planar_noise()
        if self.known_noise and not math.isfinite(self.noise.variance):
            raise InvalidData(f"this {self.noise.name} noise has no variance that could be told; leave known_noise out")
        if self.known_noise and not min(self.noise.scale) > SHARPEST:
            raise InvalidData("noise of 0 has no standard deviation that could be told; leave known_noise out")

    def _check_planar_noise(self) -> None:
        if not self.planar:
            raise InvalidData("planar_noise is for planar objects; ask for planar too, or for neither")
        if self.noise.reference == "camera":
            raise InvalidData(f"{self.noise.name} noise is in space; choose another model, or leave planar_noise out")
        if self.known_noise:
            raise InvalidData("noise in a plane has no covariance in space; leave known_noise or planar_noise out")


def _check_noise(noise: object) -> None:
    if not isinstance(noise, Noise):
        raise InvalidData(f"noise is {noise!r}; want a model such as UniformNoise(0.001, 0.01)")
