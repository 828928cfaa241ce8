"""What a joint is to the arm: the servos that turn it, its limits, and counts to angles and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from drivers.errors import DriverError
from drivers.servo_models import ServoModel, load_model

Ganging = Literal["software", "secondary_id", "sync_cable"]
Unit = Literal["rad", "m"]


@dataclass(frozen=True)
class ServoConfig:
    """A servo of a joint.

    Attributes:
        zero_count: position count at the joint's zero; the model's zero count if None.
        sign: +1 if the joint's state grows with the count, -1 if it falls (a mirrored servo).
        ratio: turn of the servo for one unit of the joint: rad/rad (a gear), or rad/m (a rack or spindle).
        ganging: how it gets its goals, of a servo that shares the joint with the first one: "software" (its own goal is
            sent to it), "secondary_id" (it takes the first one's), "sync_cable" (its motor follows the first one's).
        reversed: what the reverse bit of its drive mode must be; None for either.
    """

    id: int
    model: str
    zero_count: int | None = None
    sign: int = 1
    ratio: float = 1.0
    ganging: Ganging | None = None
    reversed: bool | None = None

    @property
    def table(self) -> ServoModel:
        """Its model."""
        return load_model(self.model)

    @property
    def zero(self) -> int:
        """Position count at the joint's zero."""
        return self.table.zero_count if self.zero_count is None else self.zero_count

    @property
    def takes_goals(self) -> bool:
        """Whether goals are sent to it."""
        return self.ganging in (None, "software")

    def count(self, q: float) -> int:
        """The position count nearest to a joint state."""
        return self.zero + math.floor(self.sign * self.ratio * q / self.table.rad_per_count + 0.5)

    def q(self, count: int) -> float:
        """The joint state at a position count."""
        return self.sign * (count - self.zero) * self.table.rad_per_count / self.ratio


@dataclass(frozen=True)
class JointConfig:
    """A joint, driven by one servo or by several that are ganged; states in rad, or in m where `unit` says so.

    Raises:
        DriverError: for limits that are no range, and for followers that can't follow.
    """

    name: str
    servos: tuple[ServoConfig, ...]
    lower: float
    upper: float
    max_speed: float
    unit: Unit = "rad"

    def __post_init__(self) -> None:
        if not self.servos:
            raise DriverError(f"joint '{self.name}' has no servo; give it one")
        if any(servo.sign not in (-1, 1) or not servo.ratio > 0 for servo in self.servos):
            raise DriverError(f"joint '{self.name}': the sign of a servo is 1 or -1, its ratio is positive")
        if not self.lower < self.upper:
            raise DriverError(f"joint '{self.name}': limits {self.lower:g} to {self.upper:g} {self.unit} are no range")
        if not self.max_speed > 0:
            raise DriverError(f"joint '{self.name}': the speed limit {self.max_speed:g} {self.unit}/s must be positive")
        leader = self.servos[0]
        if leader.ganging is not None:
            raise DriverError(f"joint '{self.name}': its first servo leads; give ganging to the others only")
        for servo in self.servos[1:]:
            _check_follower(self.name, leader, servo)

    def counts(self, servo: ServoConfig) -> tuple[int, int]:
        """The least and the greatest goal that one of its servos can get."""
        low, high = sorted(servo.count(q) for q in (self.lower, self.upper))
        return low, high

    def text(self, q: float) -> str:
        """A state as people write it: degrees or millimetres."""
        return f"{math.degrees(q):.2f} deg" if self.unit == "rad" else f"{q * 1e3:.2f} mm"


def _check_follower(joint: str, leader: ServoConfig, servo: ServoConfig) -> None:
    who = f"joint '{joint}', servo {servo.id}"
    if servo.ganging is None:
        raise DriverError(f"{who}: a second servo needs ganging: software, secondary_id or sync_cable")
    if servo.ganging == "secondary_id":
        if "secondary_id" not in servo.table.registers:
            raise DriverError(f"{who}: {servo.model} has no secondary id; use ganging = software")
        if servo.model != leader.model:
            raise DriverError(f"{who}: a follower by secondary id is of its leader's model, {leader.model}")
        if (servo.zero, servo.sign, servo.ratio) != (leader.zero, leader.sign, leader.ratio):
            raise DriverError(
                f"{who}: by secondary id it takes the goals of servo {leader.id} count by count; give both the same "
                "zero, sign and gear (the drive mode's reverse bit mirrors it)"
            )
    if servo.ganging == "sync_cable" and not servo.table.sync_cable:
        raise DriverError(f"{who}: {servo.model} has no socket for a sync cable")
