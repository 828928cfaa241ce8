"""rig.toml: the arm, the camera, the markers and, for runs without hardware, the simulated geometry; read strictly."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from calibration.errors import CalibrationError
from calibration.intrinsics import CameraModel
from station.errors import InvalidData, InvalidFile
from station.formats.camera import CameraTable, parse_camera
from station.formats.markers import MarkersModel
from station.formats.simulation import NotNegative, Positive, SimulationTable, check_simulation
from station.formats.text import read_text
from station.formats.toml_models import StrictModel, parse
from station.logs import check_slugs
from station.motion import JointLimits
from station.perception.markers import MarkerTable

RIG_SCHEMA = "rig/1"
EMULATED = "emulated"
RENDERED = "rendered"
PROTOCOLS = (1.0, 2.0)

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
SizePx = Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=2, max_length=2)]


class BusTable(StrictModel):
    """`[bus]`: the serial port, or "emulated"."""

    port: str
    baud: Annotated[int, Field(gt=0)] = 1_000_000
    protocol: float

    @field_validator("protocol")
    @classmethod
    def _check(cls, protocol: float) -> float:
        if protocol not in PROTOCOLS:
            raise ValueError(f"want 1.0 or 2.0; have {protocol}")
        return protocol


class ServoTable(StrictModel):
    """`[[joint.servo]]`: zero is the position count at which the joint is at zero (the model's centre if not given).

    Servos that turn one joint together each get their own goal (ganging = "software"), mirrored by their sign.
    """

    id: Annotated[int, Field(ge=0, le=252)]
    model: str
    zero: Annotated[int, Field(ge=0)] | None = None
    sign: Literal[1, -1] = 1
    ganging: Literal["software"] | None = None


class JointTable(StrictModel):
    """`[[joint]]`: a revolute joint of the arm and the servos that turn it."""

    name: str
    limits_deg: Pair
    max_speed_deg_s: Positive
    park_deg: float = 0.0
    servo: Annotated[list[ServoTable], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> JointTable:
        lower, upper = self.limits_deg
        if not lower <= self.park_deg <= upper or lower == upper:
            have = f"{self.limits_deg}, {self.park_deg}"
            raise ValueError(f"want limits_deg = [lower, upper] with park_deg between; have {have}")
        if len(self.servo) > 1 and any(servo.ganging is None for servo in self.servo[1:]):
            raise ValueError('a joint with several servos needs ganging = "software" on each but the first')
        return self

    def limits(self) -> JointLimits:
        """The joint's limits in radians."""
        lower, upper = np.radians(self.limits_deg).tolist()
        return JointLimits(self.name, lower, upper, math.radians(self.max_speed_deg_s), math.radians(self.park_deg))


class CameraSettings(StrictModel):
    """`[camera]`: where frames come from, and the calibration as a file or inline.

    latency_s is the time from the middle of the exposure to the stamp, taken off each frame's stamp.
    """

    source: int | str
    size_px: SizePx
    fps: Positive
    readout_s: NotNegative | None = None
    latency_s: float = 0.0
    calibration: str | CameraTable | None = None


class SafetyTable(StrictModel):
    """`[safety]`: the state in which every exit leaves the arm, and what counts as a fault."""

    at_exit: Literal["park-then-release", "hold", "release"] = "park-then-release"
    disagreement_deg: Positive = 5.0


class RigTable(StrictModel):
    """The keys of rig.toml."""

    name: str = "rig"
    bus: BusTable
    joint: Annotated[list[JointTable], Field(min_length=1)]
    camera: CameraSettings
    markers: MarkersModel
    safety: SafetyTable = SafetyTable()
    simulation: SimulationTable | None = None

    @model_validator(mode="after")
    def _check(self) -> RigTable:
        try:
            check_slugs([joint.name for joint in self.joint], "joint")
            ids = {marker.id for marker in self.markers.to_table().markers}
        except InvalidData as error:
            raise ValueError(str(error)) from error
        servos = [servo.id for joint in self.joint for servo in joint.servo]
        if len(set(servos)) != len(servos):
            raise ValueError(f"each servo id may stand once; have {servos}")
        if self.simulation is None:
            if self.bus.port == EMULATED or self.camera.source == RENDERED:
                raise ValueError('port "emulated" and source "rendered" need a [simulation]')
        else:
            check_simulation(self.simulation, {joint.name for joint in self.joint}, ids)
        return self

    def limits(self) -> tuple[JointLimits, ...]:
        """Limits of the joints, in the order of the file."""
        return tuple(joint.limits() for joint in self.joint)

    def marker_table(self) -> MarkerTable:
        """The markers that the camera looks for."""
        return self.markers.to_table()


def parse_rig(text: str, name: str) -> RigTable:
    """The rig in a rig.toml text; raises InvalidFile with the file's `name` and the keys that are wrong."""
    return parse(RigTable, text, name, RIG_SCHEMA)


def load_calibration(rig: RigTable, folder: Path, name: str) -> CameraModel:
    """The camera's calibration, inline or from a file relative to the rig's folder.

    Raises:
        InvalidFile: none is given, the file is missing or wrong, or it is for another frame size.
    """
    given = rig.camera.calibration
    if given is None:
        raise InvalidFile(
            f"{name} has no calibration of its camera, without which markers have no pose\n"
            'give calibration = "camera.toml" under [camera], or an inline [camera.calibration]'
        )
    try:
        camera = given.to_camera() if isinstance(given, CameraTable) else _read_camera(folder / given)
    except CalibrationError as error:
        raise InvalidFile(f"{name}, camera, calibration: {error}") from error
    if list(camera.size_px) != rig.camera.size_px:
        raise InvalidFile(
            f"{name}: the calibration is for frames of {camera.size_px[0]} x {camera.size_px[1]} px, "
            f"the camera is set to {rig.camera.size_px[0]} x {rig.camera.size_px[1]} px\n"
            "calibrate at the size that is captured, or set size_px to the calibration's"
        )
    return camera


def _read_camera(path: Path) -> CameraModel:
    return parse_camera(read_text(path, "calibration"), str(path))
