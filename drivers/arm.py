"""An arm: joints made of one or several servos, commanded and read in radians, within its limits."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.clock import Clock
from drivers.dynamixel import DynamixelBus, Reading
from drivers.errors import ArmFault, DriverError, NoReply, ServoFault, WrongModel
from drivers.servo_models import ServoModel, load_model

FloatArray = NDArray[np.float64]

# rad. Ganged servos that differ by more than this fight each other, or one of them has slipped.
DISAGREEMENT_RAD = math.radians(5.0)
# rad/s^2. Profile Acceleration of servos that have one: full speed of an arm in about a tenth of a second.
PROFILE_ACCELERATION_RAD_S2 = 10.0
# rad. A command at the limit may be over it by the rounding of float64.
LIMIT_TOLERANCE_RAD = 1e-9
_POSITION_MODE = 3  # Operating Mode (11) of the X series
_TIME_BASED_PROFILE = 4  # Drive Mode (10), bit 2: profile velocity and acceleration are times
_ALL_STATUS = 2  # Status Return Level: every instruction is answered


@dataclass(frozen=True)
class ServoConfig:
    """A servo of a joint.

    Attributes:
        zero_count: position count at the joint's zero; the model's zero count if None.
        sign: +1 if the joint's angle grows with the count, -1 if it falls (a mirrored servo).
    """

    id: int
    model: str
    zero_count: int | None = None
    sign: int = 1

    @property
    def zero(self) -> int:
        """Position count at the joint's zero."""
        return load_model(self.model).zero_count if self.zero_count is None else self.zero_count

    def count(self, q_rad: float) -> int:
        """The position count nearest to a joint angle."""
        return self.zero + math.floor(self.sign * q_rad / load_model(self.model).rad_per_count + 0.5)

    def q_rad(self, count: int) -> float:
        """The joint angle at a position count."""
        return self.sign * (count - self.zero) * load_model(self.model).rad_per_count


@dataclass(frozen=True)
class JointConfig:
    """A revolute joint, driven by one servo or by several that are ganged."""

    name: str
    servos: tuple[ServoConfig, ...]
    lower_rad: float
    upper_rad: float
    max_speed_rad_s: float

    def __post_init__(self) -> None:
        if not self.servos:
            raise DriverError(f"joint '{self.name}' has no servo; give it one")
        if any(servo.sign not in (-1, 1) for servo in self.servos):
            raise DriverError(f"joint '{self.name}': the sign of a servo is 1 or -1")
        if not self.lower_rad < self.upper_rad:
            raise DriverError(f"joint '{self.name}': limits {self.lower_rad:g} to {self.upper_rad:g} rad are no range")
        if not self.max_speed_rad_s > 0:
            raise DriverError(f"joint '{self.name}': the speed limit {self.max_speed_rad_s:g} rad/s must be positive")


@dataclass(frozen=True, eq=False)
class ArmReading:
    """Measured joint angles.

    Attributes:
        t_request_ns, t_reply_ns: of the first request and the last reply.
        q_rad: (J,) angles; the mean of ganged servos.
        t_joint_ns: (J,) midpoints of each joint's own requests and replies: servos without group reads are asked one
            after the other.
    """

    t_request_ns: int
    t_reply_ns: int
    q_rad: FloatArray
    t_joint_ns: NDArray[np.int64]

    @property
    def t_ns(self) -> int:
        """Midpoint of request and reply."""
        return (self.t_request_ns + self.t_reply_ns) // 2


class Arm:
    """Joints on a servo bus. Angle of a joint: sign * (shaft angle - shaft angle at the zero count), rad.

    Nothing moves before `torque_on`, and nothing ever moves faster than the joints' limits. Every error names the
    joint. `connect` first.

    Raises:
        DriverError: for a name or an id that appears twice, a model that isn't known or doesn't speak the protocol.
    """

    def __init__(
        self,
        bus: DynamixelBus,
        joints: Sequence[JointConfig],
        clock: Clock,
        *,
        disagreement_rad: float = DISAGREEMENT_RAD,
    ) -> None:
        self._bus, self._joints, self._clock = bus, tuple(joints), clock
        self._disagreement_rad = disagreement_rad
        self._connected = self._torque = self._limited = False
        ids = [servo.id for _, servo in self._servos()]
        for what, values in (("joint", self.names), ("servo", ids)):
            if len(set(values)) != len(values):
                raise DriverError(f"a {what} appears twice: {', '.join(map(str, values))}; give each its own")
        for joint, servo in self._servos():
            if bus.protocol not in load_model(servo.model).protocols:
                raise DriverError(f"servo {servo.id} ({joint.name}): {servo.model} doesn't speak {bus.protocol:.1f}")
            bus.label(servo.id, joint.name)

    @property
    def names(self) -> tuple[str, ...]:
        """The joints' names, in the order of all arrays (J,)."""
        return tuple(joint.name for joint in self._joints)

    @property
    def bus_errors(self) -> dict[str, int]:
        """Counts of what went wrong on the bus and was mended."""
        return self._bus.errors

    def connect(self) -> None:
        """Find every servo and see that it is fit for use; writes nothing.

        Raises:
            NoReply: for a servo that isn't there, or doesn't answer reads.
            WrongModel: for a servo of another model than configured.
            ServoFault: for an alarm, or settings under which the driver can't work.
        """
        for joint, servo in self._servos():
            want = load_model(servo.model)
            have = self._bus.ping(servo.id)
            if have != want.model_number:
                raise WrongModel(
                    f"servo {servo.id} ({joint.name}) on {self._bus.where} answers with model number {have}; "
                    f"{want.name} is {want.model_number}: check 'model' and 'id' in rig.toml",
                    servo_id=servo.id, have=have, want=want.model_number,
                )  # fmt: skip
        for joint, servo in self._servos():
            self._check_settings(joint, servo, load_model(servo.model))
        self._connected = True

    def set_speeds(self, rad_s: ArrayLike) -> None:
        """Limit the joints' speeds (J,) by the servos' own registers; each is rounded down to a whole unit.

        0 in those registers is no limit: it is never written. Raises ArmFault for a speed over the joint's limit, or
        so small that it would round to 0, before anything is sent.
        """
        self._need_connection()
        speeds = self._vector(rad_s, "speeds")
        units: list[tuple[JointConfig, ServoConfig, int]] = []
        for joint, speed in zip(self._joints, speeds, strict=True):
            if not 0 < speed <= joint.max_speed_rad_s * (1 + 1e-12):
                raise ArmFault(
                    f"joint '{joint.name}': speed {speed:g} rad/s; its limit is {joint.max_speed_rad_s:g} rad/s; "
                    "lower the motion's speed or raise max_speed_deg_s in rig.toml",
                    joint=joint.name,
                )
            for servo in joint.servos:
                model = load_model(servo.model)
                if (value := model.speed_units_within(speed)) == 0:
                    slowest = model.speed_unit_rad_s
                    text = f"joint '{joint.name}': {speed:g} rad/s is slower than {servo.model} can go ({slowest:.4f})"
                    raise ArmFault(f"{text}; ask for more", joint=joint.name)
                units.append((joint, servo, value))
        for joint, servo, value in units:
            model = load_model(servo.model)
            unit = model.acceleration_unit_rad_s2
            if model.acceleration_register and unit:
                self._write_checked(joint, servo, model.acceleration_register, int(PROFILE_ACCELERATION_RAD_S2 / unit))
            self._write_checked(joint, servo, model.speed_register, value)
        self._limited = True

    def torque_on(self) -> None:
        """Hold the arm where it is: goal = present, then torque, each read back.

        Speeds that haven't been limited yet are limited to the joints' own. If a servo fails, torque is off again.
        """
        self._need_connection()
        if not self._limited:
            self.set_speeds([joint.max_speed_rad_s for joint in self._joints])
        try:
            for joint, servo in self._servos():
                self._write_checked(joint, servo, "goal_position", self._bus.read(servo.id, "present_position"))
            for joint, servo in self._servos():
                self._write_checked(joint, servo, "torque_enable", 1)
            self._check_alarms()
        except DriverError:
            self._release_quietly()
            raise
        self._torque = True

    def torque_off(self) -> None:
        """Let the arm go limp. All servos are told even if one fails; the first failure is raised then."""
        self._torque = False
        failures: list[DriverError] = []
        for joint, servo in self._servos():
            try:
                self._write_checked(joint, servo, "torque_enable", 0)
            except DriverError as failure:
                failures.append(failure)
        if failures:
            raise failures[0]

    def command(self, q_rad: ArrayLike) -> int:
        """Send all joints to angles (J,) at once; returns the stamp (ns).

        Raises ArmFault, before anything is sent, for an angle outside a joint's limits or with torque off.
        """
        self._need_connection()
        angles = self._vector(q_rad, "angles")
        if not self._torque:
            raise ArmFault("the arm's torque is off; call torque_on() before command()")
        goals: dict[int, int] = {}
        for joint, angle in zip(self._joints, angles, strict=True):
            low, high = joint.lower_rad - LIMIT_TOLERANCE_RAD, joint.upper_rad + LIMIT_TOLERANCE_RAD
            if not low <= angle <= high:  # NaN is outside, too
                raise ArmFault(
                    f"joint '{joint.name}': commanded to {math.degrees(angle):.2f} deg; its limits are "
                    f"{math.degrees(joint.lower_rad):.2f} to {math.degrees(joint.upper_rad):.2f} deg; "
                    "change the motion or limits_deg in rig.toml",
                    joint=joint.name,
                )
            goals |= {servo.id: servo.count(angle) for servo in joint.servos}
        return self._bus.sync_write("goal_position", goals)

    def read(self) -> ArmReading:
        """Measure all joints; raises ServoFault for an alarm, ArmFault for ganged servos that disagree."""
        self._need_connection()
        readings = self._bus.read_many([servo.id for _, servo in self._servos()], "present_position")
        self._check_alarms()
        q_rad = np.array([self._joint_angle(joint, readings) for joint in self._joints], dtype=np.float64)
        own = [[readings[servo.id] for servo in joint.servos] for joint in self._joints]
        t_joint_ns = np.array([(r[0].t_request_ns + r[-1].t_reply_ns) // 2 for r in own], dtype=np.int64)
        q_rad.setflags(write=False)
        t_joint_ns.setflags(write=False)
        return ArmReading(
            t_request_ns=min(reading.t_request_ns for reading in readings.values()),
            t_reply_ns=max(reading.t_reply_ns for reading in readings.values()),
            q_rad=q_rad,
            t_joint_ns=t_joint_ns,
        )

    def _servos(self) -> Iterator[tuple[JointConfig, ServoConfig]]:
        return ((joint, servo) for joint in self._joints for servo in joint.servos)

    def _need_connection(self) -> None:
        if not self._connected:
            raise ArmFault("the arm isn't connected; call connect() first: it checks the servos' models")

    def _vector(self, values: ArrayLike, what: str) -> list[float]:
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (len(self._joints),):
            raise ArmFault(f"{what} have shape {array.shape}; want {(len(self._joints),)}: {', '.join(self.names)}")
        return [float(value) for value in array]

    def _write_checked(self, joint: JointConfig, servo: ServoConfig, register: str, value: int) -> None:
        """Write a register and read it back."""
        self._bus.write(servo.id, register, value)
        have = self._bus.read(servo.id, register)
        if have != value:
            text = f"servo {servo.id} ({joint.name}): wrote {value} to '{register}', it reads {have}"
            raise ServoFault(f"{text}; check the servo's limits and that nothing else writes to it", servo_id=servo.id)

    def _release_quietly(self) -> None:
        with contextlib.suppress(DriverError):  # the failure that led here is the one to report
            self.torque_off()

    def _joint_angle(self, joint: JointConfig, readings: dict[int, Reading]) -> float:
        angles = [servo.q_rad(readings[servo.id].value) for servo in joint.servos]
        spread = max(angles) - min(angles)
        if spread > self._disagreement_rad:
            each = ", ".join(
                f"servo {servo.id} at {math.degrees(angle):.1f} deg"
                for servo, angle in zip(joint.servos, angles, strict=True)
            )
            raise ArmFault(
                f"joint '{joint.name}': its ganged servos disagree: {each}; the limit is "
                f"{math.degrees(self._disagreement_rad):.1f} deg; check 'sign' and 'zero' in rig.toml, and the horns",
                joint=joint.name,
            )
        return sum(angles) / len(angles)

    def _check_alarms(self) -> None:
        """Raise ServoFault for the first servo whose last status told of an alarm."""
        for joint, servo in self._servos():
            if servo.id not in self._bus.alarms:
                continue
            flags = self._bus.alarms[servo.id]
            model = load_model(servo.model)
            if model.hardware_error_register is not None:
                flags = model.error_names(self._bus.read(servo.id, model.hardware_error_register)) or flags
            raise ServoFault(
                f"servo {servo.id} ({joint.name}) on {self._bus.where} reports {', '.join(flags)}; "
                "let it cool, relieve the load, check the supply, then switch it off and on",
                servo_id=servo.id,
                flags=flags,
            )

    def _check_settings(self, joint: JointConfig, servo: ServoConfig, model: ServoModel) -> None:
        """Alarms and settings of one servo that keep it from being used."""
        who = f"servo {servo.id} ({joint.name}) on {self._bus.where}"
        try:
            level = self._bus.read(servo.id, "status_return_level")
        except NoReply as error:
            text = f"{who} answers pings, but no reads; its status return level may be 0, it must be {_ALL_STATUS}"
            raise NoReply(text, servo_id=servo.id) from error
        self._check_alarms()
        if level != _ALL_STATUS:
            text = f"{who} answers reads, but no writes: its status return level is {level}, set it to {_ALL_STATUS}"
            raise ServoFault(text, servo_id=servo.id)
        has = model.registers
        if "operating_mode" in has and (mode := self._bus.read(servo.id, "operating_mode")) != _POSITION_MODE:
            text = f"{who} is in operating mode {mode}; set it to {_POSITION_MODE} (position control)"
            raise ServoFault(text, servo_id=servo.id)
        if "drive_mode" in has and self._bus.read(servo.id, "drive_mode") & _TIME_BASED_PROFILE:
            raise ServoFault(f"{who} has a time-based profile; clear bit 2 of its drive mode", servo_id=servo.id)
        low, high = (self._bus.read(servo.id, name) for name in model.position_limit_registers)
        ends = sorted(servo.count(q_rad) for q_rad in (joint.lower_rad, joint.upper_rad))
        if ends[0] < low or ends[1] > high:  # the servo would refuse, and a sync write wouldn't tell
            raise ArmFault(
                f"{who} goes from count {low} to {high}, the joint's limits are {ends[0]} to {ends[1]}; "
                "narrow limits_deg in rig.toml, or widen the servo's own position limits",
                joint=joint.name,
            )
