"""An arm: joints made of one or several servos, commanded and read in radians, within its limits."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.checked_writes import read_each, write_together
from drivers.clock import Clock
from drivers.dynamixel import Block, DynamixelBus
from drivers.errors import ArmFault, DriverError, ServoFault
from drivers.joints import JointConfig, ServoConfig
from drivers.safety import SafetyLimits, ServoRange, ServoState, Watch
from drivers.servo_settings import check_model, check_settings

FloatArray = NDArray[np.float64]

# rad. Ganged servos that differ by more than this fight each other, or one of them has slipped.
DISAGREEMENT_RAD = math.radians(5.0)
# rad/s^2. Profile Acceleration of servos that have one: full speed of an arm in about a tenth of a second.
PROFILE_ACCELERATION_RAD_S2 = 10.0
# rad or m. A command at the limit may be over it by the rounding of float64.
LIMIT_TOLERANCE = 1e-9
TORQUE_LIMIT = "torque_limit"
WATCHDOG = "bus_watchdog"
WATCHDOG_UNIT_S, WATCHDOG_MOST = 0.02, 127  # X-series manual, Bus Watchdog (98)


@dataclass(frozen=True, eq=False)
class ArmReading:
    """Measured joint states.

    Attributes:
        t_request_ns, t_reply_ns: of the first request and the last reply.
        q: (J,) states, rad or m; the mean of ganged servos.
        t_joint_ns: (J,) midpoints of each joint's own requests and replies: servos answer one after the other.
        servos: what each servo says of itself, by id.
    """

    t_request_ns: int
    t_reply_ns: int
    q: FloatArray
    t_joint_ns: NDArray[np.int64]
    servos: Mapping[int, ServoState]

    @property
    def t_ns(self) -> int:
        """Midpoint of request and reply."""
        return (self.t_request_ns + self.t_reply_ns) // 2


class Arm:
    """Joints on a servo bus. State of a joint: sign * (shaft angle - shaft angle at the zero count) / ratio.

    Nothing moves before `torque_on`, and nothing ever moves faster than the joints' limits. Every error names the
    joint. `connect` first.

    Args:
        disagreement_rad: ganged servos whose shafts differ by more are a fault.
        limits: when a reading is a reason to stop.

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
        limits: SafetyLimits | None = None,
    ) -> None:
        self._bus, self._joints, self._clock = bus, tuple(joints), clock
        self._disagreement_rad = disagreement_rad
        self._limits = limits or SafetyLimits()
        self._watch: Watch | None = None  # once connected
        self._torque = self._limited = False
        self._goals: list[float] | None = None
        self._heard_ns = 0
        ids = [servo.id for _, servo in self._servos()]
        for what, values in (("joint", self.names), ("servo", ids)):
            if len(set(values)) != len(values):
                raise DriverError(f"a {what} appears twice: {', '.join(map(str, values))}; give each its own")
        for joint, servo in self._servos():
            if bus.protocol not in servo.table.protocols:
                raise DriverError(f"servo {servo.id} ({joint.name}): {servo.model} doesn't speak {bus.protocol:.1f}")
            bus.label(servo.id, joint.name)
        self._ids = tuple(ids)
        self._readers = {servo.id: _reader(servo) for _, servo in self._servos()}
        self._status_registers = {servo.id: servo.table.status_registers for _, servo in self._servos()}

    @property
    def names(self) -> tuple[str, ...]:
        """The joints' names, in the order of all arrays (J,)."""
        return tuple(joint.name for joint in self._joints)

    @property
    def bus_errors(self) -> dict[str, int]:
        """Counts of what went wrong on the bus and was mended."""
        return self._bus.errors

    def connect(self) -> None:
        """Find every servo and see that it is fit for use; writes nothing. Opens the port if it isn't open.

        Raises:
            NoReply: for a servo that isn't there, or doesn't answer reads.
            WrongModel: for a servo of another model than configured.
            ServoFault: for an alarm, or settings under which the driver can't work.
            ArmFault: the joint's limits are wider than the servo's own.
        """
        self._bus.open()
        for joint, servo in self._servos():
            check_model(self._bus, joint, servo)
        own: dict[int, ServoRange] = {}
        for joint, servo in self._servos():
            own[servo.id] = check_settings(self._bus, joint, servo)
            self._check_alarms()
        self._torque, self._limited, self._goals = False, False, None
        self._watch = Watch(self._joints, self._limits, own)

    def set_speeds(self, speeds: ArrayLike) -> None:
        """Limit the joints' speeds (J,), rad/s or m/s, by the servos' own registers; rounded down to a whole unit.

        0 in those registers is no limit: it is never written. Raises ArmFault for a speed over the joint's limit, or
        so small that it would round to 0, before anything is sent.
        """
        self._need_connection()
        units: list[tuple[ServoConfig, int]] = []
        speeds_of: dict[str, dict[int, int]] = {}
        accelerations: dict[str, dict[int, int]] = {}
        for joint, speed in zip(self._joints, self._vector(speeds, "speeds"), strict=True):
            units += [(servo, _speed_units(joint, servo, speed)) for servo in joint.servos if servo.takes_goals]
            units += [(servo, units[-1][1]) for servo in joint.servos if servo.ganging == "secondary_id"]
        for servo, value in units:
            model = servo.table
            speeds_of.setdefault(model.speed_register, {})[servo.id] = value
            if model.acceleration_register and (unit := model.acceleration_unit_rad_s2):
                accelerations.setdefault(model.acceleration_register, {})[servo.id] = int(
                    PROFILE_ACCELERATION_RAD_S2 / unit
                )
        write_together(self._bus, accelerations | speeds_of)
        self._limited = True

    def torque_on(self) -> None:
        """Hold the arm where it is: goal = present, then torque, each read back; then the bus watchdog.

        Speeds that haven't been limited yet are limited to the joints' own. Raises ArmFault for ganged servos that
        disagree, before torque is on. If a servo fails, torque is off again.
        """
        self._need_connection()
        if not self._limited:
            self.set_speeds([joint.max_speed for joint in self._joints])
        self.read()  # ganged servos that disagree would fight
        try:
            self._set_watchdog(0.0)  # one that has tripped refuses goals
            self._restore_torque_limits()
            self._hold()
            write_together(self._bus, {"torque_enable": dict.fromkeys(self._ids, 1)})
            self._check_alarms()
            self._set_watchdog(self._limits.watchdog_s)
        except DriverError:
            with contextlib.suppress(DriverError):  # the failure that led here is the one to report
                self.torque_off()
            raise
        self._torque = True

    def torque_off(self) -> None:
        """Let the arm go limp. All servos are told even if one fails; the first failure is raised then."""
        self._torque, self._goals = False, None
        try:
            write_together(self._bus, {"torque_enable": dict.fromkeys(self._ids, 0)})
        finally:
            self._set_watchdog(0.0)

    def holding(self) -> tuple[str, ...]:
        """Names of the joints of which a servo has torque: those that drop when it is switched off. Writes nothing."""
        torque = self._bus.read_many(self._ids, "torque_enable")
        return tuple(joint.name for joint in self._joints if any(torque[s.id].value for s in joint.servos))

    def stop(self) -> None:
        """Hold the arm where it is now; torque stays as it is."""
        self._need_connection()
        self._set_watchdog(0.0)
        self._hold()
        if self._torque:
            self._set_watchdog(self._limits.watchdog_s)

    def leave_holding(self) -> None:
        """Hold the arm where it is, for good: nobody needs to talk to it any more."""
        self._need_connection()
        self._set_watchdog(0.0)
        self._hold()

    def command(self, q: ArrayLike) -> int:
        """Send all joints to states (J,), rad or m, at once; returns the stamp (ns).

        Raises ArmFault, before anything is sent, for a state outside a joint's limits or with torque off.
        """
        self._need_connection()
        wanted = self._vector(q, "states")
        if not self._torque:
            raise ArmFault("the arm's torque is off; call torque_on() before command()")
        goals: dict[int, int] = {}
        for joint, state in zip(self._joints, wanted, strict=True):
            if not joint.lower - LIMIT_TOLERANCE <= state <= joint.upper + LIMIT_TOLERANCE:  # NaN is outside, too
                raise ArmFault(
                    f"joint '{joint.name}': commanded to {joint.text(state)}; its limits are "
                    f"{joint.text(joint.lower)} to {joint.text(joint.upper)}; "
                    "change the motion or the joint's limits in rig.toml",
                    joint=joint.name,
                )
            goals |= {servo.id: servo.count(state) for servo in joint.servos if servo.takes_goals}
        self._goals = wanted
        return self._bus.sync_write("goal_position", goals)

    def read(self) -> ArmReading:
        """Measure all joints, and look whether there is a reason to stop.

        Raises:
            ServoFault: for an alarm.
            ArmFault: for ganged servos that disagree, and after a silence in which a bus watchdog has tripped.
            SafetyStop: for a temperature, voltage or load outside the limits, and for a stall.
        """
        watch = self._need_connection()
        blocks = self._bus.read_blocks(self._status_registers)
        self._check_alarms()
        self._check_silence(min(block.t_request_ns for block in blocks.values()))
        states = {servo_id: self._readers[servo_id](block) for servo_id, block in blocks.items()}
        own = [[blocks[servo.id] for servo in joint.servos] for joint in self._joints]
        q = np.array([self._joint_state(*each, states) for each in zip(self._joints, own, strict=True)])
        t_joint_ns = np.array([(b[0].t_request_ns + b[-1].t_reply_ns) // 2 for b in own], dtype=np.int64)
        q.setflags(write=False)
        t_joint_ns.setflags(write=False)
        reading = ArmReading(
            t_request_ns=min(block.t_request_ns for block in blocks.values()),
            t_reply_ns=max(block.t_reply_ns for block in blocks.values()),
            q=q,
            t_joint_ns=t_joint_ns,
            servos=states,
        )
        self._heard_ns = reading.t_reply_ns
        watch.check(reading.t_ns, states, q.tolist(), self._goals)
        return reading

    def _servos(self) -> Iterator[tuple[JointConfig, ServoConfig]]:
        return ((joint, servo) for joint in self._joints for servo in joint.servos)

    def _need_connection(self) -> Watch:
        if self._watch is None:
            raise ArmFault("the arm isn't connected; call connect() first: it checks the servos' models")
        return self._watch

    def _vector(self, values: ArrayLike, what: str) -> list[float]:
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (len(self._joints),):
            raise ArmFault(f"{what} have shape {array.shape}; want {(len(self._joints),)}: {', '.join(self.names)}")
        return [float(value) for value in array]

    def _hold(self) -> None:
        """Goal = present, of all servos that answer; the first failure is raised then.

        A leader's goal reaches its followers by secondary id, so that theirs come after it.
        """
        self._goals = None
        ids = [servo.id for _, servo in self._servos() if servo.ganging != "sync_cable"]
        present, failures = read_each(self._bus, ids, "present_position")
        if present:
            write_together(self._bus, {"goal_position": present})
        if failures:
            raise failures[0]

    def _restore_torque_limits(self) -> None:
        """After a shutdown servos without reboot have a torque limit of 0 until it is written (e-manual, Shutdown)."""
        ids = [servo.id for _, servo in self._servos() if servo.table.recovery == "torque_limit"]
        limits, failures = read_each(self._bus, ids, TORQUE_LIMIT) if ids else ({}, [])
        lost = {servo_id: self._bus.read(servo_id, "max_torque") for servo_id, limit in limits.items() if not limit}
        if lost:
            write_together(self._bus, {TORQUE_LIMIT: lost})
        if failures:
            raise failures[0]

    def _set_watchdog(self, seconds: float) -> None:
        """Have the servos that can stop when they hear nothing for so long; 0 ends that."""
        units = min(math.ceil(seconds / WATCHDOG_UNIT_S), WATCHDOG_MOST)
        watching = [servo.id for _, servo in self._servos() if WATCHDOG in servo.table.registers]
        if watching:
            write_together(self._bus, {WATCHDOG: dict.fromkeys(watching, units)})
        self._heard_ns = self._clock.now_ns()

    def _check_silence(self, t_ns: int) -> None:
        """Raise ArmFault if the station said nothing for so long that a watchdog has tripped."""
        silence_s = (t_ns - self._heard_ns) * 1e-9
        if not self._torque or not 0 < self._limits.watchdog_s < silence_s:
            return
        stopped = [
            f"{servo.id} ({joint.name})"
            for joint, servo in self._servos()
            if WATCHDOG in servo.table.registers and self._bus.read(servo.id, WATCHDOG) < 0
        ]
        if stopped:
            self._set_watchdog(0.0)
            raise ArmFault(
                f"nothing was said on {self._bus.where} for {silence_s:.1f} s: servos {', '.join(stopped)} stopped by "
                "their bus watchdog; give the station more processor time, or raise watchdog_s in the rig"
            )

    def _joint_state(self, joint: JointConfig, blocks: Sequence[Block], states: Mapping[int, ServoState]) -> float:
        values = [servo.q(states[servo.id].count) for servo in joint.servos]
        # One is read after the other: what the joint turns by in between is no disagreement.
        took_s = (max(block.t_reply_ns for block in blocks) - min(block.t_request_ns for block in blocks)) * 1e-9
        turned_rad = took_s * max(abs(states[servo.id].speed_rad_s) for servo in joint.servos)
        if (max(values) - min(values)) * joint.servos[0].ratio > self._disagreement_rad + turned_rad:
            each = ", ".join(
                f"servo {servo.id} at {joint.text(value)}" for servo, value in zip(joint.servos, values, strict=True)
            )
            raise ArmFault(
                f"joint '{joint.name}': its ganged servos disagree: {each}; the limit is "
                f"{math.degrees(self._disagreement_rad):.1f} deg; check 'sign' and 'zero' in rig.toml, and the horns",
                joint=joint.name,
            )
        return sum(values) / len(values)

    def _check_alarms(self) -> None:
        """Raise ServoFault for the first servo whose last status told of an alarm."""
        alarms = self._bus.alarms
        for joint, servo in self._servos():
            if servo.id not in alarms:
                continue
            flags, model = alarms[servo.id], servo.table
            if model.hardware_error_register is not None:
                flags = model.error_names(self._bus.read(servo.id, model.hardware_error_register)) or flags
            cure = "reboot it (or switch it off and on)" if model.recovery == "reboot" else "switch it off and on"
            raise ServoFault(
                f"servo {servo.id} ({joint.name}) on {self._bus.where} reports {', '.join(flags)}; "
                f"let it cool, relieve the load, check the supply, then {cure}",
                servo_id=servo.id,
                joint=joint.name,
                flags=flags,
            )


def _speed_units(joint: JointConfig, servo: ServoConfig, speed: float) -> int:
    """The speed register's value for a joint's speed; raises ArmFault for one that can't be."""
    unit = "rad/s" if joint.unit == "rad" else "m/s"
    if not 0 < speed <= joint.max_speed * (1 + 1e-12):
        raise ArmFault(
            f"joint '{joint.name}': speed {speed:g} {unit}; its limit is {joint.max_speed:g} {unit}; "
            "lower the motion's speed or raise the joint's greatest speed in rig.toml",
            joint=joint.name,
        )
    model = servo.table
    if (value := model.speed_units_within(speed * servo.ratio)) == 0:
        slowest = model.speed_unit_rad_s / servo.ratio
        text = f"joint '{joint.name}': {speed:g} {unit} is slower than {servo.model} can go ({slowest:.4f})"
        raise ArmFault(f"{text}; ask for more", joint=joint.name)
    return value


def _reader(servo: ServoConfig) -> Callable[[Block], ServoState]:
    """Turns a servo's status registers into quantities; its table is looked into once, not at each reading."""
    model = servo.table
    position, speed, effort, voltage, temperature = model.status_registers
    rad_s, volts, degrees = (model.registers[name].physical for name in (speed, voltage, temperature))

    def read(block: Block) -> ServoState:
        values = block.values
        return ServoState(
            count=values[position],
            speed_rad_s=rad_s(values[speed]),
            load=model.load_share(effort, values[effort]),
            voltage_v=volts(values[voltage]),
            temperature_c=degrees(values[temperature]),
        )

    return read
