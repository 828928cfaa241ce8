"""Steps that are targets, one after the other: given ones, each joint alone, all together, and random ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from station.errors import InvalidData, LimitExceeded
from station.logs import FloatArray
from station.motion.limits import LIMIT_SLACK, JointLimits, Unit, slow_speeds
from station.motion.segment import Mode, Segment, eased_leg, sent_leg

NOWHERE: Mapping[Unit, float] = {}


@dataclass(frozen=True, slots=True)
class MotionStep:
    """Move some joints to targets, then hold.

    Attributes:
        move: target of each joint that moves, rad or m.
        speed: rad/s or m/s for all of them; None for SLOW, or each joint's own greatest speed if that is less.
        hold_s: rest after the slowest joint has arrived.
        repeat: how often the step is done; before each further time the joints go back to where the step began.
    """

    kind: ClassVar[str] = "move"
    remedy: ClassVar[str] = "change the target"

    move: Mapping[str, float]
    speed: float | None = None
    hold_s: float = 0.0
    repeat: int = 1

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """There, and back and there again for each repetition; streamed at constant speed, or within accelerations."""
        check_names(self.move, joints)
        moved = [joint for joint in joints if joint.name in self.move]
        asked: Mapping[Unit, float] = {} if self.speed is None else {"rad": self.speed, "m": self.speed}
        check_speeds(asked, moved)
        there = np.array([self.move.get(joint.name, q[j]) for j, joint in enumerate(joints)])
        speed = slow_speeds(joints, asked)
        return _legs(q, ([there, q] * self.repeat)[:-1], speed, self.hold_s, joints, mode, smooth=any(
            joint.max_acceleration is not None for joint in moved
        ))  # fmt: skip

    def text(self, joints: Sequence[JointLimits]) -> str:
        return ", ".join(f"{j.name} to {j.text(self.move[j.name])}" for j in joints if j.name in self.move)


# Of the room to either side of the park pose, and rad or m at most: modest, for nothing checks that an arm doesn't hit
# itself.
SHARE = 0.5
AT_MOST: Mapping[Unit, float] = {"rad": float(np.radians(35.0)), "m": 0.08}


@dataclass(frozen=True, slots=True)
class Reach:
    """Which joints of any arm move, and how far: a share of the room to either side of the park pose.

    Attributes:
        share: 0 to 1; 1 reaches the limits.
        at_most: by unit, no further than this from the park pose to either side.
        joints: names of those that move; all if empty.
        skip: names of those that don't; names that the arm doesn't have do no harm.
    """

    share: float = SHARE
    at_most: Mapping[Unit, float] = field(default_factory=lambda: AT_MOST)
    joints: tuple[str, ...] = ()
    skip: tuple[str, ...] = ()

    def ends(self, joints: Sequence[JointLimits], q: FloatArray) -> FloatArray:
        """(2, J) least and greatest state; of joints that don't move, where they are in q (J,).

        Raises:
            InvalidData: a joint that isn't there, or none to move.
        """
        check_names(self.joints, joints)
        ends = np.stack([q, q])
        chosen = [j for j, joint in enumerate(joints) if self._moves(joint)]
        if not chosen:
            raise InvalidData(f"no joint is left to move; the rig has {', '.join(joint.name for joint in joints)}")
        for j in chosen:
            joint = joints[j]
            down, up = joint.park - joint.lower, joint.upper - joint.park
            most = self.at_most.get(joint.unit, AT_MOST[joint.unit])
            ends[:, j] = joint.park - min(self.share * down, most), joint.park + min(self.share * up, most)
        return ends

    def moved(self, joints: Sequence[JointLimits]) -> list[JointLimits]:
        """The joints that move."""
        return [joint for joint in joints if self._moves(joint)]

    def _moves(self, joint: JointLimits) -> bool:
        return joint.name not in self.skip and (not self.joints or joint.name in self.joints)

    def text(self, joints: Sequence[JointLimits]) -> str:
        """From where to where each joint moves."""
        low, high = self.ends(joints, np.array([joint.park for joint in joints]))
        return ", ".join(
            f"{joint.name} {joint.text(low[j])} to {joint.text(high[j])}"
            for j, joint in enumerate(joints)
            if self._moves(joint)
        )


@dataclass(frozen=True, slots=True)
class EachJoint:
    """One joint after the other: to the upper end of its reach, to the lower one, and back to where it was.

    Attributes:
        reach: which joints, and how far.
        speeds: by unit; SLOW where nothing is said.
        hold_s: rest after each leg.
        repeat: how often all of it is done.
    """

    kind: ClassVar[str] = "each_joint"
    remedy: ClassVar[str] = "lower its share"

    reach: Reach = field(default_factory=Reach)
    speeds: Mapping[Unit, float] = field(default_factory=lambda: NOWHERE)
    hold_s: float = 0.0
    repeat: int = 1

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """Three for each joint."""
        low, high = self.reach.ends(joints, q)
        goals: list[FloatArray] = []
        for j in np.flatnonzero(high > low):
            for end in (high[j], low[j], q[j]):
                goals.append(np.where(np.arange(len(q)) == j, end, q))
        return _reach_legs(self, q, goals, joints, mode)

    def text(self, joints: Sequence[JointLimits]) -> str:
        return f"each joint alone: {self.reach.text(joints)}"


@dataclass(frozen=True, slots=True)
class Combined:
    """All joints at once, through poses in which no two of them go together.

    Joint j passes through samples of a sine or cosine, of 1 + j // 2 turns over all poses: over the poses any two
    joints are uncorrelated (the columns of a discrete Fourier transform are orthogonal), so that a fit tells them
    apart. They end where they began.

    Attributes:
        poses: how many; None for as few as it takes, 1 + 2 ceil(J / 2).

    Others as of `EachJoint`.
    """

    kind: ClassVar[str] = "combined"
    remedy: ClassVar[str] = "lower its share"

    reach: Reach = field(default_factory=Reach)
    poses: int | None = None
    speeds: Mapping[Unit, float] = field(default_factory=lambda: NOWHERE)
    hold_s: float = 0.0
    repeat: int = 1

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """One for each pose, and one back."""
        low, high = self.reach.ends(joints, q)
        moving = np.flatnonzero(high > low)
        least = 1 + 2 * ((len(moving) + 1) // 2)
        poses = least if self.poses is None else self.poses
        if poses < least:
            raise InvalidData(f"poses = {poses} don't tell {len(moving)} joints apart; want {least} or more")
        order = np.arange(len(moving))
        turns = np.arange(poses)[:, None] * (1 + order // 2) / poses
        wave = np.sin(2 * np.pi * turns + np.pi / 2 * (order % 2))
        goals = np.tile(q, (poses, 1))
        goals[:, moving] = 0.5 * (low + high)[moving] + 0.5 * (high - low)[moving] * wave
        return _reach_legs(self, q, [*goals, q], joints, mode)

    def text(self, joints: Sequence[JointLimits]) -> str:
        return f"all joints together: {self.reach.text(joints)}"


@dataclass(frozen=True, slots=True)
class Explore:
    """Random poses within reach, all joints at once; the same for the same seed. The arm ends where it began.

    A Latin hypercube (McKay, Beckman, Conover 1979): of n poses each joint has one in each n-th of its reach.

    Attributes:
        poses: how many.
        seed: of the poses.

    Others as of `EachJoint`.
    """

    kind: ClassVar[str] = "explore"
    remedy: ClassVar[str] = "lower its share"

    reach: Reach = field(default_factory=Reach)
    poses: int = 12
    seed: int = 0
    speeds: Mapping[Unit, float] = field(default_factory=lambda: NOWHERE)
    hold_s: float = 0.0
    repeat: int = 1

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """One for each pose, and one back."""
        low, high = self.reach.ends(joints, q)
        rng = np.random.default_rng(self.seed)
        strata = rng.permuted(np.tile(np.arange(self.poses)[:, None], (1, len(q))), axis=0)
        share = (strata + rng.random(strata.shape)) / self.poses
        return _reach_legs(self, q, [*(low + share * (high - low)), q], joints, mode)

    def text(self, joints: Sequence[JointLimits]) -> str:
        return f"{self.poses} random poses (seed {self.seed}): {self.reach.text(joints)}"


def check_names(names: Mapping[str, object] | Sequence[str], joints: Sequence[JointLimits]) -> None:
    """Raise InvalidData for a name that no joint has."""
    known = [joint.name for joint in joints]
    for name in names:
        if name not in known:
            raise InvalidData(f"no joint '{name}'; the rig has {', '.join(known)}")


def check_speeds(speeds: Mapping[Unit, float], joints: Sequence[JointLimits]) -> None:
    """Raise LimitExceeded for a speed that is asked for above a joint's greatest."""
    for joint in joints:
        asked = speeds.get(joint.unit)
        if asked is not None and asked > joint.max_speed * (1 + LIMIT_SLACK):
            raise LimitExceeded(
                f"{joint.name} would move at {joint.text(asked)}/s; its greatest speed is "
                f"{joint.text(joint.max_speed)}/s\n"
                f"lower {joint.key('speed')} of the step, or raise {joint.key('max_speed')} of {joint.name} in the rig"
            )


def _reach_legs(
    step: EachJoint | Combined | Explore,
    q: FloatArray,
    goals: Sequence[FloatArray],
    joints: Sequence[JointLimits],
    mode: Mode,
) -> list[Segment]:
    check_speeds(step.speeds, step.reach.moved(joints))
    speed = slow_speeds(joints, step.speeds)
    return _legs(q, list(goals) * step.repeat, speed, step.hold_s, joints, mode, smooth=True)


def _legs(
    q: FloatArray,
    goals: Sequence[FloatArray],
    speed: FloatArray,
    hold_s: float,
    joints: Sequence[JointLimits],
    mode: Mode,
    *,
    smooth: bool,
) -> list[Segment]:
    """From q to one goal after the other; smooth ones start and end at rest where they are streamed."""
    starts = [q, *goals]
    if mode == "stream" and smooth:
        return [eased_leg(a, b, speed, hold_s, joints) for a, b in zip(starts, goals, strict=False)]
    return [sent_leg(a, b, speed, hold_s) for a, b in zip(starts, goals, strict=False)]
