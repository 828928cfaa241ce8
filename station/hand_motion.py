"""What a hand does to an arm or an object in a simulation: each joint alone there and back, then all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray
from station.motion import JointLimits, Motion, MotionStep, Plan, plan_motion

# By how far from the park pose (rad, m), at most, to the side with more room; how fast; how long it rests in between.
REACH = {"rad": float(np.radians(35.0)), "m": 0.08}
SPEED = {"rad": float(np.radians(80.0)), "m": 0.15}
REST_S = 0.2
TOGETHER_SHARE = 0.7
# A hand takes hold so long after the simulation has started: programs need time to begin.
AFTER_S = 0.5
# Of an object whose joints nobody has limited.
FREE = {"rad": float(np.radians(60.0)), "m": 0.15}
NS_PER_S = 1e9


@dataclass(frozen=True, eq=False)
class HandMotion:
    """A hand's motion, once or again and again; it begins AFTER_S later than what it moves."""

    plan: Plan
    rounds: int

    @property
    def duration_s(self) -> float:
        """Until the hand lets go."""
        return AFTER_S + self.rounds * self.plan.duration_s

    def pushes(self) -> list[tuple[str, float, float, float]]:
        """Joint, where it is taken (rad or m), at which speed, and when [s], in the order of time."""
        return [
            (joint.name, float(leg.q_to[j]), float(leg.speed[j]), AFTER_S + k * self.plan.duration_s + leg.t_start_s)
            for k in range(self.rounds)
            for leg in self.plan.segments
            for j, joint in enumerate(self.plan.joints)
            if leg.q_to[j] != leg.q_from[j]
        ]

    def states(self, t_s: float) -> FloatArray:
        """(J,) joint states at a time, of an object without friction or weight."""
        since_s = t_s - AFTER_S
        once_s = since_s % self.plan.duration_s if 0 <= since_s < self.rounds * self.plan.duration_s else 0.0
        return self.plan.commanded(once_s)


class HandMovedObject:
    """An object of which a hand moves the joints; without one they stay at zero."""

    def __init__(self, joints: int, motion: HandMotion | None, start_ns: int) -> None:
        self._joints, self._motion, self._start_ns = joints, motion, start_ns

    def joint_states(self, t_ns: int) -> NDArray[np.float64]:
        """(J,) true states, rad or m, at a time of the clock."""
        if self._motion is None:
            return np.zeros(self._joints)
        return self._motion.states((t_ns - self._start_ns) / NS_PER_S)


def hand_motion(limits: Sequence[JointLimits], duration_s: float | None) -> HandMotion:
    """A hand's motion within limits, repeated to last for a duration, else once."""
    ends = {joint.name: _end(joint) for joint in limits}
    parks = {joint.name: joint.park for joint in limits}
    # The last joint first: what it carries may stand before the others' markers.
    steps = [
        MotionStep({joint.name: goal}, SPEED[joint.unit], REST_S)
        for joint in reversed(limits)
        for goal in (ends[joint.name], joint.park)
    ]
    for unit in dict.fromkeys(joint.unit for joint in limits):
        some = {joint.name: joint.park for joint in limits if joint.unit == unit}
        there = {name: park + TOGETHER_SHARE * (ends[name] - park) for name, park in some.items()}
        steps += [MotionStep(goals, SPEED[unit], REST_S) for goals in (there, {name: parks[name] for name in some})]
    by_hand = [JointLimits(j.name, j.lower, j.upper, SPEED[j.unit], j.park, j.unit) for j in limits]
    plan = plan_motion(Motion("by hand", tuple(steps), "stream"), by_hand)
    wanted_s = plan.duration_s if duration_s is None else duration_s
    return HandMotion(plan, max(1, int(np.ceil(wanted_s / plan.duration_s))))


def free_joints(
    units: Mapping[str, str], limits: Mapping[str, tuple[float, float]] | None = None
) -> tuple[JointLimits, ...]:
    """Limits of an object's joints, parked as near to zero as they allow.

    Args:
        units: of all joints, by name.
        limits: least and greatest state (rad, m) of those that have them; the others go one way from zero, as a door
            does.
    """
    ends = {name: (0.0, FREE[unit]) for name, unit in units.items()} | dict(limits or {})
    return tuple(
        JointLimits(name, low, high, SPEED[unit], min(max(0.0, low), high), "m" if unit == "m" else "rad")
        for name, unit in units.items()
        for low, high in [ends[name]]
    )


def _end(joint: JointLimits) -> float:
    up, down = joint.upper - joint.park, joint.park - joint.lower
    reach = REACH[joint.unit]
    return joint.park + min(up, reach) if up >= down else joint.park - min(down, reach)
