"""One register of a control table: its bytes, its range, and what its counts mean."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import DriverError

# Counts. A quantity that is a whole number of counts but for rounding in float64 is that number. Large ones round
# coarser: a product and a quotient of theirs is off by a few units in the last place.
ROUNDING_COUNTS = 1e-9
ROUNDING_ULPS = 8
DIRECTION_BIT, MAGNITUDE = 0x400, 0x3FF  # of sign_magnitude registers


@dataclass(frozen=True, slots=True)
class Unit:
    """`counts` counts are `amount` of `si`.

    Attributes:
        si: "rad", "rad/s", "rad/s^2", "A", "V", "V/s", "degC", "s", or "1": a fraction of the most that there is.
    """

    si: str
    counts: int
    amount: float

    @property
    def per_count(self) -> float:
        """The amount of one count."""
        return self.amount / self.counts


@dataclass(frozen=True, slots=True)
class Register:
    """One register of a control table. Its counts are signed values, of which the bytes are an encoding.

    Attributes:
        size: bytes.
        area: "EEPROM" or "RAM".
        encoding: "unsigned", "twos_complement", or "sign_magnitude" (bit 10 is the direction, set for clockwise).
        initial: value at power-up of a new servo, None where it depends on the servo's state.
        minimum, maximum: what a write may hold; None where the manual names no range, or another register sets it.
        unit: None for codes, flags, gains and other plain numbers.
        zero: the count at which the quantity is zero.
        within: the register whose value bounds this one's magnitude, None where there is none.
    """

    name: str
    address: int
    size: int
    area: str
    writable: bool
    encoding: str = "unsigned"
    initial: int | None = None
    minimum: int | None = None
    maximum: int | None = None
    unit: Unit | None = None
    zero: int = 0
    within: str | None = None

    @property
    def span(self) -> tuple[int, int]:
        """The least and the greatest count that its bytes can hold."""
        if self.encoding == "sign_magnitude":
            return -MAGNITUDE, MAGNITUDE
        bits = 8 * self.size
        if self.encoding == "twos_complement":
            return -(1 << bits - 1), (1 << bits - 1) - 1
        return 0, (1 << bits) - 1

    def encode(self, count: int) -> bytes:
        """Little-endian bytes of a count; raises DriverError if the register can't hold it."""
        low, high = self.span
        if not low <= count <= high:
            raise DriverError(f"{count} doesn't fit in register '{self.name}' ({self.size} B, {low} to {high})")
        if self.encoding == "sign_magnitude" and count < 0:
            count = DIRECTION_BIT - count
        return (count % (1 << 8 * self.size)).to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """The signed count in `size` little-endian bytes."""
        if self.encoding == "sign_magnitude":
            raw = int.from_bytes(data, "little")
            return -(raw & MAGNITUDE) if raw & DIRECTION_BIT else raw & MAGNITUDE
        return int.from_bytes(data, "little", signed=self.encoding == "twos_complement")

    def physical(self, count: float) -> float:
        """The quantity at a count, in the unit's `si`; raises DriverError for a register without unit."""
        unit = self._unit()
        return (count - self.zero) * unit.amount / unit.counts

    def count(self, quantity: float) -> int:
        """The count nearest to a quantity; `count(physical(n))` is n over the whole span."""
        return self.zero + math.floor(self._exact(quantity) + 0.5)

    def count_at_most(self, quantity: float) -> int:
        """The greatest count whose quantity doesn't exceed this one."""
        exact = self._exact(quantity)
        return self.zero + math.floor(exact + _rounding(exact))

    def count_at_least(self, quantity: float) -> int:
        """The least count whose quantity isn't below this one."""
        exact = self._exact(quantity)
        return self.zero + math.ceil(exact - _rounding(exact))

    def _exact(self, quantity: float) -> float:
        """Counts from zero, fractions included."""
        unit = self._unit()
        exact = quantity * unit.counts / unit.amount
        if not math.isfinite(exact):  # of a quantity near float64's end the counts are beyond it
            raise DriverError(f"register '{self.name}' can't hold {quantity} {unit.si}; give a finite number")
        return exact

    def _unit(self) -> Unit:
        if self.unit is None:
            raise DriverError(f"register '{self.name}' holds a plain number, no quantity with a unit")
        return self.unit


def _rounding(exact: float) -> float:
    return max(ROUNDING_COUNTS, ROUNDING_ULPS * math.ulp(exact))
