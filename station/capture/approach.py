"""Takes the arm to a pose slowly, and tells when it is there, sags there, or does not get there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from drivers.errors import ArmFault
from station.capture.crew import NS_PER_S, TURN_NS, Crew
from station.logs import FloatArray
from station.motion import JointLimits

# Approaching the start and parking: no faster than this (rad/s, m/s), so that a person can step back.
APPROACH_SPEED = {"rad": np.radians(20.0), "m": 0.02}
# A joint within this (rad, m) of its goal has arrived; servos hold to a count or two (0.3 deg each on AX).
ARRIVED = {"rad": np.radians(2.0), "m": 0.002}
# Position control without an integral lets a loaded joint stand off its goal (a count is some 0.7 % of an X servo's
# output): one that has come this near (rad, m) and then moves by less than a share of ARRIVED for so long is there.
SAGGING = {"rad": np.radians(8.0), "m": 0.008}
STILL_SHARE, STILL_S = 0.2, 0.5
# An approach may take this many times as long as at constant speed, plus the extra seconds, before it counts as stuck.
PATIENCE = 1.5
PATIENCE_S = 3.0


def approach(
    crew: Crew,
    joints: Sequence[JointLimits],
    goal: FloatArray,
    most: FloatArray | None = None,
    *,
    heed: Callable[[], bool],
) -> None:
    """Go to a pose slowly and wait until the arm is there.

    Args:
        goal: (J,) rad or m.
        most: (J,) speeds not to be exceeded.
        heed: asked each turn; True where the arm was held meanwhile, so that it must be told again where to go.

    Raises:
        ArmFault: it does not get there.
    """
    speeds = np.array([min(joint.max_speed, APPROACH_SPEED[joint.unit]) for joint in joints])
    speeds = speeds if most is None else np.minimum(speeds, most)
    while not _went(crew, joints, goal, speeds, heed):
        pass


def _went(
    crew: Crew, joints: Sequence[JointLimits], goal: FloatArray, speeds: FloatArray, heed: Callable[[], bool]
) -> bool:
    """Whether the arm went there undisturbed."""
    arm, clock = crew.rig.arm, crew.clock
    arm.set_speeds(speeds)
    arrival = _Arrival(joints, goal, crew.read().q, speeds, clock.now_ns())
    arm.command(goal)
    crew.situation.goal = goal
    while not arrival.is_there(crew.read().q, clock.now_ns()):
        clock.sleep_until_ns(clock.now_ns() + TURN_NS)
        if heed():
            return False
    if arrival.sags:
        crew.journal.warn(f"{arrival.sags}, and stays there: it sags under its load, or something holds it")
    return True


class _Arrival:
    """Looks whether an arm that is on its way to a goal is there."""

    def __init__(
        self, joints: Sequence[JointLimits], goal: FloatArray, q: FloatArray, speeds: FloatArray, now_ns: int
    ) -> None:
        self._joints, self._goal = joints, goal
        units = [joint.unit for joint in joints]
        self._near, self._sagging = (np.array([least[unit] for unit in units]) for least in (ARRIVED, SAGGING))
        patience_s = PATIENCE_S + PATIENCE * float(np.max(np.abs(q - goal) / speeds))
        self._deadline_ns = now_ns + int(NS_PER_S * patience_s)
        self._still_from_ns, self._still_at = now_ns, q
        self.sags = ""

    def is_there(self, q: FloatArray, now_ns: int) -> bool:
        """Whether it has arrived, or come near and stays there (`sags` then says how); raises ArmFault when late."""
        off = np.abs(q - self._goal)
        if np.all(off <= self._near):
            return True
        worst = int(np.argmax(off / self._near))
        joint = self._joints[worst]
        where = f"{joint.name} is {joint.text(q[worst] - self._goal[worst])} from its goal"
        if np.any(np.abs(q - self._still_at) > STILL_SHARE * self._near):
            self._still_from_ns, self._still_at = now_ns, q
        if now_ns - self._still_from_ns > STILL_S * NS_PER_S and np.all(off <= self._sagging):
            self.sags = where
            return True
        if now_ns > self._deadline_ns:
            raise ArmFault(f"{where} and does not get there; is it blocked?", joint=joint.name)
        return False
