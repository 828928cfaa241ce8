"""What the joints of an arm may do, and how fast they go where nobody says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from station.logs import FloatArray

Unit = Literal["rad", "m"]
# Rounding of degrees to radians and back must not refuse a target that equals its limit.
LIMIT_SLACK = 1e-9
# rad/s, m/s. Without a speed a joint goes no faster: on the packaged rigs no marker then smears over more than the 4 px
# within 8 ms up to which all are found (docs/motions.md, How fast). That of prismatic joints is an estimate.
SLOW: Mapping[Unit, float] = {"rad": float(np.radians(20.0)), "m": 0.1}


@dataclass(frozen=True, slots=True)
class JointLimits:
    """What one joint may do: angles in rad (positions in m), speed in rad/s (m/s), and where it parks.

    Attributes:
        max_acceleration: rad/s2 (m/s2) that a streamed motion may ask for; None for no limit.
    """

    name: str
    lower: float
    upper: float
    max_speed: float
    park: float = 0.0
    unit: Unit = "rad"
    max_acceleration: float | None = None

    @property
    def slack(self) -> float:
        """By how much rounding may exceed a limit."""
        return LIMIT_SLACK * max(abs(self.lower), abs(self.upper))

    def text(self, value: float) -> str:
        """The value in the units that people write: deg or mm."""
        return f"{np.degrees(value):.1f} deg" if self.unit == "rad" else f"{value * 1e3:.1f} mm"

    def key(self, stem: str) -> str:
        """Name of a key in rig.toml or motion.toml for this joint, such as limits_deg or speed_mm_s."""
        unit = "deg" if self.unit == "rad" else "mm"
        return f"{stem}_{unit}_s" if stem.endswith("speed") else f"{stem}_{unit}"


def slow_speeds(joints: Sequence[JointLimits], asked: Mapping[Unit, float]) -> FloatArray:
    """(J,) speeds at which joints move: as asked for their unit, else SLOW, and never above their own greatest."""
    return np.array([min(joint.max_speed, asked.get(joint.unit, SLOW[joint.unit])) for joint in joints])
