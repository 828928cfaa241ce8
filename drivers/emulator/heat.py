"""The temperature of an emulated servo: first order, towards what its load would bring it to."""

from __future__ import annotations

import math
from dataclasses import dataclass

# Both are guesses: the manuals have no thermal data. A stalled servo is too hot in a few minutes, as users tell.
FULL_LOAD_RISE_C = 120.0  # over the ambient, after a long time at stall torque; it grows with the load's square
TIME_CONSTANT_S = 300.0
_LEAST_WAIT_NS = 1_000_000  # a crossing that rounding puts into the past is looked for again after this


@dataclass(frozen=True, slots=True)
class Heat:
    """The temperature from `t_ns` on, while the load stays the same."""

    t_ns: int
    temperature_c: float
    target_c: float

    def at(self, t_ns: int) -> float:
        """Temperature at a time, deg C."""
        if self.temperature_c == self.target_c:
            return self.target_c
        decay = math.exp((self.t_ns - t_ns) * 1e-9 / TIME_CONSTANT_S)
        return self.target_c + (self.temperature_c - self.target_c) * decay

    def loaded(self, t_ns: int, load: float, ambient_c: float) -> Heat:
        """The same from `t_ns` on with another load, a part of the stall torque."""
        return Heat(t_ns, self.at(t_ns), ambient_c + FULL_LOAD_RISE_C * load * load)

    def crosses_ns(self, limit_c: float) -> int | None:
        """When it passes a limit, upwards or downwards; None if it won't."""
        start, end = self.temperature_c - limit_c, self.target_c - limit_c
        if start * end >= 0 and not (start == 0 and end > 0):
            return None
        wait_s = TIME_CONSTANT_S * math.log((start - end) / -end)
        return self.t_ns + max(_LEAST_WAIT_NS, math.ceil(wait_s * 1e9))
