"""`[simulation]` of rig.toml: truth for the emulated bus and the rendered camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from drivers.emulator import parse_fault
from drivers.errors import DriverError
from station.formats.toml_models import StrictModel
from station.logs import FloatArray

MM_PER_M = 1e3

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


def metres(values_mm: list[float]) -> FloatArray:
    """Millimetres to a vector in metres."""
    return np.array(values_mm, dtype=np.float64) / MM_PER_M


class SimulatedJoint(StrictModel):
    """`[[simulation.joint]]`: where the joint of that name really is, in the root's frame with all joints at zero.

    point_mm, a point of a revolute joint's axis, means nothing for a prismatic one. mass_kg and centre_mm, if given,
    are of the child body: the joints then carry its weight. limits_deg, of a prismatic joint limits_mm, are how far the
    hand goes that moves the object of a rig without servos.
    """

    name: str
    type: Literal["revolute", "prismatic"] = "revolute"
    parent: str
    child: str
    axis: Vector
    point_mm: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    mass_kg: NotNegative | None = None
    centre_mm: Vector | None = None
    limits_deg: Pair | None = None
    limits_mm: Pair | None = None

    @model_validator(mode="after")
    def _check(self) -> SimulatedJoint:
        if (self.mass_kg is None) != (self.centre_mm is None):
            raise ValueError("want mass_kg and centre_mm, or neither")
        if not any(self.axis):
            raise ValueError("the axis has no direction")
        key, other = ("limits_mm", "limits_deg") if self.type == "prismatic" else ("limits_deg", "limits_mm")
        if getattr(self, other) is not None:
            raise ValueError(f"a {self.type} joint has {key}, not {other}")
        limits: list[float] | None = getattr(self, key)
        if limits is not None and not limits[0] < limits[1]:
            raise ValueError(f"want {key} = [lower, upper]; have {limits}")
        return self

    def limits(self) -> tuple[float, float] | None:
        """How far a hand goes [rad, of a prismatic joint m]; None where nobody says."""
        given, each = (self.limits_mm, 1 / MM_PER_M) if self.type == "prismatic" else (self.limits_deg, np.pi / 180)
        return None if given is None else (given[0] * each, given[1] * each)


class SimulatedPlate(StrictModel):
    """`[[simulation.plate]]`: the marker of that id on a body: its centre, outward normal and upward direction."""

    id: int
    body: str
    position_mm: Vector
    normal: Vector
    up: Vector = Field(default_factory=lambda: [0.0, 0.0, 1.0])
    margin_mm: NotNegative = 8.5


class SimulatedBox(StrictModel):
    """`[[simulation.box]]`: a block on a body, for people to see; rpy_deg turns it about fixed x, y, z in turn."""

    body: str
    size_mm: Vector
    position_mm: Vector
    rpy_deg: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    colour: Annotated[str, Field(pattern="^#[0-9a-fA-F]{6}$")] = "#8a8f98"


class SimulatedCamera(StrictModel):
    """`[simulation.camera]`: where the rendered camera stands and how bad its pictures are.

    matrix, distortion and readout_s are the real ones; where they aren't given, the calibration is taken to be exact.
    """

    position_mm: Vector
    look_at_mm: Vector
    exposure_s: Positive = 0.008
    readout_s: NotNegative | None = None
    latency_s: NotNegative = 0.0
    blur_px: NotNegative = 0.6
    noise_grey: NotNegative = 1.5
    gamma: Positive = 2.2
    blur_instants: Annotated[int, Field(ge=1)] = 1
    matrix: list[Vector] | None = None
    distortion: Annotated[list[float], Field(min_length=5, max_length=5)] | None = None


class SimulationTable(StrictModel):
    """`[simulation]`: truth for the emulated bus and the rendered camera, drawn with all joints at zero.

    placement_mm and placement_deg are standard deviations by which the seed moves each plate and the camera, as hands
    would; max_acceleration_deg_s2 limits the emulated servos, backlash_deg is their play. faults are lines such as
    "mute:3@2+1", in seconds since the bus was opened (docs/emulator.md lists them).
    """

    root: str
    seed: int = 0
    placement_mm: NotNegative = 0.0
    placement_deg: NotNegative = 0.0
    max_acceleration_deg_s2: Positive = 400.0
    backlash_deg: NotNegative = 0.0
    faults: list[str] = Field(default_factory=list)
    camera: SimulatedCamera
    joint: Annotated[list[SimulatedJoint], Field(min_length=1)]
    plate: list[SimulatedPlate]
    box: list[SimulatedBox] = Field(default_factory=list)

    @field_validator("faults")
    @classmethod
    def _check(cls, faults: list[str]) -> list[str]:
        try:
            for fault in faults:
                parse_fault(fault)
        except DriverError as error:
            raise ValueError(str(error)) from error
        return faults

    def units(self) -> dict[str, str]:
        """Unit of each simulated joint's states: rad, of a prismatic one m."""
        return {joint.name: "m" if joint.type == "prismatic" else "rad" for joint in self.joint}

    def hand_limits(self) -> dict[str, tuple[float, float]]:
        """How far a hand moves each joint that has such limits, rad or m."""
        return {joint.name: limits for joint in self.joint if (limits := joint.limits()) is not None}

    def bodies(self) -> tuple[str, ...]:
        """The root, then each joint's child, in the order of the file."""
        return (self.root, *(joint.child for joint in self.joint))


def check_simulation(simulation: SimulationTable, joints: Mapping[str, str], ids: set[int]) -> None:
    """Raise ValueError for joints, bodies or plates that the rig or the simulation itself doesn't have."""
    have = {joint.name for joint in simulation.joint}
    if have != set(joints) or len(simulation.joint) != len(joints):
        both = f"the rig has {sorted(joints)}, it places {sorted(have)}"
        raise ValueError(f"[simulation] must place each joint once; {both}")
    placed = {simulation.root}
    for joint in simulation.joint:
        if joint.parent not in placed or joint.child in placed:
            raise ValueError(f"simulated joint '{joint.name}': the parent must stand before it, the child must be new")
        placed.add(joint.child)
        if (joint.type == "prismatic") != (joints[joint.name] == "m"):
            raise ValueError(f"simulated joint '{joint.name}' is {joint.type}; the rig's limits are in other units")
    for item in (*simulation.plate, *simulation.box):
        if item.body not in placed:
            raise ValueError(f"no simulated body '{item.body}'; have {', '.join(sorted(placed))}")
    strangers = sorted({plate.id for plate in simulation.plate} - ids)
    if strangers:
        raise ValueError(f"simulated plates have ids {strangers}, which [markers] doesn't list")
