"""Replays of recorded joint states: smoothed, kept within limits, slowed until no joint is too fast, streamed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from station.errors import InvalidData
from station.logs import FloatArray, JointLog, check_times, frozen_floats
from station.motion.limits import JointLimits, Unit, slow_speeds
from station.motion.segment import Mode, Segment, accelerations, curve_legs, eased_leg
from station.motion.steps import NOWHERE, check_names, check_speeds
from station.motion.waves import check_streamed

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

# A replay rests for so long before and after what was recorded, in which it gets under way.
REST_S = 0.1
# What a hand does faster than this is tremor and the read-back's rounding.
CUTOFF_HZ = 2.0
EVEN_HZ = 50.0
KNOT_S = 0.1
LEAST_S = 0.5
# Knots keep off limits by so much (rad, m), are written to so many decimals of a degree or mm, and the time is
# stretched by so much more than it takes: rounding must not carry them beyond.
EDGE: Mapping[Unit, float] = {"rad": float(np.radians(1e-3)), "m": 1e-6}
DECIMALS = 4
SPARE = 1e-3


@dataclass(frozen=True, eq=False, slots=True)
class KnotCurve:
    """States (J,) through knots (N, J) at times (N,), by monotone cubics (Fritsch and Carlson's, SciPy's PCHIP): no
    joint goes beyond its knots, its speed has no jumps, and it rests for REST_S before and after.
    """

    knot_s: FloatArray
    knots: FloatArray
    _cubics: PchipInterpolator = field(init=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import PchipInterpolator  # slow to import

        since_s = self.knot_s - self.knot_s[0] + REST_S
        t_s = np.concatenate([[0.0], since_s, [since_s[-1] + REST_S]])
        object.__setattr__(self, "_cubics", PchipInterpolator(t_s, self.knots[[0, *range(len(self.knots)), -1]]))

    @property
    def duration_s(self) -> float:
        """With the rests."""
        return float(self.knot_s[-1] - self.knot_s[0]) + 2 * REST_S

    def at(self, t_s: FloatArray) -> FloatArray:
        return np.asarray(self._cubics(np.clip(t_s, 0.0, self.duration_s)), dtype=np.float64)

    def lowest(self) -> FloatArray:
        return self.knots.min(axis=0)

    def highest(self) -> FloatArray:
        return self.knots.max(axis=0)

    def fastest(self) -> FloatArray:
        """At the ends of a cubic, or at the vertex of its derivative 3 a x^2 + 2 b x + c, x = -b / 3 a."""
        a, b, c, length = self._pieces()
        vertex = np.clip(-b / np.where(a == 0, np.inf, 3 * a), 0.0, length)
        speeds = [3 * a * x**2 + 2 * b * x + c for x in (np.zeros_like(a), length, vertex)]
        return np.max(np.abs(speeds), axis=(0, 1))

    def hardest(self) -> FloatArray:
        """At the ends of a cubic."""
        a, b, _, length = self._pieces()
        return np.max(np.abs([2 * b, 6 * a * length + 2 * b]), axis=(0, 1))

    def _pieces(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Coefficients a, b, c of the cubics a x^3 + b x^2 + c x + d, and their lengths [s], (pieces, J or 1) each."""
        a, b, c, _ = np.asarray(self._cubics.c, dtype=np.float64)
        return a, b, c, np.diff(np.asarray(self._cubics.x, dtype=np.float64))[:, None]


@dataclass(frozen=True, eq=False, slots=True)
class Replay:
    """States of some joints at given times, as they are; the arm goes to the first ones before.

    Attributes:
        joints: K names.
        t_s: (N,) increasing.
        q: (N, K) rad or m.
        hold_s: rest at the end.
        repeat: how often it is done.

    Raises:
        InvalidData: shapes that don't agree, times that don't increase, states that are no numbers, fewer than two.
    """

    kind: ClassVar[str] = "replay"
    remedy: ClassVar[str] = "slow it, or make it anew from the recording: its times and states are taken as they are"

    joints: tuple[str, ...]
    t_s: FloatArray
    q: FloatArray
    hold_s: float = 0.0
    repeat: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_floats(self.t_s, "times"))
        object.__setattr__(self, "q", frozen_floats(self.q, "states"))
        check_times(self.t_s)
        if len(self.t_s) < 2 or self.q.shape != (len(self.t_s), len(self.joints)) or not self.joints:
            raise InvalidData(
                f"a replay of {len(self.joints)} joints has {len(self.t_s)} times and states of shape {self.q.shape}; "
                "want two times or more, and a state of each joint at each"
            )
        if not np.all(np.isfinite(self.q)):
            raise InvalidData("a replay has states that are no numbers; leave those times out")

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """To the first state, along the curve, and that again for each repetition."""
        check_streamed(self.kind, mode)
        check_names(self.joints, joints)
        curve = self.curve(q, joints)
        way = curve_legs(curve, self.hold_s)
        legs: list[Segment] = []
        for _ in range(self.repeat):
            here = legs[-1].q_to if legs else q
            if np.any(here != way[0].q_from):
                legs.append(eased_leg(here, way[0].q_from, slow_speeds(joints, {}), 0.0, joints))
            legs += way
        return legs

    def curve(self, q: FloatArray, joints: Sequence[JointLimits]) -> KnotCurve:
        """The curve of all joints, of which those that aren't replayed stay where they are in q (J,)."""
        knots = np.tile(q, (len(self.t_s), 1))
        names = [joint.name for joint in joints]
        knots[:, [names.index(name) for name in self.joints]] = self.q
        return KnotCurve(self.t_s, frozen_floats(knots))

    def text(self, joints: Sequence[JointLimits]) -> str:
        told = [
            f"{joint.name} {joint.text(float(states.min()))} to {joint.text(float(states.max()))}"
            for joint in joints
            if joint.name in self.joints
            for states in [self.q[:, self.joints.index(joint.name)]]
        ]
        return f"replay of {self.t_s[-1] - self.t_s[0]:.1f} s: {', '.join(told)}"


def replay_of(
    log: JointLog, joints: Sequence[JointLimits], speeds: Mapping[Unit, float] = NOWHERE
) -> tuple[Replay, tuple[str, ...]]:
    """What a recording of joint states is as a replay on these joints, and what was changed, in words.

    Tremor is filtered off (a Butterworth low-pass of second order, forward and back), states are kept within the
    joints' limits, and the time is stretched as a whole until no joint is faster than it may be.

    Args:
        log: states over time; gaps (NaN) are filled by straight lines.
        joints: those of the arm.
        speeds: by unit; SLOW where nothing is said.

    Raises:
        InvalidData: joints that the arm doesn't have, a joint that was never read, less than half a second.
    """
    check_names(log.joints, joints)
    of = [joint for name in log.joints for joint in joints if joint.name == name]
    check_speeds(speeds, of)
    if len(log.t_s) < 2 or log.t_s[-1] - log.t_s[0] < LEAST_S:
        raise InvalidData(f"{len(log.t_s)} joint states are too little to replay; want {LEAST_S:g} s or more")
    t_s, q = _smoothed(log)
    lower = np.array([joint.lower + EDGE[joint.unit] for joint in of])
    upper = np.array([joint.upper - EDGE[joint.unit] for joint in of])
    each = np.array([np.degrees(1.0) if joint.unit == "rad" else 1e3 for joint in of])
    kept = np.round(np.clip(q, lower, upper) * each, DECIMALS) / each
    curve = KnotCurve(t_s, kept)
    slower = float(np.max(curve.fastest() / slow_speeds(of, speeds)))
    gentler = float(np.sqrt(np.max(curve.hardest() / accelerations(of))))
    stretch = max(1.0, (1 + SPARE) * max(slower, gentler))
    replay = Replay(log.joints, np.round(t_s * stretch, 6), kept)
    return replay, tuple([*_beyond(q, of), *_stretched(stretch, t_s)])


def _smoothed(log: JointLog) -> tuple[FloatArray, FloatArray]:
    """Knot times from 0 on and states without what is faster than CUTOFF_HZ."""
    from scipy.signal import butter, sosfiltfilt  # slow to import

    since_s = log.t_s - log.t_s[0]
    whole_s = float(since_s[-1])
    count, knots = int(whole_s * EVEN_HZ), max(1, round(whole_s / KNOT_S))
    even_s = whole_s / count * np.arange(count + 1, dtype=np.float64)
    knot_s = whole_s / knots * np.arange(knots + 1, dtype=np.float64)
    columns: list[FloatArray] = []
    for k, name in enumerate(log.joints):
        states = log.q[:, k]
        known = np.isfinite(states)
        if not known.any():
            raise InvalidData(f"joint '{name}' has no state in the recording; leave its column out")
        columns.append(np.interp(even_s, since_s[known], states[known]))
    sections = butter(2, CUTOFF_HZ, fs=count / whole_s, output="sos")
    smooth: FloatArray = np.asarray(sosfiltfilt(sections, np.column_stack(columns), axis=0), dtype=np.float64)
    return knot_s, np.column_stack([np.interp(knot_s, even_s, smooth[:, k]) for k in range(len(columns))])


def _beyond(q: FloatArray, joints: Sequence[JointLimits]) -> list[str]:
    """Which joints were kept at a limit, by how much at most."""
    notes: list[str] = []
    for states, joint in zip(q.T, joints, strict=True):
        beyond = float(max(joint.lower - states.min(), states.max() - joint.upper))
        if beyond > EDGE[joint.unit]:
            notes.append(f"{joint.name} was {joint.text(beyond)} beyond its limits: it is kept within them")
    return notes


def _stretched(stretch: float, t_s: FloatArray) -> list[str]:
    if stretch == 1.0:
        return []
    return [f"slowed {stretch:.2f} times, to {stretch * t_s[-1]:.0f} s, to keep to the joints' speeds"]
