"""rig.toml: the arm, the camera, the markers and, for runs without hardware, the simulated geometry; read strictly."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from calibration.errors import CalibrationError
from calibration.intrinsics import CameraModel
from drivers.camera import STALL_S, Controls
from station.errors import InvalidData, InvalidFile
from station.formats.camera import CameraTable
from station.formats.camera_files import read_camera
from station.formats.markers import MarkersModel
from station.formats.simulation import MM_PER_M, NotNegative, Pair, Positive, SimulationTable, check_simulation
from station.formats.toml_models import StrictModel, parse
from station.logs import check_slugs
from station.motion import JointLimits, Unit
from station.perception.markers import MarkerTable

RIG_SCHEMA = "rig/1"
EMULATED = "emulated"
RENDERED = "rendered"
PROTOCOLS = (1.0, 2.0)

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


# Of a rig without an arm: an object that people move, before a camera.
NO_BUS = BusTable(port="none", protocol=2.0)


class ServoTable(StrictModel):
    """`[[joint.servo]]`: zero is the position count at which the joint is at zero (the model's centre if not given).

    gear is servo turns for one turn of the joint; lead_mm how far a prismatic joint goes in one turn of the servo.
    ganging is of every servo but the joint's first: "software" (each gets its own goal, mirrored by its sign),
    "secondary_id" (it takes the first one's goals) or "sync_cable" (its motor follows the first one's). reversed is
    what the drive mode's reverse bit must be.
    """

    id: Annotated[int, Field(ge=0, le=252)]
    model: str
    zero: Annotated[int, Field(ge=0)] | None = None
    sign: Literal[1, -1] = 1
    gear: Positive | None = None
    lead_mm: Positive | None = None
    reversed: bool | None = None
    ganging: Literal["software", "secondary_id", "sync_cable"] | None = None


class JointTable(StrictModel):
    """`[[joint]]`: a joint of the arm and the servos that turn it; revolute with _deg keys, prismatic with _mm keys.

    The greatest acceleration, which may be left out, is for streamed motions.
    """

    name: str
    limits_deg: Pair | None = None
    limits_mm: Pair | None = None
    max_speed_deg_s: Positive | None = None
    max_speed_mm_s: Positive | None = None
    max_acceleration_deg_s2: Positive | None = None
    max_acceleration_mm_s2: Positive | None = None
    park_deg: float | None = None
    park_mm: float | None = None
    servo: Annotated[list[ServoTable], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> JointTable:
        limits, _, _, park = self._keys()
        unit = "deg" if self.unit == "rad" else "mm"
        lower, upper = limits
        if not lower <= park <= upper or lower == upper:
            raise ValueError(f"want limits_{unit} = [lower, upper] with park_{unit} between; have {limits}, {park}")
        if len(self.servo) > 1 and any(servo.ganging is None for servo in self.servo[1:]):
            raise ValueError('a joint with several servos needs ganging (such as "software") on each but the first')
        for servo in self.servo:
            if (servo.lead_mm is None) != (unit == "deg") or (unit == "mm" and servo.gear is not None):
                raise ValueError("servos of a prismatic joint have lead_mm (and no gear), those of others have none")
        return self

    @property
    def unit(self) -> Unit:
        """What the joint's states are in: rad, of a prismatic joint m."""
        return "rad" if self.limits_deg is not None else "m"

    def _keys(self) -> tuple[list[float], float, float | None, float]:
        """Limits, greatest speed and acceleration, and park position as the file has them.

        Raises ValueError for a mixture of units.
        """
        deg = self.limits_deg, self.max_speed_deg_s, self.max_acceleration_deg_s2, self.park_deg
        mm = self.limits_mm, self.max_speed_mm_s, self.max_acceleration_mm_s2, self.park_mm
        for (limits, max_speed, max_acceleration, park), others in ((deg, mm), (mm, deg)):
            if limits is not None and max_speed is not None and all(other is None for other in others):
                return limits, max_speed, max_acceleration, park or 0.0
        raise ValueError("want limits_deg and max_speed_deg_s, or, of a prismatic joint, limits_mm and max_speed_mm_s")

    def limits(self) -> JointLimits:
        """The joint's limits in rad, rad/s and rad/s2, of a prismatic joint in m, m/s and m/s2."""
        (lower, upper), max_speed, max_acceleration, park = self._keys()
        each = math.radians(1.0) if self.unit == "rad" else 1.0 / MM_PER_M
        hardest = None if max_acceleration is None else max_acceleration * each
        return JointLimits(self.name, lower * each, upper * each, max_speed * each, park * each, self.unit, hardest)


class CameraSettings(StrictModel):
    """`[camera]`: where frames come from, and the calibration as a file or inline.

    latency_s is the time from the middle of the exposure (of the middle row) to the stamp, taken off each frame's
    stamp; readout_s the time from the first to the last row of a rolling shutter, which goes before the calibration's;
    stall_s how long a camera may give no new frame; reconnect_s how long a capture then waits for it, 0 not at all.
    pixel_format, exposure_ms, focus, gain (both in the camera's own steps) and white_balance_k are set, locked and read
    back where they are given.
    """

    source: int | str
    size_px: SizePx
    fps: Positive
    readout_s: NotNegative | None = None
    latency_s: float = 0.0
    stall_s: Positive = STALL_S
    reconnect_s: NotNegative = 0.0
    pixel_format: Annotated[str, Field(pattern=r"^[ -~]{4}$")] | None = None
    exposure_ms: Positive | None = None
    focus: NotNegative | None = None
    gain: NotNegative | None = None
    white_balance_k: Positive | None = None
    calibration: str | CameraTable | None = None

    def controls(self) -> Controls:
        """What is to be locked."""
        return Controls(self.pixel_format, self.exposure_ms, self.focus, self.gain, self.white_balance_k)


class SafetyTable(StrictModel):
    """`[safety]`: the state in which every exit leaves the arm, and what counts as a fault.

    Temperatures and voltages that aren't given are the servos' own limits (5 degC under the one at which they switch
    off). Loads are shares of the most that a servo has. 0 switches stall_s, watchdog_s and reconnect_s off: the time
    after which a joint under load that doesn't move counts as stalled, after which servos stop by themselves when they
    hear nothing, and for which a capture waits for a bus that was lost.
    """

    at_exit: Literal["park-then-release", "hold", "release"] = "park-then-release"
    disagreement_deg: Positive = 5.0
    max_temperature_c: Positive | None = None
    min_voltage_v: Positive | None = None
    max_voltage_v: Positive | None = None
    max_load: Positive | None = None
    stall_load: Positive = 0.5
    stall_s: NotNegative = 1.0
    watchdog_s: Annotated[float, Field(ge=0, le=2.54)] = 1.0
    reconnect_s: NotNegative = 0.0


class RigTable(StrictModel):
    """The keys of rig.toml; without [bus] and [[joint]] it is that of an object that is moved by hand."""

    name: str = "rig"
    bus: BusTable = NO_BUS
    joint: list[JointTable] = Field(default_factory=list[JointTable])
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
        if ("bus" in self.model_fields_set) != bool(self.joint):
            have, lacks = ("[bus]", "[[joint]]") if "bus" in self.model_fields_set else ("[[joint]]", "[bus]")
            raise ValueError(f"has {have} and no {lacks}; an arm has both, an object moved by hand neither")
        servos = [servo.id for joint in self.joint for servo in joint.servo]
        if len(set(servos)) != len(servos):
            raise ValueError(f"each servo id may stand once; have {servos}")
        if self.simulation is None:
            if self.bus.port == EMULATED or self.camera.source == RENDERED:
                raise ValueError('port "emulated" and source "rendered" need a [simulation]')
        else:
            units = {joint.name: joint.unit for joint in self.joint} if self.joint else self.simulation.units()
            check_simulation(self.simulation, units, ids)
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
    """The camera's calibration, inline or from a file relative to the rig's folder, with the rig's readout_s if any.

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
        camera = given.to_camera() if isinstance(given, CameraTable) else read_camera(folder / given)
    except CalibrationError as error:
        raise InvalidFile(f"{name}, camera, calibration: {error}") from error
    if list(camera.size_px) != rig.camera.size_px:
        raise InvalidFile(
            f"{name}: the calibration is for frames of {camera.size_px[0]} x {camera.size_px[1]} px, "
            f"the camera is set to {rig.camera.size_px[0]} x {rig.camera.size_px[1]} px\n"
            "calibrate at the size that is captured, or set size_px to the calibration's"
        )
    return camera if rig.camera.readout_s is None else replace(camera, readout_s=rig.camera.readout_s)
