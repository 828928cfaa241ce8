"""Sinusoids: each joint to and fro with its own amplitude, frequency and phase, all at once, streamed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from station.errors import InvalidData
from station.logs import FloatArray, frozen_floats
from station.motion.limits import JointLimits, Unit, slow_speeds
from station.motion.segment import Mode, Segment, accelerations, curve_legs, eased_leg
from station.motion.steps import NOWHERE, Reach, check_names, check_speeds

# Sinusoids over a joint's reach are no quicker, however short that is.
QUICKEST_HZ = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class SinusoidCurve:
    """q(t) = centre + w(t) amplitude sin(2 pi frequency t + phase), for each joint (J,).

    w rises from 0 to 1 over ramp_s as (1 - cos(pi t / ramp_s)) / 2 and falls as it rose at the end, so that it starts
    and ends at rest in its centre. With a ramp of half a period or more no joint is faster than amplitude omega, nor
    accelerates more than amplitude omega^2 (1 + (pi / (ramp omega))^2 / 2): with x = cos(pi t / ramp) the squares of
    the envelopes of speed and acceleration are greatest where w = 1.
    """

    centre: FloatArray
    amplitude: FloatArray
    frequency_hz: FloatArray
    phase: FloatArray
    duration_s: float
    ramp_s: float

    def at(self, t_s: FloatArray) -> FloatArray:
        """By the formula."""
        t = np.clip(t_s, 0.0, self.duration_s)
        to_end_s = np.minimum(np.minimum(t, self.duration_s - t), self.ramp_s)
        w = 0.5 * (1 - np.cos(np.pi * to_end_s / self.ramp_s))
        wave = np.sin(2 * np.pi * self.frequency_hz * t[..., None] + self.phase)
        return self.centre + w[..., None] * self.amplitude * wave

    def lowest(self) -> FloatArray:
        return self.centre - self.amplitude

    def highest(self) -> FloatArray:
        return self.centre + self.amplitude

    def fastest(self) -> FloatArray:
        return self.amplitude * 2 * np.pi * self.frequency_hz

    def hardest(self) -> FloatArray:
        omega = 2 * np.pi * self.frequency_hz
        return self.amplitude * (omega**2 + (np.pi / self.ramp_s) ** 2 / 2)


@dataclass(frozen=True, slots=True)
class Wave:
    """One joint's sinusoid: amplitude in rad or m, phase in rad; centre None for where the joint is."""

    amplitude: float
    frequency_hz: float
    phase: float = 0.0
    centre: float | None = None


@dataclass(frozen=True, slots=True)
class Sinusoids:
    """Given sinusoids of given joints; the arm goes to their centres first.

    Attributes:
        waves: by joint.
        duration_s: with the ramps.
        ramp_s: the amplitudes rise, and fall, over so long; None for half of the longest period, which is the least.
        hold_s: rest at the end.
        repeat: how often it is done.
    """

    kind: ClassVar[str] = "sinusoids"
    remedy: ClassVar[str] = "lower its amplitude, or its frequency"

    waves: Mapping[str, Wave]
    duration_s: float
    ramp_s: float | None = None
    hold_s: float = 0.0
    repeat: int = 1

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """To the centres, and along the curve."""
        check_streamed(self.kind, mode)
        if not self.waves:
            raise InvalidData("sinusoids of no joint; give joint.NAME = { amplitude_deg, period_s }")
        check_names(self.waves, joints)
        curve = self._curve(q, joints)
        legs = curve_legs(curve, self.hold_s) * self.repeat
        if np.any(curve.centre != q):
            legs = [eased_leg(q, curve.centre, slow_speeds(joints, {}), 0.0, joints), *legs]
        return legs

    def _curve(self, q: FloatArray, joints: Sequence[JointLimits]) -> SinusoidCurve:
        least_s = 0.5 / min(wave.frequency_hz for wave in self.waves.values())
        ramp_s = least_s if self.ramp_s is None else self.ramp_s
        if not least_s * (1 - 1e-9) <= ramp_s <= 0.5 * self.duration_s:
            raise InvalidData(
                f"ramp_s = {ramp_s:g} for duration_s = {self.duration_s:g}; want {least_s:g} s at least, which is half "
                "of the longest period, and half of duration_s at most"
            )
        centre, numbers = np.array(q), np.zeros((3, len(q)))
        for j, joint in enumerate(joints):
            if (wave := self.waves.get(joint.name)) is not None:
                centre[j] = q[j] if wave.centre is None else wave.centre
                numbers[:, j] = wave.amplitude, wave.frequency_hz, wave.phase
        amplitude, frequency_hz, phase = (frozen_floats(row) for row in numbers)
        return SinusoidCurve(frozen_floats(centre), amplitude, frequency_hz, phase, self.duration_s, ramp_s)

    def text(self, joints: Sequence[JointLimits]) -> str:
        told = [
            f"{j.name} ±{j.text(self.waves[j.name].amplitude)} at {self.waves[j.name].frequency_hz:.3g} Hz"
            for j in joints
            if j.name in self.waves
        ]
        return f"sinusoids: {', '.join(told)}"


@dataclass(frozen=True, slots=True)
class SinusoidsInReach:
    """Sinusoids of any arm's joints over their reach, as fast as their speeds allow.

    Between the ramps joint j goes through `cycles` + j // 2 whole periods, as a sine or a cosine: any two joints are
    uncorrelated there.

    Attributes:
        reach: which joints, and how far.
        cycles: whole periods of the slowest joint at full amplitude.
        speeds: by unit; SLOW where nothing is said.
        hold_s: rest at the end.
        repeat: how often it is done.
    """

    kind: ClassVar[str] = "sinusoids"
    remedy: ClassVar[str] = "lower its share"

    reach: Reach = field(default_factory=Reach)
    cycles: int = 2
    speeds: Mapping[Unit, float] = field(default_factory=lambda: NOWHERE)
    hold_s: float = 0.0
    repeat: int = 1

    def legs(self, q: FloatArray, joints: Sequence[JointLimits], mode: Mode) -> list[Segment]:
        """Those of the sinusoids, and back to where the arm was."""
        check_streamed(self.kind, mode)
        check_speeds(self.speeds, self.reach.moved(joints))
        legs = self.sinusoids(q, joints).legs(q, joints, mode)
        if np.any(legs[-1].q_to != q):
            legs.append(eased_leg(legs[-1].q_to, q, slow_speeds(joints, self.speeds), 0.0, joints))
        return legs

    def sinusoids(self, q: FloatArray, joints: Sequence[JointLimits]) -> Sinusoids:
        """What it comes to for these joints, from pose q (J,)."""
        low, high = self.reach.ends(joints, q)
        moving = np.flatnonzero(high > low)
        order = np.arange(len(moving))
        amplitude, centre = 0.5 * (high - low)[moving], 0.5 * (low + high)[moving]
        speed, acceleration = slow_speeds(joints, self.speeds)[moving], accelerations(joints)[moving]
        turns = self.cycles + order // 2
        # Ramps of half the longest period are pi / omega at least, which makes (1 + 1/2) of the acceleration.
        omega = np.minimum(speed / amplitude, np.sqrt(acceleration / (1.5 * amplitude)))
        full_s = float(np.max(2 * np.pi * turns / np.minimum(omega, 2 * np.pi * QUICKEST_HZ)))
        ramp_s = 0.5 * full_s / self.cycles
        phase = np.pi / 2 * (order % 2) - 2 * np.pi * turns * ramp_s / full_s  # from the start of the full amplitude
        waves = {
            joints[int(j)].name: Wave(float(a), float(n / full_s), float(p), float(c))
            for j, a, n, p, c in zip(moving, amplitude, turns, phase, centre, strict=True)
        }
        return Sinusoids(waves, full_s + 2 * ramp_s, ramp_s, self.hold_s, self.repeat)

    def text(self, joints: Sequence[JointLimits]) -> str:
        return f"sinusoids: {self.reach.text(joints)}"


def check_streamed(kind: str, mode: Mode) -> None:
    """Raise InvalidData for a motion that isn't streamed."""
    if mode != "stream":
        raise InvalidData(f'{kind} are streamed; write mode = "stream" before the first [[step]]')
