"""Ways through joint space that are no straight lines: what a streamed step follows over time."""

from __future__ import annotations

from typing import Protocol

from station.logs import FloatArray


class Curve(Protocol):
    """States of all J joints over time, from rest to rest, with what they reach at most, by formula."""

    @property
    def duration_s(self) -> float:
        """How long it takes."""
        ...

    def at(self, t_s: FloatArray) -> FloatArray:
        """(..., J) states at times (...,) from its start; before and after it, those of its ends."""
        ...

    def lowest(self) -> FloatArray:
        """(J,) no state is below."""
        ...

    def highest(self) -> FloatArray:
        """(J,) no state is above."""
        ...

    def fastest(self) -> FloatArray:
        """(J,) no joint is faster, rad/s or m/s."""
        ...

    def hardest(self) -> FloatArray:
        """(J,) no joint accelerates more, rad/s2 or m/s2."""
        ...
