"""One emulated servo: what its registers, its motor and its protections do at their times."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from drivers.emulator.body import HAND, STEP_NS, Body
from drivers.emulator.heat import Heat
from drivers.emulator.modes import Mode, bit, frame_of, mode_of
from drivers.emulator.present import Present
from drivers.emulator.protection import NEVER_NS, Protection
from drivers.emulator.shaft import BEGINNING_NS
from drivers.emulator.startup import configure, enter_mode, one_turn, power_up
from drivers.emulator.steering import Steering
from drivers.emulator.table import Refusal, Refused, Table
from drivers.errors import DriverError
from drivers.servo_models import Register, ServoModel, load_model

__all__ = ["DEFAULT_ACCELERATION_RAD_S2", "EmulatedServo", "Refusal", "Refused"]

# rad/s^2. What a small geared servo with an arm's link on it reaches; the manuals give stall torque, but no inertia.
DEFAULT_ACCELERATION_RAD_S2 = 40.0
_GOALS = frozenset({"goal_position", "goal_velocity", "goal_current", "goal_pwm"})


class EmulatedServo:
    """A servo with its control table, as it comes out of the box but for its id and what its owner configured.

    Times of calls don't fall; a call for an earlier time than the latest happens at the latest. What the servo does by
    itself happens at its own time, however often it is asked in between. Its life begins with the first time that it
    is asked or told something.

    Args:
        id: 0 to 252.
        model: a name of `drivers.servo_models.MODELS`.
        initial_count: where the shaft stands, before any homing offset or reversal; the model's zero count if None.
        max_speed_rad_s: the fastest that it can turn; the model's no-load speed if None.
        max_acceleration_rad_s2: what its motor can do with the load that is on it.
        voltage_v: of its supply; the model's nominal voltage if None.
        temperature_c: at first.
        ambient_c: where its temperature goes without load; `temperature_c` if None.
        protocol: that it speaks; the model's factory setting if None.
        eeprom: registers of the EEPROM area as the owner set them; a reboot keeps them, a factory reset doesn't.
        load_nm: torque on the shaft from outside at a time in ns, positive anticlockwise. It is asked every 10 ms of
            the servo's time and held in between; it may ask any servo for its `shaft_rad` at that time, if all are
            advanced together, as a bus does.
        backlash_rad: play between motor and shaft, on whose side the position sensor is.

    Not emulated: the integral and derivative gains, feedforward, Punch of the MX, external ports, S.BUS and the like,
    Startup Configuration, and that a weak supply makes a weak motor.
    """

    def __init__(
        self,
        id: int,
        model: str,
        *,
        initial_count: int | None = None,
        max_speed_rad_s: float | None = None,
        max_acceleration_rad_s2: float = DEFAULT_ACCELERATION_RAD_S2,
        voltage_v: float | None = None,
        temperature_c: float = 32.0,
        ambient_c: float | None = None,
        protocol: float | None = None,
        eeprom: Mapping[str, int] | None = None,
        load_nm: Callable[[int], float] | None = None,
        backlash_rad: float = 0.0,
    ) -> None:
        self.model: ServoModel = load_model(model)
        fastest = max_speed_rad_s or self.model.no_load_rad_s
        self._ambient_c = temperature_c if ambient_c is None else ambient_c
        rad = self.model.rad(self.model.zero_count if initial_count is None else initial_count)
        self.shaft = Body(
            rad,
            max_speed_rad_s=fastest,
            stall_nm=self.model.stall_nm,
            max_acceleration_rad_s2=max_acceleration_rad_s2,
            backlash_rad=backlash_rad,
            load_nm=load_nm,
        )
        self._table = Table(self.model)
        self._present = Present(self._table, self.shaft, fastest)
        self._present.voltage_v = self.model.nominal_v if voltage_v is None else voltage_v
        self._present.heat = Heat(BEGINNING_NS, temperature_c, self._ambient_c)
        self._protection = Protection(self._table, BEGINNING_NS)
        self._steering = Steering(self._table, self.shaft, self._present, fastest, max_acceleration_rad_s2)
        self._registered: tuple[int, bytes] | None = None
        self._backup: dict[str, int] = {}
        self._changes: list[tuple[int, int, Callable[[int], None]]] = []  # a heap, by time and number
        self._changes_seen = 0
        self._now_ns, self._due_ns = BEGINNING_NS, BEGINNING_NS
        self._busy = False
        self._leader: EmulatedServo | None = None
        self._followers: list[EmulatedServo] = []
        self._present.frame = power_up(self._table, rad, configure(self._table, id, protocol, eeprom or {}))

    @property
    def id(self) -> int:
        """The id it answers to."""
        return self.get("id")

    @property
    def alarm(self) -> int:
        """The alarms that are on, as bits of the model's error_bits."""
        return self._protection.alarm

    @property
    def secondary_id(self) -> int | None:
        """The id of a group whose writes it obeys without an answer; None if it has none (253 and up is off)."""
        if "secondary_id" not in self._table:
            return None
        value = self.get("secondary_id")
        return value if value < 253 else None

    @property
    def protocol(self) -> float:
        """The protocol it speaks; of the S.BUS and the like of the 330 servos it is 2.0 that the bus is answered in."""
        if "protocol_type" not in self._table:
            return self.model.protocols[0]
        return 1.0 if self.get("protocol_type") == 1 else 2.0

    @property
    def baud(self) -> int:
        """The baud that it listens at."""
        return self.model.baud_codes.get(self.get("baud_rate"), 0)

    @property
    def voltage_v(self) -> float:
        """The supply's present voltage."""
        return self._present.voltage_v

    def temperature_c(self, t_ns: int) -> float:
        """Its temperature at a time."""
        self.advance(t_ns)
        return self._present.heat.at(self._now_ns)

    @property
    def return_delay_ns(self) -> int:
        """Time between an instruction and its status packet (Return Delay Time: 2 us a unit)."""
        return self.get("return_delay_time") * 2000

    def get(self, register: str) -> int:
        """The value of a register as it was last written or sampled."""
        return self._table.get(register)

    def set(self, register: str, value: int) -> None:
        """Set a register from inside, with no check and no consequence for the shaft."""
        self._table.set(register, value)
        self._present.frame = frame_of(self._table, self._present.frame.turns)

    def advance(self, t_ns: int) -> None:
        """Bring the servo to a time: all that is due until then happens."""
        if self._leader is not None:
            self._leader.advance(t_ns)
            return
        self._advance(t_ns)
        for follower in self._followers:
            follower._advance(t_ns)

    def hear(self, t_ns: int) -> None:
        """An intact instruction packet is on the wire, whoever it is for: the bus watchdog starts anew."""
        self.advance(t_ns)
        self._protection.heard_ns = max(self._protection.heard_ns, t_ns)

    def shaft_rad(self, t_ns: int) -> float:
        """True shaft angle, rad from the model's zero count; raises DriverError if that is longer ago than 5 s."""
        self.advance(t_ns)
        return self.shaft.at(t_ns)[0]

    def read(self, address: int, length: int, t_ns: int) -> bytes:
        """Bytes of the control table at a time; gaps between registers read as zeros."""
        self.advance(t_ns)
        self._present.sample(address, length, self._now_ns)
        return self._table.read(address, length)

    def write(self, address: int, data: bytes, t_ns: int, *, ram_only: bool = False) -> None:
        """Write whole registers; refused as a whole if one of them is.

        With `ram_only`, as for a write to the secondary id, also if one is in the EEPROM area.
        """
        self.advance(t_ns)
        entries = self._checked(address, data, ram_only=ram_only)
        before = mode_of(self._table)
        for register, value in entries:
            self._table.put(register, value)
        self._obey({register.name for register, _ in entries}, before, self._now_ns)

    def register_write(self, address: int, data: bytes) -> None:
        """Keep a write for `action`; it is checked now."""
        self._checked(address, data)
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

    def clear_turns(self, t_ns: int) -> None:
        """Count the shaft's position from within one turn on; refused while it moves (e-manual 2.0, Clear).

        Not verified: that its goal is where it stands then.
        """
        self.advance(t_ns)
        rad, rad_s = self.shaft.at(self._now_ns)
        if rad_s:
            raise Refused(Refusal.RESULT)
        self._present.frame = one_turn(self._table, rad)
        self.set("goal_position", self._present.frame.count(rad))

    def store_backup(self) -> None:
        """Keep a copy of the EEPROM area; refused while torque is on (e-manual 2.0, Control Table Backup)."""
        if self.get("torque_enable"):
            raise Refused(Refusal.RESULT)
        registers = self.model.registers.values()
        self._backup = {register.name: self.get(register.name) for register in registers if register.area == "EEPROM"}
        if "backup_ready" in self._table:
            self.set("backup_ready", 1)

    def restore_backup(self, t_ns: int) -> None:
        """Bring the copy back and restart; refused while torque is on, or if there is none."""
        if self.get("torque_enable") or not self._backup:
            raise Refused(Refusal.RESULT)
        for name, value in self._backup.items():
            self.set(name, value)
        self.reboot(t_ns)

    def raise_alarm(self, name: str, t_ns: int) -> None:
        """Let an error happen at a time, by its name in the model's error_bits; what Shutdown says then follows."""
        bits = {text: bit for bit, text in self.model.error_bits.items()}
        if name not in bits:
            raise DriverError(f"{self.model.name} has no alarm '{name}'; it has {', '.join(bits)}")
        self.schedule(t_ns, lambda t_ns: self._alarm(1 << bits[name], t_ns))

    def set_voltage(self, voltage_v: float, t_ns: int) -> None:
        """The supply's voltage from a time on."""

        def change(_: int) -> None:
            self._present.voltage_v = voltage_v

        self.schedule(t_ns, change)

    def set_temperature(self, temperature_c: float, t_ns: int) -> None:
        """The servo's temperature at a time; from then on it goes where its load takes it."""

        def change(t_ns: int) -> None:
            self._present.heat = Heat(t_ns, temperature_c, self._ambient_c)

        self.schedule(t_ns, change)

    def obstruct(self, lower_rad: float | None, upper_rad: float | None, t_ns: int) -> None:
        """From a time on the shaft can't pass these angles; None is no bound, one that it is past is where it is."""
        if self._leader is not None:
            raise DriverError(f"servo {self.id} is joined to servo {self._leader.id} by a cable: obstruct that one")
        lower = -math.inf if lower_rad is None else lower_rad
        upper = math.inf if upper_rad is None else upper_rad
        if lower > upper:
            raise DriverError(f"servo {self.id}: an obstruction from {lower:g} to {upper:g} rad; lower must be lower")
        self.schedule(t_ns, lambda t_ns: self.shaft.obstruct(t_ns, lower, upper))

    def push(self, rad: float, rad_s: float, rad_s2: float, t_ns: int) -> None:
        """From a time on a hand takes the shaft to an angle, and holds it there; not against torque.

        Args:
            rad: from the model's zero count.
            rad_s, rad_s2: the hand's speed and acceleration.
        """

        def take(t_ns: int) -> None:
            if not self.get("torque_enable"):
                self.shaft.drive(t_ns, HAND)
                self.shaft.profile.move(t_ns, rad, rad_s, rad_s2)

        self.schedule(t_ns, take)

    def schedule(self, t_ns: int, change: Callable[[int], None]) -> None:
        """Let something happen to the servo at a time, which it is told; at once if that is past."""
        heapq.heappush(self._changes, (t_ns, self._changes_seen, change))
        self._changes_seen += 1
        if self._now_ns != BEGINNING_NS:
            self._due_ns = min(self._due_ns, t_ns)
            self.advance(self._now_ns)

    def follow(self, leader: EmulatedServo, *, twisted: bool = False) -> None:
        """Plug in a sync cable: while the bit for it is set in its drive mode, it turns as the leader's motor does.

        e-manual, Drive Mode: a twisted cable turns it the other way, whatever the reverse bits say. Both are taken for
        joined by a frame, so that it turns whether its torque is on or off.
        """
        for servo in (self, leader):
            if not servo.model.sync_cable:
                raise DriverError(f"servo {servo.id}: {servo.model.name} has no sync cable")
        if leader is self or leader._leader is not None or self._leader is not None or self._followers:
            raise DriverError(f"servo {self.id} can't follow servo {leader.id}: a sync cable joins two servos")
        self._leader = leader
        leader._followers.append(self)
        self._steering.plug(leader.shaft, -1 if twisted else 1, self._now_ns)
        self._due_ns = min(self._due_ns, self._now_ns)

    def _advance(self, t_ns: int) -> None:
        if self._busy:  # a load that asks for an angle
            return
        if self._due_ns <= t_ns:
            self._busy = True
            try:
                if self._now_ns == BEGINNING_NS:
                    self._due_ns = self._now_ns = self._protection.heard_ns = t_ns
                    self._present.heat = replace(self._present.heat, t_ns=t_ns)
                self.shaft.forget(self._now_ns)
                while self._due_ns <= t_ns:
                    self._now_ns = max(self._now_ns, self._due_ns)
                    self._happen(self._now_ns)
            finally:
                self._busy = False
        self._now_ns = max(self._now_ns, t_ns)

    def _happen(self, t_ns: int) -> None:
        """What is due at a time."""
        while self._changes and self._changes[0][0] <= t_ns:
            heapq.heappop(self._changes)[2](t_ns)
        if self._protection.watchdog_ns() <= t_ns:
            # X-series manual, Bus Watchdog (98): it stops with no profile, and reads -1
            self.set("bus_watchdog", -1)
            self._steering.stop(t_ns)
        self._settle(t_ns)

    def _settle(self, t_ns: int) -> None:
        """Bring the body to a time, see to the protections, and find what is due next."""
        self.shaft.settle(t_ns)
        heat = self._present.heat.loaded(t_ns, self.shaft.strain(t_ns), self._ambient_c)
        self._present.heat = heat
        new = self._protection.check(
            t_ns,
            voltage_v=self._present.voltage_v,
            temperature_c=heat.temperature_c,
            saturated=self.shaft.saturated(t_ns),
        )
        if new:
            self._alarm(new, t_ns)
        crossing = self._present.heat.crosses_ns(self._table.get("temperature_limit"))
        phase = (t_ns // STEP_NS + 1) * STEP_NS
        if self.shaft.resting:
            phase = max(self._protection.overload_ns(), t_ns + 1)
        elif self.shaft.rigid:
            phase = self.shaft.profile.next_phase_ns(t_ns) or NEVER_NS
        change = self._changes[0][0] if self._changes else NEVER_NS
        self._due_ns = min(self._protection.watchdog_ns(), change, phase, NEVER_NS if crossing is None else crossing)

    def _alarm(self, bits: int, t_ns: int) -> None:
        if self._protection.raise_bits(bits):
            self._steering.release(t_ns)

    def _restart(self, t_ns: int, *, keep: Sequence[str]) -> None:
        self.advance(t_ns)
        t_ns = self._now_ns
        self._registered, self._steering.halted = None, False
        self._protection.clear()
        self._steering.release(t_ns)
        self._present.frame = power_up(self._table, self.shaft.at(t_ns)[0], keep)
        self._steering.see_to_cable(t_ns)
        self._settle(t_ns)

    def _checked(self, address: int, data: bytes, *, ram_only: bool = False) -> list[tuple[Register, int]]:
        entries = self._table.entries(address, data)
        for register, value in entries:
            self._table.check(register, value)
            self._check(register, value)
            if ram_only and register.area == "EEPROM":
                raise Refused(Refusal.ACCESS)  # e-manual, Secondary ID (12)
        return entries

    def _check(self, register: Register, value: int) -> None:
        """Raise Refused for what the servo's state forbids."""
        if register.name == "torque_enable" and value and self.model.recovery == "reboot":
            if self._protection.shut_down:
                raise Refused(Refusal.ACCESS)  # after a shutdown only a reboot gives torque back
        elif register.name == "bus_watchdog" and (value < 0 or (value and self.get("bus_watchdog") < 0)):
            raise Refused(Refusal.RANGE)  # only 0 clears it; unverified: that other values are refused
        elif register.name in _GOALS and "bus_watchdog" in self._table and self.get("bus_watchdog") < 0:
            raise Refused(Refusal.RANGE)  # X-series manual, Bus Watchdog (98): goals are read-only then
        elif register.name == "goal_position" and mode_of(self._table) is Mode.POSITION:
            low, high = (self.get(name) for name in self.model.position_limit_registers)
            if not low <= value <= high:
                raise Refused(Refusal.LIMIT)

    def _obey(self, names: set[str], before: Mode, t_ns: int) -> None:
        """What follows from a write."""
        after = mode_of(self._table)
        self._present.frame = frame_of(self._table, self._present.frame.turns)
        # e-manual, Present Position (132), of servos with an operating mode; unverified: MX with protocol 1.0 don't
        torque_on = "torque_enable" in names and self.get("torque_enable") and self.model.operating_mode_register
        if after is Mode.POSITION and (torque_on or before is not after):
            self._present.frame = one_turn(self._table, self.shaft.at(t_ns)[0])
        if self.model.operating_mode_register in names and after is not before:
            enter_mode(self._table, self._present.frame, self.shaft.at(t_ns)[0])
        if names & _GOALS:
            self._steering.halted = False
            if bit(self._table, "torque_on_by_goal_update") and not self._protection.shut_down:
                self.set("torque_enable", 1)
        if names & {"bus_watchdog", "torque_enable"}:
            self._protection.heard_ns = max(self._protection.heard_ns, t_ns)
        if "torque_limit" in names and self.get("torque_limit") and self.model.recovery == "torque_limit":
            self._protection.clear()  # unverified: that this takes the error bits back as well
        if "drive_mode" in names:
            self._steering.see_to_cable(t_ns)
        if "torque_enable" in names and not self.get("torque_enable"):
            self._steering.release(t_ns)
        elif self._steering.concerns(names) or before is not after:
            self._steering.steer(t_ns)
        self._settle(t_ns)
