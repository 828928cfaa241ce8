"""The tables of motion.toml's kinds of steps, in degrees and millimetres, and what they are in SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from station.errors import InvalidData
from station.formats.toml_models import StrictModel
from station.logs import FloatArray
from station.motion import AT_MOST, SHARE, Reach, Unit, Wave

MM_PER_M = 1e3
# Longer ones are mistakes.
MOST_POSES = 10_000

Positive = Annotated[float, Field(gt=0)]
Units = Mapping[str, Unit]


def in_si(value: float, unit: Unit) -> float:
    """Degrees to rad, mm to m."""
    return math.radians(value) if unit == "rad" else value / MM_PER_M


def in_text(value: float, unit: Unit) -> float:
    """Rad to degrees, m to mm."""
    return math.degrees(value) if unit == "rad" else value * MM_PER_M


class ReachModel(StrictModel):
    """`each_joint`, and what all kinds have that suit any rig; see `Reach`."""

    share: Annotated[float, Field(gt=0, le=1)] = SHARE
    at_most_deg: Positive = in_text(AT_MOST["rad"], "rad")
    at_most_mm: Positive = in_text(AT_MOST["m"], "m")
    joints: list[str] = Field(default_factory=list)
    skip: list[str] = Field(default_factory=list)

    def reach(self, units: Units) -> Reach:
        """In SI units; raises InvalidData for joints that aren't there, or none at all."""
        for joint in self.joints:
            if joint not in units:
                raise InvalidData(f"no joint '{joint}'; the rig has {', '.join(units)}")
        at_most: dict[Unit, float] = {"rad": in_si(self.at_most_deg, "rad"), "m": in_si(self.at_most_mm, "m")}
        return Reach(self.share, at_most, tuple(self.joints), tuple(self.skip))


class CombinedModel(ReachModel):
    """`combined`; see `Combined`."""

    poses: Annotated[int, Field(ge=1, le=MOST_POSES)] | None = None


class ExploreModel(ReachModel):
    """`explore`; see `Explore`."""

    poses: Annotated[int, Field(ge=1, le=MOST_POSES)] = 12
    seed: Annotated[int, Field(ge=0)] = 0


class WaveModel(StrictModel):
    """One joint of `sinusoids`; see `Wave`."""

    amplitude_deg: Positive | None = None
    amplitude_mm: Positive | None = None
    period_s: Positive | None = None
    frequency_hz: Positive | None = None
    phase_deg: float = 0.0
    centre_deg: float | None = None
    centre_mm: float | None = None

    @model_validator(mode="after")
    def _check(self) -> WaveModel:
        if (self.period_s is None) == (self.frequency_hz is None):
            raise ValueError("want period_s or frequency_hz")
        if (self.amplitude_deg is None) == (self.amplitude_mm is None):
            raise ValueError("want amplitude_deg, or amplitude_mm of a prismatic joint")
        return self

    def wave(self, joint: str, unit: Unit) -> Wave:
        """In SI units; raises InvalidData for keys of the other unit."""
        deg, mm = (self.amplitude_deg, self.centre_deg), (self.amplitude_mm, self.centre_mm)
        (amplitude, centre), others, want = (deg, mm, "deg") if unit == "rad" else (mm, deg, "mm")
        if amplitude is None or others != (None, None):
            raise InvalidData(f"sinusoids, joint, {joint}: want amplitude_{want} and centre_{want}, which it moves in")
        hz = self.frequency_hz or 1 / (self.period_s or 1.0)
        at = None if centre is None else in_si(centre, unit)
        return Wave(in_si(amplitude, unit), hz, math.radians(self.phase_deg), at)


REACH_KEYS = frozenset({*ReachModel.model_fields, "cycles"})


class SinusoidsModel(ReachModel):
    """`sinusoids`: over shares of any rig's joints, or given ones; see `SinusoidsInReach` and `Sinusoids`."""

    cycles: Annotated[int, Field(ge=1, le=MOST_POSES)] = 2
    joint: dict[str, WaveModel] | None = None
    duration_s: Positive | None = None
    ramp_s: Positive | None = None

    @model_validator(mode="after")
    def _check(self) -> SinusoidsModel:
        if self.joint is None:
            if self.duration_s is not None or self.ramp_s is not None:
                raise ValueError("duration_s and ramp_s go with joint tables; without those say cycles")
        elif self.duration_s is None:
            raise ValueError("want duration_s beside joint tables")
        elif both := sorted(REACH_KEYS & self.model_fields_set):
            raise ValueError(f"{both[0]} goes without joint tables: those say by themselves which joints move")
        return self

    def waves(self, units: Units) -> dict[str, Wave]:
        """The given ones in SI units; raises InvalidData for joints that aren't there or keys of the other unit."""
        given = self.joint or {}
        for joint in given:
            if joint not in units:
                raise InvalidData(f"no joint '{joint}'; the rig has {', '.join(units)}")
        return {joint: model.wave(joint, units[joint]) for joint, model in given.items()}


class ReplayModel(StrictModel):
    """`replay`: a recording's file, or states at times: of revolute joints under deg, of prismatic ones under mm."""

    file: str | None = None
    t_s: list[float] | None = None
    deg: dict[str, list[float]] = Field(default_factory=dict)
    mm: dict[str, list[float]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> ReplayModel:
        if (self.file is None) == (self.t_s is None) or (self.file is not None and (self.deg or self.mm)):
            raise ValueError("want file, or t_s with deg.JOINT = [...] (mm.JOINT of a prismatic joint)")
        for joint, states in {**self.deg, **self.mm}.items():
            if len(states) != len(self.t_s or []):
                raise ValueError(f"{joint} has {len(states)} states; want one for each of {len(self.t_s or [])} t_s")
        return self

    def states(self, units: Units) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """Names (K), times (N,) and states (N, K) in SI units; raises InvalidData for joints that aren't there."""
        given: dict[str, tuple[Unit, list[float]]] = {name: ("m", states) for name, states in self.mm.items()}
        given |= {name: ("rad", states) for name, states in self.deg.items()}
        for joint, (unit, _) in given.items():
            if joint not in units:
                raise InvalidData(f"no joint '{joint}'; the rig has {', '.join(units)}")
            if units[joint] != unit or (joint in self.mm and joint in self.deg):
                raise InvalidData(f"replay: {joint} belongs under {'deg' if units[joint] == 'rad' else 'mm'}")
        columns = [[in_si(x, unit) for x in states] for unit, states in given.values()]
        return tuple(given), np.array(self.t_s or [], dtype=np.float64), np.array(columns, dtype=np.float64).T
