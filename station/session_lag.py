"""The one lag of a session's camera behind its servos' read-back: told by all joints, applied where it is sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calibration.lag import Slope, estimate_slope, shared_lag
from station.logs import JointLog
from station.pairing import MEASURED_LAG_SPAN_S, Pair

# A lag known to no better than this is not applied: at 40 deg/s it is 0.2 deg, as much as a count of a coarse servo.
WORST_STD_S = 0.005
# Standard deviations. A lag nearer to none than this can't be told from none, and taking it off would only add noise.
LEAST_SIGMAS = 2.0

NO_READBACK = "there is no read-back, and behind steps it is the servos' own"
STILL = "no joint moved enough to tell it"


@dataclass(frozen=True)
class SessionLag:
    """By how much the camera's stamps trail the references', and whether that was taken off.

    Attributes:
        lag_s: the estimate [s], positive where the detection trails; None where nothing tells it.
        std_s: its standard deviation [s]; None where unknown.
        why_not: why it isn't applied, in words; empty where it is.
    """

    lag_s: float | None
    std_s: float | None
    why_not: str = ""

    @property
    def applied_s(self) -> float:
        """What the references are delayed by [s]: zero where the lag isn't sure."""
        return 0.0 if self.why_not or self.lag_s is None else self.lag_s


UNKNOWN = SessionLag(None, None, STILL)


def readback_slopes(detected: JointLog, pairs: Sequence[Pair]) -> dict[str, Slope]:
    """Lag and gain of each pair behind its read-back, where it has one, by the reference's name."""
    return {
        pair.reference.name: estimate_slope(
            detected.t_s, pair.sign * detected.state(pair.fitted), pair.reference.measured, span_s=MEASURED_LAG_SPAN_S
        )
        for pair in pairs
        if pair.reference.has_readback
    }


def estimate_session_lag(slopes: Sequence[Slope]) -> SessionLag:
    """One lag from all joints' lags behind the read-back, with what speaks against applying it."""
    if not slopes:
        return SessionLag(None, None, NO_READBACK)
    shared = shared_lag(slopes)
    if shared is None:
        return UNKNOWN
    lag_s, std_s = shared
    if std_s > WORST_STD_S:
        return SessionLag(lag_s, std_s, f"its std is over {1e3 * WORST_STD_S:.0f} ms")
    if abs(lag_s) < LEAST_SIGMAS * std_s:
        return SessionLag(lag_s, std_s, "it can't be told from none")
    return SessionLag(lag_s, std_s)
