"""The angle of an emulated shaft as a function of time: motions within limits of speed and acceleration."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drivers.errors import DriverError

HISTORY_NS = 5_000_000_000  # how far back the shaft's angle is known
BEGINNING_NS = -(1 << 62)


@dataclass(frozen=True, slots=True)
class _Segment:
    """Motion of constant acceleration from `t_ns` on."""

    t_ns: int
    rad: float
    rad_s: float
    rad_s2: float

    def at(self, t_ns: int) -> tuple[float, float]:
        """Angle and speed at a time."""
        dt = (t_ns - self.t_ns) * 1e-9
        return self.rad + dt * (self.rad_s + 0.5 * self.rad_s2 * dt), self.rad_s + self.rad_s2 * dt


def plan_motion(rad: float, rad_s: float, goal: float, speed: float, acceleration: float) -> list[tuple[float, float]]:
    """The quickest motion to a goal as [(duration s, acceleration rad/s^2)], from any present speed.

    A speed over the limit is brought down at `acceleration`; a shaft that can't stop before the goal runs past it and
    returns. At the end the shaft stands at the goal.
    """
    stop = rad + rad_s * abs(rad_s) / (2 * acceleration)
    sign = 1.0 if goal >= stop else -1.0
    v, distance = sign * rad_s, sign * (goal - rad)
    peak = min(speed, math.sqrt(max(0.0, acceleration * distance + 0.5 * v * v)))
    first = acceleration if v <= peak else -acceleration
    travelled = (peak * peak - v * v) / (2 * first) + peak * peak / (2 * acceleration)
    cruise = (distance - travelled) / peak if peak > 0 else 0.0
    phases = [((peak - v) / first, first), (max(0.0, cruise), 0.0), (peak / acceleration, -acceleration)]
    return [(duration, sign * a) for duration, a in phases if duration > 0]


def limits_for_duration(
    distance: float, duration: float, ramp: float, max_speed: float, max_acceleration: float
) -> tuple[float, float]:
    """Speed and acceleration of a motion from rest to rest that takes `duration` s, `ramp` s of them to gain speed.

    A motion that the maxima don't allow in that time takes longer.
    """
    distance = abs(distance)
    if duration <= 0 or distance == 0:
        return max_speed, max_acceleration
    ramp = min(ramp, duration / 2)  # e-manual, Profile Acceleration (108): at most 50 % of Profile Velocity (112)
    acceleration = min(distance / (duration - ramp) / ramp if ramp > 0 else math.inf, max_acceleration)
    # distance = v (duration - v / a), the smaller root; no root: it can only be as quick as it can
    root = (acceleration * duration) ** 2 - 4 * acceleration * distance
    speed = (acceleration * duration - math.sqrt(root)) / 2 if root > 0 else math.sqrt(acceleration * distance)
    return min(speed, max_speed), acceleration


class Shaft:
    """The angle of a shaft as a function of time over the last HISTORY_NS, in phases of constant acceleration."""

    def __init__(self, rad: float) -> None:
        self._segments = [_Segment(BEGINNING_NS, rad, 0.0, 0.0)]
        self._starts = [BEGINNING_NS]

    def at(self, t_ns: int) -> tuple[float, float]:
        """Angle (rad) and speed (rad/s); raises DriverError for a time before the history."""
        if t_ns < self._starts[0]:
            raise DriverError(f"the shaft's angle is known for the last {HISTORY_NS * 1e-9:g} s only")
        return self._segment(t_ns).at(t_ns)

    def acceleration(self, t_ns: int) -> float:
        """Acceleration at a time, rad/s^2."""
        return self._segment(t_ns).rad_s2

    def moving(self, t_ns: int) -> bool:
        """Whether the motion that was planned last is still under way."""
        return t_ns < self._starts[-1] or self._segments[-1].rad_s != 0.0

    def next_phase_ns(self, t_ns: int) -> int | None:
        """When the acceleration changes next."""
        index = bisect.bisect_right(self._starts, t_ns)
        return self._starts[index] if index < len(self._starts) else None

    def move(self, t_ns: int, goal: float, speed: float, acceleration: float) -> int:
        """From `t_ns` on, go to a goal, from the speed it has then; returns the number of phases."""
        rad, rad_s = self.at(t_ns)
        phases = plan_motion(rad, rad_s, goal, speed, acceleration)
        self._replace(t_ns, phases, goal)
        return len(phases)

    def spin(self, t_ns: int, rad_s: float, acceleration: float) -> None:
        """From `t_ns` on, come to a speed and keep it."""
        change = rad_s - self.at(t_ns)[1]
        phases = [(abs(change) / acceleration, math.copysign(acceleration, change))] if change else []
        self._replace(t_ns, phases, None, rad_s)

    def brake(self, t_ns: int, acceleration: float) -> None:
        """From `t_ns` on, come to a stop."""
        rad, rad_s = self.at(t_ns)
        if rad_s == 0.0:
            self._replace(t_ns, [], rad)
            return
        sign = math.copysign(1.0, rad_s)
        stop = rad + sign * rad_s * rad_s / (2 * acceleration)
        self._replace(t_ns, [(abs(rad_s) / acceleration, -sign * acceleration)], stop)

    def shift(self, t_ns: int, rad: float) -> None:
        """Move the angle from `t_ns` on by `rad`; what was before stays."""
        here, rad_s = self.at(t_ns)
        now = _Segment(t_ns, here + rad, rad_s, self.acceleration(t_ns))
        after = bisect.bisect_right(self._starts, t_ns)
        later = [replace(segment, rad=segment.rad + rad) for segment in self._segments[after:]]
        self._continue(t_ns, [now, *later])

    def _segment(self, t_ns: int) -> _Segment:
        return self._segments[max(0, bisect.bisect_right(self._starts, t_ns) - 1)]

    def _replace(
        self, t_ns: int, phases: Sequence[tuple[float, float]], end: float | None, end_rad_s: float = 0.0
    ) -> None:
        rad, rad_s = self.at(t_ns)
        start_ns, segments = t_ns, list[_Segment]()
        for duration, acceleration in phases:
            segments.append(_Segment(t_ns, rad, rad_s, acceleration))
            t_end_ns = t_ns + math.ceil(duration * 1e9)
            dt = duration
            rad, rad_s = rad + dt * (rad_s + 0.5 * acceleration * dt), rad_s + acceleration * dt
            t_ns = t_end_ns
        segments.append(_Segment(t_ns, rad if end is None else end, end_rad_s, 0.0))
        self._continue(start_ns, segments)

    def _continue(self, t_ns: int, segments: Sequence[_Segment]) -> None:
        """Replace what is from a time on, and forget what is longer than the history before it."""
        keep_to = bisect.bisect_left(self._starts, t_ns)
        del self._segments[keep_to:], self._starts[keep_to:]
        self._segments.extend(segments)
        self._starts.extend(segment.t_ns for segment in segments)
        forgotten = min(bisect.bisect_right(self._starts, t_ns - HISTORY_NS) - 1, keep_to)
        if forgotten > 0:
            del self._segments[:forgotten], self._starts[:forgotten]
