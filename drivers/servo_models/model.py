"""What is known of one servo model: its control table, and the roles that registers play in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.errors import DriverError
from drivers.servo_models.register import Register, Unit

_INDIRECT = re.compile(r"indirect_(address|data)_([1-9]\d*)")
INDIRECT_MINIMUM = 64  # e-manual, Indirect Address: what it may point to begins with the RAM area


@dataclass(frozen=True, slots=True)
class IndirectBlock:
    """Registers "indirect_address_N" and "indirect_data_N" of the X series, N from `first` on.

    Attributes:
        address: of the first indirect address; they have two bytes each.
        data: of the first indirect data; they have one byte each.
    """

    first: int
    count: int
    address: int
    data: int


@dataclass(frozen=True, eq=False, slots=True)
class ServoModel:
    """What is known of one servo model; angles are counted from `zero_count`, positive anticlockwise.

    Attributes:
        protocols: that its firmware speaks.
        sync_read, bulk_read: whether it answers these instructions, in a protocol that has them.
        fast_sync_read: None where that depends on the firmware.
        recovery: what gives torque back after a shutdown: "reboot", or "torque_limit" (write it again, not as zero).
        eeprom_lock: the register that must be 0 for a write to the EEPROM area: "torque_enable" or "lock".
        sync_cable: whether a cable can make it follow another servo.
        supply_v: least and greatest supply voltage.
        nominal_v: the voltage of `no_load_rad_s`, `stall_nm` and `stall_a`.
        registers: by name; "goal_position", "present_position", "torque_enable", "return_delay_time" and
            "status_return_level" are in every model, the others by the role names below. Indirect registers aren't
            listed here; `register` knows them.
        indirect: blocks of indirect registers.
        speed_register: limits the speed of a motion; 0 is no limit.
        acceleration_register: limits the acceleration; 0 is no limit; None where there is none.
        effort_register: the current where there is a sensor (its unit is "A"), else the load (its unit is "1").
        hardware_error_register: None where the status packet's error byte alone tells (protocol 1.0 firmware).
        operating_mode_register: None where the position limits set the mode (protocol 1.0 firmware).
        operating_modes: value of that register by name; "position" is in all of them.
        drive_mode_bits: names of the bits of the register "drive_mode".
        error_bits: names of the bits of the hardware error register or the error byte, and of "shutdown".
        baud_codes: baud by the value of the register "baud_rate".
        unverified: what isn't sure, and why, by the name of a register or of a field of this class.
        sources: manual pages and tables that the facts are from.
    """

    name: str
    model_number: int
    protocols: tuple[float, ...]
    resolution: int
    zero_count: int
    sync_read: bool
    bulk_read: bool
    fast_sync_read: bool | None
    recovery: str
    eeprom_lock: str
    sync_cable: bool
    supply_v: tuple[float, float]
    nominal_v: float
    no_load_rad_s: float
    stall_nm: float
    stall_a: float
    size_bytes: int
    registers: Mapping[str, Register]
    indirect: tuple[IndirectBlock, ...]
    speed_register: str
    acceleration_register: str | None
    present_speed_register: str
    effort_register: str
    voltage_register: str
    position_limit_registers: tuple[str, str]
    registered_flag: str
    hardware_error_register: str | None
    operating_mode_register: str | None
    operating_modes: Mapping[str, int]
    drive_mode_bits: Mapping[int, str]
    error_bits: Mapping[int, str]
    baud_codes: Mapping[int, int]
    unverified: Mapping[str, str]
    sources: tuple[str, ...]

    def register(self, name: str) -> Register:
        """The register of that name, indirect ones included; raises DriverError that lists the names."""
        found = self.registers.get(name) or self._indirect_register(name)
        if found is None:
            names = [*self.registers]
            for block in self.indirect:
                last = block.first + block.count - 1
                names += [f"indirect_{kind}_{block.first} to {last}" for kind in ("address", "data")]
            raise DriverError(f"{self.name} has no register '{name}'; it has {', '.join(names)}")
        return found

    def rad(self, count: float) -> float:
        """Shaft angle of a position count, rad from the zero count."""
        return self.registers["goal_position"].physical(count)

    def count(self, shaft_rad: float) -> int:
        """The position count nearest to a shaft angle."""
        return self.registers["goal_position"].count(shaft_rad)

    def counts_covering(self, lower_rad: float, upper_rad: float) -> tuple[int, int]:
        """The narrowest range of position counts that holds all shaft angles from lower to upper."""
        goal = self.registers["goal_position"]
        return goal.count_at_most(lower_rad), goal.count_at_least(upper_rad)

    def speed_units_within(self, rad_s: float) -> int:
        """The largest value of the speed register that doesn't exceed `rad_s`; 0 means that there is none."""
        return max(0, min(self.registers[self.speed_register].count_at_most(rad_s), self.speed_max))

    def error_names(self, bits: int) -> tuple[str, ...]:
        """Names of the set bits of the error byte or register."""
        return tuple(self.error_bits.get(bit, f"bit {bit}") for bit in range(8) if bits >> bit & 1)

    @property
    def status_registers(self) -> tuple[str, str, str, str, str]:
        """Position, speed, load or current, voltage, temperature: near each other, to be read at once."""
        effort = "present_load" if "present_load" in self.registers else self.effort_register
        return (
            "present_position", self.present_speed_register, effort, self.voltage_register, "present_temperature",
        )  # fmt: skip

    def load_share(self, register: str, count: int) -> float:
        """A load or current as a share of the most that there is: of the stall current at nominal voltage."""
        amount = self.registers[register].physical(count)
        return amount / self.stall_a if _unit(self.registers[register]).si == "A" else amount

    @property
    def rad_per_count(self) -> float:
        """Angle of one position count."""
        return _unit(self.registers["goal_position"]).per_count

    @property
    def speed_unit_rad_s(self) -> float:
        """Speed of one count of the speed register."""
        return _unit(self.registers[self.speed_register]).per_count

    @property
    def speed_max(self) -> int:
        """The largest value that limits a speed."""
        return self.registers[self.speed_register].maximum or 0

    @property
    def acceleration_unit_rad_s2(self) -> float | None:
        """Acceleration of one count of the acceleration register, None where there is none."""
        name = self.acceleration_register
        return None if name is None else _unit(self.registers[name]).per_count

    @property
    def group_read(self) -> bool:
        """Whether it answers group reads at all."""
        return self.sync_read or self.bulk_read

    @property
    def factory_baud(self) -> int:
        """The baud of a new servo."""
        return self.baud_codes[self.registers["baud_rate"].initial or 0]

    def _indirect_register(self, name: str) -> Register | None:
        if (match := _INDIRECT.fullmatch(name)) is None:
            return None
        kind, number = match[1], int(match[2])
        for block in self.indirect:
            k = number - block.first
            if not 0 <= k < block.count:
                continue
            if kind == "data":
                return Register(name, block.data + k, 1, "RAM", True, initial=0, minimum=0, maximum=255)
            last = self.size_bytes - 1
            return Register(
                name, block.address + 2 * k, 2, "RAM", True,
                initial=block.data + k, minimum=INDIRECT_MINIMUM, maximum=last,
            )  # fmt: skip
        return None


def _unit(register: Register) -> Unit:
    if register.unit is None:
        raise DriverError(f"register '{register.name}' has no unit")
    return register.unit
