"""What an emulated servo tells of the present: the registers that it fills when they are read."""

from __future__ import annotations

from collections.abc import Callable

from drivers.emulator.body import Body
from drivers.emulator.heat import Heat
from drivers.emulator.modes import frame_of, mode_of, potentiometer
from drivers.emulator.shaft import BEGINNING_NS
from drivers.emulator.table import Table

# Counts. X-series manual, Moving Status (123), tells when it is in position, but not how near that is: a guess.
IN_POSITION_COUNTS = 10
_TICK_MS = 32768
_PROFILE = {
    0: 0x00,
    1: 0x10,
    2: 0x20,
    3: 0x30,
}  # Moving Status (123), bits 4 and 5: none, rectangle, triangle, trapezoid


class Present:
    """Fills the registers of the present for a read.

    Attributes:
        frame: of the servo's counts.
        heat: its temperature.
        voltage_v: of its supply.
        profile_phases: of the motion that was planned last.
    """

    def __init__(self, table: Table, body: Body, max_speed_rad_s: float) -> None:
        self._table, self._body, self._max_speed_rad_s = table, body, max_speed_rad_s
        self.frame = frame_of(table, 0)
        self.heat = Heat(BEGINNING_NS, 0.0, 0.0)
        self.voltage_v = 0.0
        self.profile_phases = 0
        model = table.model
        self._speed_unit_rad_s = model.speed_unit_rad_s
        values: dict[str, Callable[[int, float, float], int]] = {
            "present_position": self._position,
            "position_trajectory": lambda t, rad, rad_s: self.frame.count(body.profile.at(t)[0]),
            "velocity_trajectory": lambda t, rad, rad_s: self._speed(body.profile.at(t)[1]),
            model.present_speed_register: lambda t, rad, rad_s: self._speed(rad_s),
            "moving": self._moving,
            "moving_status": self._moving_status,
            "present_load": self._load,
            "present_current": lambda t, rad, rad_s: self._current("present_current", t),
            "current": lambda t, rad, rad_s: self._current("current", t),
            "present_pwm": self._pwm,
            model.voltage_register: self._voltage,
            "present_temperature": lambda t, rad, rad_s: round(self.heat.at(t)),
            "realtime_tick": lambda t, rad, rad_s: t // 1_000_000 % _TICK_MS,
        }
        self._live = [(table.cells[name], value) for name, value in values.items() if name in table]

    def sample(self, address: int, length: int, t_ns: int) -> None:
        """Fill the registers of the present that these bytes touch."""
        end = address + length
        if self._table.covers_indirect_data(address, length):
            address, end = 0, self._table.model.size_bytes
        rad, rad_s = self._body.at(t_ns)
        for cell, value in self._live:
            if cell.start < end and cell.end > address:
                self._table.fill(cell, value(t_ns, rad, rad_s))

    def _position(self, t_ns: int, rad: float, rad_s: float) -> int:
        count, model = self.frame.count(rad), self._table.model
        if potentiometer(model):  # it ends at 0 and 1023
            count = model.count(rad - self.frame.turns_of(rad) * 6.283185307179586)
            return min(max(count, 0), model.resolution - 1)
        # MX with protocol 1.0: more than a turn is told in multi-turn mode only
        wheel = model.operating_mode_register is None and not mode_of(self._table).positions
        return count % model.resolution if wheel else count

    def _speed(self, rad_s: float) -> int:
        return round(self.frame.sign * rad_s / self._speed_unit_rad_s)

    def _moving(self, t_ns: int, rad: float, rad_s: float) -> int:
        if self._body.moving(t_ns):
            return 1
        return int("moving_threshold" in self._table and abs(self._speed(rad_s)) > self._table.get("moving_threshold"))

    def _moving_status(self, t_ns: int, rad: float, rad_s: float) -> int:
        if not mode_of(self._table).positions:
            return 0
        status = _PROFILE[self.profile_phases] if self._table.get(self._table.model.speed_register) else 0
        if self._body.moving(t_ns):
            return status | 0x02
        near = abs(self.frame.count(rad) - self._table.get("goal_position")) <= IN_POSITION_COUNTS
        return status | int(near)

    def _load(self, t_ns: int, rad: float, rad_s: float) -> int:
        return self._table.registers["present_load"].count(self.frame.sign * self._body.output(t_ns))

    def _current(self, name: str, t_ns: int) -> int:
        """Unverified: that current and torque go together from zero on."""
        amperes = self.frame.sign * self._body.output(t_ns) * self._table.model.stall_a
        return self._table.registers[name].count(amperes)

    def _pwm(self, t_ns: int, rad: float, rad_s: float) -> int:
        """A direct-current motor: speed and torque share the voltage."""
        duty = self._body.output(t_ns) + rad_s / self._max_speed_rad_s
        return self._table.registers["present_pwm"].count(self.frame.sign * min(max(duty, -1.0), 1.0))

    def _voltage(self, t_ns: int, rad: float, rad_s: float) -> int:
        register = self._table.registers[self._table.model.voltage_register]
        return register.count(self.voltage_v) - int(self._body.moving(t_ns))
