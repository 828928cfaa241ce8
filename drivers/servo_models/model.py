"""Servo models as data: control tables, units and limits, read from the TOML files beside this module."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from drivers.errors import DriverError

RAD_S_PER_RPM = 2 * math.pi / 60
RAD_S2_PER_RPM2 = 2 * math.pi / 3600  # rev/min^2, the unit of Profile Acceleration
# Fraction of a unit. A speed that is a whole number of units but for rounding in float64 counts as that number.
ROUNDING_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Register:
    """One register of a control table.

    Attributes:
        encoding: "unsigned", "twos_complement", or "sign_magnitude" (AX: bit 10 is the direction, set for clockwise).
        area: "EEPROM" or "RAM".
        initial: value at power-up of a new servo, None where it depends on the servo's state.
        minimum, maximum: what a write may hold; None where the manual names no range.
    """

    name: str
    address: int
    size: int
    area: str
    writable: bool
    encoding: str = "unsigned"
    initial: int | None = None
    minimum: int | None = None
    maximum: int | None = None

    def encode(self, value: int) -> bytes:
        """Little-endian bytes of a value; raises DriverError if the register can't hold it."""
        low, high = self._span()
        if not low <= value <= high:
            raise DriverError(f"{value} doesn't fit in register '{self.name}' ({self.size} B, {low} to {high})")
        if self.encoding == "sign_magnitude" and value < 0:
            value = 0x400 - value
        return (value % (1 << 8 * self.size)).to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """The signed value of `size` little-endian bytes."""
        if self.encoding == "sign_magnitude":
            raw = int.from_bytes(data, "little")
            return -(raw & 0x3FF) if raw & 0x400 else raw & 0x3FF
        return int.from_bytes(data, "little", signed=self.encoding == "twos_complement")

    def _span(self) -> tuple[int, int]:
        if self.encoding == "sign_magnitude":
            return -0x3FF, 0x3FF
        bits = 8 * self.size
        if self.encoding == "twos_complement":
            return -(1 << bits - 1), (1 << bits - 1) - 1
        return 0, (1 << bits) - 1


@dataclass(frozen=True, eq=False, slots=True)
class ServoModel:
    """What is known of one servo model; angles are counted from `zero_count`, positive anticlockwise.

    Attributes:
        registers: by name; "goal_position", "present_position", "torque_enable", "return_delay_time" and
            "status_return_level" are in every model, the others by the role names below.
        speed_register: limits the speed of a motion, in `speed_unit_rad_s`; 0 is no limit.
        acceleration_register: limits the acceleration, in `acceleration_unit_rad_s2`; None where there is none.
        hardware_error_register: None where the status packet's error byte alone tells (protocol 1.0 models).
        error_bits: names of the bits of that register or byte.
        baud_codes: baud by the value of the register "baud_rate".
        group_read: whether the servo answers group reads at all.
    """

    name: str
    model_number: int
    protocols: tuple[float, ...]
    resolution: int
    zero_count: int
    rad_per_count: float
    no_load_rad_s: float
    group_read: bool
    size_bytes: int
    speed_register: str
    speed_max: int
    speed_unit_rad_s: float
    acceleration_register: str | None
    acceleration_unit_rad_s2: float | None
    present_speed_register: str
    voltage_register: str
    position_limit_registers: tuple[str, str]
    registered_flag: str
    hardware_error_register: str | None
    registers: Mapping[str, Register]
    error_bits: Mapping[int, str]
    baud_codes: Mapping[int, int]
    sources: tuple[str, ...]

    def register(self, name: str) -> Register:
        """The register of that name; raises DriverError that lists the names."""
        if name not in self.registers:
            raise DriverError(f"{self.name} has no register '{name}'; it has {', '.join(self.registers)}")
        return self.registers[name]

    def rad(self, count: float) -> float:
        """Shaft angle of a position count, rad from the zero count."""
        return (count - self.zero_count) * self.rad_per_count

    def count(self, shaft_rad: float) -> int:
        """The position count nearest to a shaft angle."""
        return self.zero_count + math.floor(shaft_rad / self.rad_per_count + 0.5)

    def speed_units_within(self, rad_s: float) -> int:
        """The largest value of the speed register that doesn't exceed `rad_s`; 0 means that there is none."""
        units = math.floor(rad_s / self.speed_unit_rad_s + ROUNDING_TOLERANCE)
        return max(0, min(units, self.speed_max))

    def error_names(self, bits: int) -> tuple[str, ...]:
        """Names of the set bits of the error byte or register."""
        return tuple(self.error_bits.get(bit, f"bit {bit}") for bit in range(8) if bits >> bit & 1)


def _data(folder: str, name: str) -> dict[str, Any]:
    return tomllib.loads((files(__package__ or "") / folder / f"{name}.toml").read_text("utf-8"))


def _register(row: Mapping[str, Any], initial: Mapping[str, int]) -> Register:
    return Register(
        name=row["name"],
        address=row["address"],
        size=row["size"],
        area=row["area"],
        writable=row["access"] == "RW",
        encoding=row.get("encoding", "unsigned"),
        initial=initial.get(row["name"], row.get("initial")),
        minimum=row.get("min"),
        maximum=row.get("max"),
    )


def _model(stem: str) -> ServoModel:
    own = _data("models", stem)
    table = _data("tables", own["table"])
    initial = {"model_number": own["model_number"], **own.get("initial", {})}
    rows = [row for row in table["registers"] if row["name"] not in own.get("omit", ())] + own.get("registers", [])
    registers = {row["name"]: _register(row, initial) for row in sorted(rows, key=lambda row: row["address"])}
    acceleration_unit = table.get("acceleration_unit_rpm2")
    span_counts = own["resolution"] if own["span_deg"] == 360.0 else own["resolution"] - 1  # AX: 1023 is 300 deg
    return ServoModel(
        name=own["name"],
        model_number=own["model_number"],
        protocols=tuple(own["protocols"]),
        resolution=own["resolution"],
        zero_count=own["zero_count"],
        rad_per_count=math.radians(own["span_deg"]) / span_counts,
        no_load_rad_s=own["no_load_rpm"] * RAD_S_PER_RPM,
        group_read=own["group_read"],
        size_bytes=table["size_bytes"],
        speed_register=table["speed_register"],
        speed_max=table["speed_max"],
        speed_unit_rad_s=table["speed_unit_rpm"] * RAD_S_PER_RPM,
        acceleration_register=table.get("acceleration_register"),
        acceleration_unit_rad_s2=None if acceleration_unit is None else acceleration_unit * RAD_S2_PER_RPM2,
        present_speed_register=table["present_speed_register"],
        voltage_register=table["voltage_register"],
        position_limit_registers=tuple(table["position_limit_registers"]),
        registered_flag=table["registered_flag"],
        hardware_error_register=table.get("hardware_error_register"),
        registers=MappingProxyType(registers),
        error_bits=MappingProxyType({int(bit): name for bit, name in table["error_bits"].items()}),
        baud_codes=MappingProxyType({int(code): baud for code, baud in table["baud"].items()}),
        sources=(*own["sources"], *table["sources"]),
    )


def _stems() -> dict[str, str]:
    """Model name -> file stem; a model is added by adding its file."""
    found = sorted(entry.name for entry in (files(__package__ or "") / "models").iterdir())
    stems = [name.removesuffix(".toml") for name in found if name.endswith(".toml")]
    return {stem.upper().replace("_", "-"): stem for stem in stems}


_STEMS = _stems()
MODELS: tuple[str, ...] = tuple(_STEMS)


@cache
def load_model(name: str) -> ServoModel:
    """The model of that name, as printed on the servo ("AX-18A"); raises DriverError that lists the names."""
    if name not in _STEMS:
        raise DriverError(f"no servo model '{name}'; have {', '.join(MODELS)}")
    return _model(_STEMS[name])


def model_by_number(model_number: int) -> ServoModel | None:
    """The model that answers a ping with this number, None for one that isn't here."""
    return next((model for model in map(load_model, MODELS) if model.model_number == model_number), None)
