"""Scripted motions: from steps to commanded joint states over time, checked against the joints' limits as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from station.errors import InvalidData, LimitExceeded
from station.logs import FloatArray, check_slugs, frozen_floats

Mode = Literal["step", "stream"]
Unit = Literal["rad", "m"]
DEFAULT_RATE_HZ = 50.0
# Rounding of degrees to radians and back must not refuse a target that equals its limit.
LIMIT_SLACK = 1e-9


@dataclass(frozen=True, slots=True)
class JointLimits:
    """What one joint may do: angles in rad (positions in m), speed in rad/s (m/s), and where it parks."""

    name: str
    lower: float
    upper: float
    max_speed: float
    park: float = 0.0
    unit: Unit = "rad"

    def text(self, value: float) -> str:
        """The value in the units that people write: deg or mm."""
        return f"{np.degrees(value):.1f} deg" if self.unit == "rad" else f"{value * 1e3:.1f} mm"

    def key(self, stem: str) -> str:
        """Name of a key in rig.toml or motion.toml for this joint, such as limits_deg or speed_mm_s."""
        unit = "deg" if self.unit == "rad" else "mm"
        return f"{stem}_{unit}_s" if stem.endswith("speed") else f"{stem}_{unit}"


@dataclass(frozen=True, slots=True)
class MotionStep:
    """Move some joints to targets, then hold.

    Attributes:
        move: target of each joint that moves, rad or m.
        speed: rad/s or m/s for all of them; None for each joint's own greatest speed.
        hold_s: rest after the slowest joint has arrived.
        repeat: how often the step is done; before each further time the joints go back to where the step began.
    """

    move: Mapping[str, float]
    speed: float | None = None
    hold_s: float = 0.0
    repeat: int = 1


@dataclass(frozen=True, slots=True)
class Motion:
    """A scripted motion.

    Attributes:
        mode: "step" sends each target at once and lets the servo limit its speed, as in the paper (IV-D);
            "stream" sends targets interpolated at `rate_hz`.
    """

    name: str
    steps: tuple[MotionStep, ...]
    mode: Mode = "step"
    rate_hz: float = DEFAULT_RATE_HZ


@dataclass(frozen=True, eq=False, slots=True)
class Segment:
    """One leg of a plan: from q_from to q_to (J,) at speed (J,), which takes move_s, then a rest of hold_s."""

    step: int
    t_start_s: float
    q_from: FloatArray
    q_to: FloatArray
    speed: FloatArray
    move_s: float
    hold_s: float

    @property
    def t_end_s(self) -> float:
        """End of the rest, seconds from the start of the motion."""
        return self.t_start_s + self.move_s + self.hold_s


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A motion laid out in time for given joints: what will be commanded when.

    Attributes:
        joints: J limits, in the order of all arrays.
        segments: in time order, without gaps, from t = 0.
    """

    motion: Motion
    joints: tuple[JointLimits, ...]
    segments: tuple[Segment, ...]

    @property
    def duration_s(self) -> float:
        """Time from the first command to the end of the last rest."""
        return self.segments[-1].t_end_s

    @property
    def park(self) -> FloatArray:
        """(J,) pose in which the motion starts."""
        return frozen_floats([joint.park for joint in self.joints])

    def command_times_s(self) -> FloatArray:
        """(N,) times at which a command is sent: at each segment, and at rate_hz while a streamed one moves."""
        if self.motion.mode == "step":
            return frozen_floats([segment.t_start_s for segment in self.segments])
        return frozen_floats(np.unique(np.concatenate([self._ticks(segment) for segment in self.segments])))

    def _ticks(self, segment: Segment) -> FloatArray:
        count = int(np.ceil(segment.move_s * self.motion.rate_hz)) + 1
        ticks = segment.t_start_s + np.arange(count) / self.motion.rate_hz
        return ticks[ticks <= segment.t_end_s]

    def commanded(self, t_s: ArrayLike) -> FloatArray:
        """Commanded states (..., J), rad or m, at times (...,) from the start; the park pose before it."""
        t = np.asarray(t_s, dtype=np.float64)
        index = self.segment_index(t)
        q_from, q_to = (np.stack([getattr(s, name) for s in self.segments])[index] for name in ("q_from", "q_to"))
        share = self._share(t, index)[..., None]
        return np.where((t < self.segments[0].t_start_s)[..., None], self.park, q_from + share * (q_to - q_from))

    def segment_index(self, t_s: ArrayLike) -> NDArray[np.intp]:
        """Index (...,) of the segment that is under way at times (...,) from the start; 0 before it."""
        starts = [segment.t_start_s for segment in self.segments]
        return np.maximum(np.searchsorted(starts, np.asarray(t_s), side="right") - 1, 0)

    def _share(self, t: FloatArray, index: NDArray[np.intp]) -> FloatArray:
        if self.motion.mode == "step":
            return np.ones_like(t)
        start_s = np.array([segment.t_start_s for segment in self.segments])[index]
        move_s = np.array([segment.move_s for segment in self.segments])[index]
        return np.clip((t - start_s) / np.where(move_s > 0, move_s, 1.0), 0.0, 1.0)


def plan_motion(motion: Motion, joints: Sequence[JointLimits]) -> Plan:
    """Lay out a motion in time, from the park pose, and check all of it.

    A step lasts until its slowest joint would arrive at constant speed, then rests for hold_s.

    Raises:
        InvalidData: a motion without steps, or one that moves a joint that isn't there.
        LimitExceeded: a target outside a joint's limits or a speed above its greatest, with the step and the time.
    """
    check_slugs([joint.name for joint in joints], "joint")
    if not motion.steps:
        raise InvalidData(f"motion '{motion.name}' has no step; add a [[step]] with move = {{ joint = degrees }}")
    segments: list[Segment] = []
    q = np.array([joint.park for joint in joints])
    t_s = 0.0
    for number, step in enumerate(motion.steps, start=1):
        _check_step(motion, step, number, joints, t_s)
        there = np.array([step.move.get(joint.name, q[j]) for j, joint in enumerate(joints)])
        goals = [goal for _ in range(step.repeat) for goal in (there, q)][:-1]
        for goal in goals:
            segment = _segment(number, t_s, q if not segments else segments[-1].q_to, goal, step, joints)
            segments.append(segment)
            t_s = segment.t_end_s
        q = there
    return Plan(motion, tuple(joints), tuple(segments))


def _segment(
    number: int, t_s: float, q_from: FloatArray, q_to: FloatArray, step: MotionStep, joints: Sequence[JointLimits]
) -> Segment:
    greatest = np.array([joint.max_speed for joint in joints])
    speed = greatest if step.speed is None else np.minimum(greatest, step.speed)
    move_s = float(np.max(np.abs(q_to - q_from) / speed))
    return Segment(number, t_s, frozen_floats(q_from), frozen_floats(q_to), frozen_floats(speed), move_s, step.hold_s)


def _check_step(motion: Motion, step: MotionStep, number: int, joints: Sequence[JointLimits], t_s: float) -> None:
    known = {joint.name: joint for joint in joints}
    for name, target in step.move.items():
        if name not in known:
            raise InvalidData(
                f"motion '{motion.name}', step {number}: no joint '{name}'; the rig has {', '.join(known)}"
            )
        joint = known[name]
        slack = LIMIT_SLACK * max(abs(joint.lower), abs(joint.upper))
        if not joint.lower - slack <= target <= joint.upper + slack:
            raise LimitExceeded(
                f"motion '{motion.name}', step {number} (t = {t_s:.1f} s): {name} would go to {joint.text(target)}; "
                f"its limits are {joint.text(joint.lower)} to {joint.text(joint.upper)}\n"
                f"change the target, or {joint.key('limits')} of {name} in the rig"
            )
        if step.speed is not None and step.speed > joint.max_speed * (1 + LIMIT_SLACK):
            raise LimitExceeded(
                f"motion '{motion.name}', step {number} (t = {t_s:.1f} s): {name} would move at "
                f"{joint.text(step.speed)}/s; its greatest speed is {joint.text(joint.max_speed)}/s\n"
                f"lower {joint.key('speed')} of the step, or raise {joint.key('max_speed')} of {name} in the rig"
            )
