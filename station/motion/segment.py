"""The legs of a plan: one after the other, each from a pose to a pose, then a rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from station.logs import FloatArray, frozen_floats
from station.motion.curve import Curve
from station.motion.easing import eased_move, eased_share, eased_time
from station.motion.limits import JointLimits

Mode = Literal["step", "stream"]
# A pause repeats the leg that it cut: long curves have one every so many seconds.
LEG_S = 5.0


@dataclass(frozen=True, eq=False, slots=True)
class Segment:
    """One leg of a plan: from q_from to q_to (J,) at speed (J,), which takes move_s, then a rest of hold_s.

    Attributes:
        step: the number of the step that it belongs to, from 1.
        ramp_s: a streamed leg gets up to its speed, and from it to rest, in so long; 0 goes at constant speed.
        curve: what is followed instead of the straight line; several legs may share one.
        curve_from_s: time of the curve at which the leg begins.
        under_way_s: a leg that begins in the middle of its curve gets up to the curve's speed in so long.
    """

    step: int
    t_start_s: float
    q_from: FloatArray
    q_to: FloatArray
    speed: FloatArray
    move_s: float
    hold_s: float
    ramp_s: float = 0.0
    curve: Curve | None = None
    curve_from_s: float = 0.0
    under_way_s: float = 0.0

    @property
    def t_end_s(self) -> float:
        """End of the rest, seconds from the start of the motion."""
        return self.t_start_s + self.move_s + self.hold_s

    def states(self, t_s: FloatArray) -> FloatArray:
        """(..., J) states of a streamed leg at times (...,) from the motion's start."""
        since_s = np.clip(t_s - self.t_start_s, 0.0, self.move_s)
        if self.curve is not None:
            return self.curve.at(self.curve_from_s + eased_time(since_s, self.under_way_s))
        share = eased_share(since_s, np.asarray(self.move_s), np.asarray(self.ramp_s))
        return self.q_from + share[..., None] * (self.q_to - self.q_from)


def sent_leg(q_from: FloatArray, q_to: FloatArray, speed: FloatArray, hold_s: float) -> Segment:
    """A leg at constant speed, until the slowest joint would be there; as a step each joint takes its own time."""
    move_s = float(np.max(np.abs(q_to - q_from) / speed))
    return Segment(0, 0.0, frozen_floats(q_from), frozen_floats(q_to), frozen_floats(speed), move_s, hold_s)


def eased_leg(
    q_from: FloatArray, q_to: FloatArray, speed: FloatArray, hold_s: float, joints: Sequence[JointLimits]
) -> Segment:
    """A streamed leg from rest to rest, within speed (J,) and the joints' accelerations."""
    move_s, ramp_s = eased_move(np.abs(q_to - q_from), speed, accelerations(joints))
    q_from, q_to, speed = (frozen_floats(values) for values in (q_from, q_to, speed))
    return Segment(0, 0.0, q_from, q_to, speed, move_s, hold_s, ramp_s)


def curve_legs(curve: Curve, hold_s: float) -> list[Segment]:
    """The legs along a curve, of some LEG_S each, with a rest after the last one."""
    count = max(1, round(curve.duration_s / LEG_S))
    ends_s = curve.duration_s / count * np.arange(count + 1, dtype=np.float64)
    q, speed = frozen_floats(curve.at(ends_s)), frozen_floats(curve.fastest())
    return [
        Segment(
            0, 0.0, q[k], q[k + 1], speed, float(ends_s[k + 1] - ends_s[k]), hold_s if k == count - 1 else 0.0,
            curve=curve, curve_from_s=float(ends_s[k]),
        )
        for k in range(count)
    ]  # fmt: skip


def accelerations(joints: Sequence[JointLimits]) -> FloatArray:
    """(J,) greatest accelerations; infinite without a limit."""
    return np.array([np.inf if joint.max_acceleration is None else joint.max_acceleration for joint in joints])
