"""One emulated servo: its control table, and a shaft that moves within limits of speed and acceleration."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from drivers.errors import DriverError
from drivers.servo_models import Register, ServoModel, load_model

HISTORY_NS = 5_000_000_000  # how far back the shaft's angle is known
# rad/s^2. What a small geared servo with an arm's link on it reaches; the manuals give stall torque, but no inertia.
DEFAULT_ACCELERATION_RAD_S2 = 40.0
_BEGINNING_NS = -(1 << 62)


class Refusal(Enum):
    """Why a servo doesn't do what it is told; the bus puts it into its protocol's error byte."""

    INSTRUCTION = "instruction"
    RANGE = "range"
    LENGTH = "length"
    LIMIT = "limit"
    ACCESS = "access"
    RESULT = "result"


class Refused(Exception):
    """Raised by a servo that refuses an instruction; it never leaves the emulator."""

    def __init__(self, reason: Refusal) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class _Segment:
    """Motion of constant acceleration from `t_ns` on."""

    t_ns: int
    rad: float
    rad_s: float
    rad_s2: float

    def at(self, t_ns: int) -> tuple[float, float]:
        """Angle and speed at a time."""
        dt = (t_ns - self.t_ns) * 1e-9
        return self.rad + dt * (self.rad_s + 0.5 * self.rad_s2 * dt), self.rad_s + self.rad_s2 * dt


def plan_motion(rad: float, rad_s: float, goal: float, speed: float, acceleration: float) -> list[tuple[float, float]]:
    """The quickest motion to a goal as [(duration s, acceleration rad/s^2)], from any present speed.

    A speed over the limit is brought down at `acceleration`; a shaft that can't stop before the goal runs past it and
    returns. At the end the shaft stands at the goal.
    """
    stop = rad + rad_s * abs(rad_s) / (2 * acceleration)
    sign = 1.0 if goal >= stop else -1.0
    v, distance = sign * rad_s, sign * (goal - rad)
    peak = min(speed, math.sqrt(max(0.0, acceleration * distance + 0.5 * v * v)))
    first = acceleration if v <= peak else -acceleration
    travelled = (peak * peak - v * v) / (2 * first) + peak * peak / (2 * acceleration)
    cruise = (distance - travelled) / peak if peak > 0 else 0.0
    phases = [((peak - v) / first, first), (max(0.0, cruise), 0.0), (peak / acceleration, -acceleration)]
    return [(duration, sign * a) for duration, a in phases if duration > 0]


class Shaft:
    """The angle of a shaft as a function of time over the last HISTORY_NS, in phases of constant acceleration."""

    def __init__(self, rad: float) -> None:
        self._segments = [_Segment(_BEGINNING_NS, rad, 0.0, 0.0)]
        self._starts = [_BEGINNING_NS]

    def at(self, t_ns: int) -> tuple[float, float]:
        """Angle (rad) and speed (rad/s); raises DriverError for a time before the history."""
        if t_ns < self._starts[0]:
            raise DriverError(f"the shaft's angle is known for the last {HISTORY_NS * 1e-9:g} s only")
        return self._segment(t_ns).at(t_ns)

    def acceleration(self, t_ns: int) -> float:
        """Acceleration at a time, rad/s^2."""
        return self._segment(t_ns).rad_s2

    def moving(self, t_ns: int) -> bool:
        """Whether the motion that was planned last is still under way."""
        return t_ns < self._starts[-1]

    def move(self, t_ns: int, goal: float, speed: float, acceleration: float) -> None:
        """From `t_ns` on, go to a goal, from the speed it has then."""
        rad, rad_s = self.at(t_ns)
        self._replace(t_ns, plan_motion(rad, rad_s, goal, speed, acceleration), goal)

    def brake(self, t_ns: int, acceleration: float) -> None:
        """From `t_ns` on, come to a stop."""
        rad, rad_s = self.at(t_ns)
        if rad_s == 0.0:
            self._replace(t_ns, [], rad)
            return
        sign = math.copysign(1.0, rad_s)
        stop = rad + sign * rad_s * rad_s / (2 * acceleration)
        self._replace(t_ns, [(abs(rad_s) / acceleration, -sign * acceleration)], stop)

    def _segment(self, t_ns: int) -> _Segment:
        return self._segments[max(0, bisect.bisect_right(self._starts, t_ns) - 1)]

    def _replace(self, t_ns: int, phases: Sequence[tuple[float, float]], end: float) -> None:
        keep_to = bisect.bisect_left(self._starts, t_ns)
        keep_from = max(0, bisect.bisect_right(self._starts, t_ns - HISTORY_NS) - 1)
        rad, rad_s = self.at(t_ns)
        segments = self._segments[min(keep_from, keep_to) : keep_to]
        for duration, acceleration in phases:
            segments.append(_Segment(t_ns, rad, rad_s, acceleration))
            t_end_ns = t_ns + math.ceil(duration * 1e9)
            dt = duration
            rad, rad_s = rad + dt * (rad_s + 0.5 * acceleration * dt), rad_s + acceleration * dt
            t_ns = t_end_ns
        segments.append(_Segment(t_ns, end, 0.0, 0.0))
        self._segments = segments
        self._starts = [segment.t_ns for segment in segments]


class EmulatedServo:
    """A servo with its control table, as it comes out of the box but for its id.

    Args:
        id: 0 to 252.
        model: a name of `drivers.servo_models.MODELS`.
        initial_count: where the shaft stands; the model's zero count if None.
        max_speed_rad_s: the fastest that it can turn; the model's no-load speed if None.
        max_acceleration_rad_s2: what its motor can do with the load that is on it.
        voltage_v, temperature_c: what its sensors say.

    Not emulated: other modes than position control, homing offset, reversed drive mode, indirect addresses, load
    that depends on the arm's pose.
    """

    def __init__(
        self,
        id: int,
        model: str,
        *,
        initial_count: int | None = None,
        max_speed_rad_s: float | None = None,
        max_acceleration_rad_s2: float = DEFAULT_ACCELERATION_RAD_S2,
        voltage_v: float = 12.0,
        temperature_c: float = 32.0,
        protocol: float | None = None,
    ) -> None:
        self.model: ServoModel = load_model(model)
        self._max_speed_rad_s = max_speed_rad_s or self.model.no_load_rad_s
        self._max_acceleration_rad_s2 = max_acceleration_rad_s2
        self._voltage_v, self._temperature_c = voltage_v, temperature_c
        count = self.model.zero_count if initial_count is None else initial_count
        self.shaft = Shaft(self.model.rad(count))
        self._registered: tuple[int, bytes] | None = None
        self.alarm = 0  # bits of the model's error_bits
        self._memory = bytearray(self.model.size_bytes)
        self._power_up(count, keep=())
        self.set("id", id)
        if protocol is not None and protocol not in self.model.protocols:
            spoken = " and ".join(f"{known:.1f}" for known in self.model.protocols)
            raise DriverError(f"servo {id}: {self.model.name} speaks protocol {spoken}; have {protocol:g}")
        self._protocol = protocol or self.model.protocols[-1]
        if "protocol_type" in self.model.registers:
            self.set("protocol_type", int(self._protocol))

    @property
    def protocol(self) -> float:
        """The protocol that it speaks."""
        return self._protocol

    @property
    def secondary_id(self) -> int | None:
        """The id of others that it obeys too."""
        if "secondary_id" not in self.model.registers or (id := self.get("secondary_id")) > 252:
            return None
        return id

    @property
    def voltage_v(self) -> float:
        """The supply voltage."""
        return self._voltage_v

    @property
    def temperature_c(self) -> float:
        """The temperature."""
        return self._temperature_c

    def clear_turns(self, t_ns: int) -> None:
        """Count turns anew."""
        if self.shaft.moving(t_ns):
            raise Refused(Refusal.RESULT)

    def store_backup(self) -> None:
        """Store."""
        if self.get("torque_enable"):
            raise Refused(Refusal.RESULT)
        self._backup = {r.name: self.get(r.name) for r in self.model.registers.values() if r.area == "EEPROM"}

    def restore_backup(self, t_ns: int) -> None:
        """Restore."""
        if self.get("torque_enable") or not hasattr(self, "_backup"):
            raise Refused(Refusal.RESULT)
        for name, value in self._backup.items():
            self.set(name, value)
        self.reboot(t_ns)

    def hear(self, t_ns: int) -> None:
        """An instruction packet went over the wire."""

    def advance(self, t_ns: int) -> None:
        """Live until a time."""

    def shaft_rad(self, t_ns: int) -> float:
        """The shaft's angle."""
        return self.shaft.at(t_ns)[0]

    def set_voltage(self, volt: float, t_ns: int) -> None:
        """Another supply."""
        self._voltage_v = volt

    def set_temperature(self, celsius: float, t_ns: int) -> None:
        """Another temperature."""
        self._temperature_c = celsius

    def obstruct(self, lower_rad: float, upper_rad: float, t_ns: int) -> None:
        """Something is in the way."""
        self._free = (lower_rad, upper_rad)

    @property
    def id(self) -> int:
        """The id it answers to."""
        return self.get("id")

    @property
    def baud(self) -> int:
        """The baud that it listens at."""
        return self.model.baud_codes.get(self.get("baud_rate"), 0)

    @property
    def return_delay_ns(self) -> int:
        """Time between an instruction and its status packet (Return Delay Time: 2 us a unit)."""
        return self.get("return_delay_time") * 2000

    def get(self, register: str) -> int:
        """The value of a register as it was last written or sampled."""
        at = self.model.register(register)
        return at.decode(bytes(self._memory[at.address : at.address + at.size]))

    def set(self, register: str, value: int) -> None:
        """Set a register from inside, with no check and no consequence for the shaft."""
        at = self.model.register(register)
        self._memory[at.address : at.address + at.size] = at.encode(value)

    def read(self, address: int, length: int, t_ns: int) -> bytes:
        """Bytes of the control table at a time; gaps between registers read as zeros."""
        if length < 1 or address + length > self.model.size_bytes:
            raise Refused(Refusal.ACCESS)
        self._sample(t_ns)
        return bytes(self._memory[address : address + length])

    def write(self, address: int, data: bytes, t_ns: int) -> None:
        """Write whole registers; refused as a whole if one of them is."""
        registers = self._registers(address, len(data))
        for register in registers:
            self._check(register, register.decode(data[register.address - address :][: register.size]))
        self._memory[address : address + len(data)] = data
        names = {register.name for register in registers}
        if "torque_enable" in names and not self.get("torque_enable"):
            self.shaft.brake(t_ns, self._max_acceleration_rad_s2)
        elif names & self._motion_registers():
            self._steer(t_ns)

    def register_write(self, address: int, data: bytes) -> None:
        """Keep a write for `action`; it is checked now."""
        for register in self._registers(address, len(data)):
            self._check(register, register.decode(data[register.address - address :][: register.size]))
        self._registered = address, data
        self.set(self.model.registered_flag, 1)

    def action(self, t_ns: int) -> None:
        """Do the write that was registered."""
        if self._registered is None:
            raise Refused(Refusal.INSTRUCTION)
        (address, data), self._registered = self._registered, None
        self.set(self.model.registered_flag, 0)
        self.write(address, data, t_ns)

    def reboot(self, t_ns: int) -> None:
        """Restart: EEPROM is kept, RAM goes to its initial values, torque is off, alarms are gone."""
        self._restart(t_ns, keep=[r.name for r in self.model.registers.values() if r.area == "EEPROM"])

    def factory_reset(self, t_ns: int, *, keep: Sequence[str] = ()) -> None:
        """All registers to their initial values, but for those to keep."""
        self._restart(t_ns, keep=keep)

    def raise_alarm(self, name: str, t_ns: int) -> None:
        """Let an error happen, by its name in the model's error_bits; what Shutdown says then follows."""
        bits = {text: bit for bit, text in self.model.error_bits.items()}
        if name not in bits:
            raise DriverError(f"{self.model.name} has no alarm '{name}'; it has {', '.join(bits)}")
        self.alarm |= 1 << bits[name]
        if self.model.hardware_error_register is not None:
            self.set(self.model.hardware_error_register, self.alarm)
        if self.alarm & self.get("shutdown"):
            # X: torque is off until a reboot. AX: Torque Limit becomes 0 until it is written (e-manual, Shutdown).
            self.set("torque_limit" if "torque_limit" in self.model.registers else "torque_enable", 0)
            self.shaft.brake(t_ns, self._max_acceleration_rad_s2)

    def _restart(self, t_ns: int, *, keep: Sequence[str]) -> None:
        self.shaft.brake(t_ns, self._max_acceleration_rad_s2)
        self._registered, self.alarm = None, 0
        self._power_up(self.model.count(self.shaft.at(t_ns)[0]), keep)

    def _power_up(self, count: int, keep: Sequence[str]) -> None:
        for register in self.model.registers.values():
            if register.name not in keep:
                self.set(register.name, register.initial or 0)
        self.set("goal_position", count)
        if "torque_limit" in self.model.registers:  # e-manual, Max Torque (14): Torque Limit's value at power-up
            self.set("torque_limit", self.get("max_torque"))

    def _registers(self, address: int, length: int) -> list[Register]:
        """The registers that these bytes cover; refused if one is covered in part, or a byte is no register's."""
        end = address + length
        if length < 1 or end > self.model.size_bytes:
            raise Refused(Refusal.ACCESS)
        covered = [r for r in self.model.registers.values() if r.address < end and r.address + r.size > address]
        if any(r.address < address or r.address + r.size > end for r in covered):
            raise Refused(Refusal.LENGTH)
        if sum(r.size for r in covered) != length:
            raise Refused(Refusal.ACCESS)
        return covered

    def _check(self, register: Register, value: int) -> None:
        if not register.writable:
            raise Refused(Refusal.ACCESS)
        # X: EEPROM is locked while torque is on (X-series manual, Control Table). AX: by Lock (47) alone.
        locked = self.get("lock") if "lock" in self.model.registers else self.get("torque_enable")
        if register.area == "EEPROM" and locked:
            raise Refused(Refusal.ACCESS)
        if "lock" in self.model.registers and register.name == "lock" and locked and value == 0:
            raise Refused(Refusal.ACCESS)  # only a power cycle unlocks
        if register.minimum is not None and value < register.minimum:
            raise Refused(Refusal.RANGE)
        if register.maximum is not None and value > register.maximum:
            raise Refused(Refusal.RANGE)
        if register.name == "torque_enable" and value and self.alarm and self.model.hardware_error_register:
            raise Refused(Refusal.ACCESS)  # after a shutdown only a reboot gives torque back
        if register.name == "goal_position":
            low, high = (self.get(name) for name in self.model.position_limit_registers)
            if not low <= value <= high:
                raise Refused(Refusal.LIMIT)

    def _motion_registers(self) -> set[str]:
        names = {"torque_enable", "goal_position", "torque_limit", self.model.speed_register, "velocity_limit"}
        return names | ({self.model.acceleration_register} if self.model.acceleration_register else set())

    def _steer(self, t_ns: int) -> None:
        """Set out for the goal, from the present angle and speed."""
        has_torque = self.get("torque_limit") > 0 if "torque_limit" in self.model.registers else True
        if not self.get("torque_enable") or not has_torque:
            return
        speed, acceleration = self._max_speed_rad_s, self._max_acceleration_rad_s2
        if limit := self.get(self.model.speed_register):
            speed = min(speed, abs(limit) * self.model.speed_unit_rad_s)
        if "velocity_limit" in self.model.registers:
            speed = min(speed, self.get("velocity_limit") * self.model.speed_unit_rad_s)
        unit = self.model.acceleration_unit_rad_s2
        if self.model.acceleration_register and unit and (limit := self.get(self.model.acceleration_register)):
            acceleration = min(acceleration, limit * unit)
        # A limit of 0 would never arrive: no speed at all is as good as a brake.
        if speed <= 0:
            self.shaft.brake(t_ns, acceleration)
        else:
            self.shaft.move(t_ns, self.model.rad(self.get("goal_position")), speed, acceleration)

    def _sample(self, t_ns: int) -> None:
        """Fill the registers that tell of the present."""
        rad, rad_s = self.shaft.at(t_ns)
        moving = self.shaft.moving(t_ns)
        has, model = self.model.registers, self.model
        count = model.count(rad)
        if model.acceleration_register is None:  # the AX's potentiometer ends at 0 and 1023
            count = min(max(count, 0), model.resolution - 1)
        speed = round(rad_s / model.speed_unit_rad_s)
        # per mille of the torque: friction, and what accelerates the link
        load = round(1000 * (0.05 * (rad_s > 0) - 0.05 * (rad_s < 0) + 0.3 * self._effort(t_ns)))
        self.set("present_position", count)
        self.set(model.present_speed_register, max(-1023, min(1023, speed)))
        self.set("moving", int(moving))
        self.set(model.voltage_register, round(10 * self._voltage_v) - int(moving))
        self.set("present_temperature", round(self._temperature_c))
        if "present_load" in has:
            self.set("present_load", load)
        if "present_current" in has:
            self.set("present_current", load)
        if "realtime_tick" in has:
            self.set("realtime_tick", t_ns // 1_000_000 % 32768)

    def _effort(self, t_ns: int) -> float:
        return self.shaft.acceleration(t_ns) / self._max_acceleration_rad_s2
