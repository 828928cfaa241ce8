"""Has enough been seen? How much each joint of an arm moved while its markers were in view, and what to do about it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from station.errors import InvalidData
from station.fit.comparison import MIN_FRAMES
from station.fit.excitation import motion_share
from station.formats.rig import RigTable
from station.formats.simulation import SimulationTable
from station.logs import FloatArray
from station.motion import EachJoint, Explore, JointLimits, Plan, Reach, Step, extended

# Further rounds of random poses have so many, and go to this share of the room and so far (rad, m), in which markers
# come into view that aren't seen about the park pose.
MORE_POSES = 6
MORE_REACH = Reach(share=0.5)


@dataclass(frozen=True)
class Sides:
    """Parts with markers on either side of a joint: of the bodies nearest to it."""

    parent: frozenset[str]
    child: frozenset[str]

    def seen(self, parts: Collection[str]) -> bool:
        """Whether a part of each side is among those."""
        return not self.parent.isdisjoint(parts) and not self.child.isdisjoint(parts)


class MotionTally:
    """How far each joint moved while the camera saw it, so far: cheap enough for every frame.

    A joint's motion counts where parts on both of its sides were seen at once. Of a rig that doesn't say which parts
    those are it counts where any two parts were seen, which may be too much.

    Args:
        joints: J of the arm.
        sides: by joint; None where the rig doesn't say.
    """

    def __init__(self, joints: Sequence[JointLimits], sides: Mapping[str, Sides] | None) -> None:
        self._joints, self._sides = tuple(joints), sides
        self._low, self._high = np.full(len(joints), np.inf), np.full(len(joints), -np.inf)
        self._times = np.zeros(len(joints), dtype=np.int64)

    def add(self, q: FloatArray, parts_seen: Collection[str]) -> None:
        """Count a moment: where the joints are (J,), rad or m, and of which parts markers were seen then."""
        if self._sides is None:
            seen = np.full(len(self._joints), len(parts_seen) >= 2)
        else:
            sides = [self._sides.get(joint.name) for joint in self._joints]
            seen = np.array([side is not None and side.seen(parts_seen) for side in sides], dtype=bool)
        known = seen & np.isfinite(q)
        self._low[known] = np.minimum(self._low, q)[known]
        self._high[known] = np.maximum(self._high, q)[known]
        self._times += known

    @property
    def travel(self) -> FloatArray:
        """(J,) rad or m that was seen."""
        return np.where(self._times > 0, self._high - self._low, 0.0)

    def shares(self) -> dict[str, float | None]:
        """By joint, its motion as a share of what the fit needs, 1 at most; None for one that no marker can show.

        As many sightings as the fit wants frames of a pair are needed, too.
        """
        shares = {
            joint.name: float(min(motion_share(float(travel), joint.unit), int(times) / MIN_FRAMES, 1.0))
            for joint, travel, times in zip(self._joints, self.travel, self._times, strict=True)
        }
        return {name: share if self._shows(name) else None for name, share in shares.items()}

    def _shows(self, joint: str) -> bool:
        side = None if self._sides is None else self._sides.get(joint)
        return self._sides is None or (side is not None and bool(side.parent) and bool(side.child))


def sides_of(table: RigTable) -> dict[str, Sides] | None:
    """Parts with markers on either side of each joint, by the geometry in the rig's [simulation]; None without one."""
    simulation = table.simulation
    if simulation is None:
        return None
    part_of = {marker.id: marker.part for marker in table.marker_table().markers}
    parts: dict[str, set[str]] = {}
    for plate in simulation.plate:
        if plate.id in part_of:
            parts.setdefault(plate.body, set()).add(part_of[plate.id])
    return {
        joint.name: Sides(_above(simulation, parts, joint.parent), _below(simulation, parts, joint.child))
        for joint in simulation.joint
    }


def _above(simulation: SimulationTable, parts: Mapping[str, set[str]], body: str) -> frozenset[str]:
    """The parts of a body, or of the nearest one towards the root that has any."""
    parents = {joint.child: joint.parent for joint in simulation.joint}
    while not parts.get(body) and body in parents:
        body = parents[body]
    return frozenset(parts.get(body, ()))


def _below(simulation: SimulationTable, parts: Mapping[str, set[str]], body: str) -> frozenset[str]:
    """The parts of a body, or of the nearest ones away from the root that have any."""
    if parts.get(body):
        return frozenset(parts[body])
    children = [joint.child for joint in simulation.joint if joint.parent == body]
    return frozenset().union(*(_below(simulation, parts, child) for child in children))


def further_steps(shares: Mapping[str, float | None], done: int) -> tuple[Step, ...]:
    """What shows the joints that lack motion; none if all have enough.

    The first time each of them alone; then, as their markers weren't seen there, random poses of all joints, other
    ones each time.

    Args:
        shares: of `MotionTally`.
        done: how often there were further steps before.
    """
    lacking = tuple(name for name, share in shares.items() if share is not None and share < 1)
    if not lacking:
        return ()
    if done == 0:
        return (EachJoint(Reach(joints=lacking), hold_s=0.3),)
    unseen = tuple(name for name, share in shares.items() if share is None)
    reach = Reach(MORE_REACH.share, MORE_REACH.at_most, skip=unseen)
    return (Explore(reach, poses=MORE_POSES, seed=done, hold_s=0.3),)


def with_enough(plan: Plan, shares: Mapping[str, float | None], done: int) -> Plan | None:
    """The plan with further steps for the joints that lack motion; None if none does, or nothing can be added."""
    steps = further_steps(shares, done)
    if not steps:
        return None
    try:
        return extended(plan, steps)
    except InvalidData:  # it would last longer than a motion may
        return None
