"""The TOML files beside this module, read into models."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from pydantic import ValidationError

from drivers.errors import DriverError
from drivers.servo_models.checks import contradictions
from drivers.servo_models.model import IndirectBlock, ServoModel
from drivers.servo_models.register import Register, Unit
from drivers.servo_models.schema import ModelTable, RegisterRow

RAD_S_PER_RPM = 2 * math.pi / 60
# What the files measure in: the SI unit, and how much of it.
MEASURES: Mapping[str, tuple[str, float]] = {
    "deg": ("rad", math.pi / 180),
    "rpm": ("rad/s", RAD_S_PER_RPM),
    "rpm2": ("rad/s^2", RAD_S_PER_RPM / 60),  # rev/min^2
    "deg/s2": ("rad/s^2", math.pi / 180),
    "percent": ("1", 0.01),
    "mA": ("A", 1e-3),
    "V": ("V", 1.0),
    "mV/ms": ("V/s", 1.0),
    "degC": ("degC", 1.0),
    "us": ("s", 1e-6),
    "ms": ("s", 1e-3),
}
ANGLE, POSITION = "angle", "position"  # a position is an angle counted from zero_count
_JOINED = ("registers", "sources")  # a model and its tables have parts of these lists
_UPDATED = ("override", "units", "drive_mode_bits", "unverified")  # later parts add to these tables
_SHOWN = 3  # complaints of one file in an error


def read_model(stem: str) -> ServoModel:
    """Read a model's file and the tables that it names; errors as of `build_model`."""
    own = _toml("models", stem)
    return build_model([*(_toml("tables", name) for name in own.get("tables", ())), own], f"{stem}.toml")


def read_number(stem: str) -> int:
    """The model number in a model's file, nothing else of which is checked."""
    return int(_toml("models", stem).get("model_number", 0))


def build_model(parts: Sequence[Mapping[str, Any]], where: str) -> ServoModel:
    """A model from its tables and, last, its own file.

    Args:
        where: the file's name, for the errors.

    Raises:
        DriverError: for unknown keys, wrong types, and facts that contradict each other; names the file and the keys.
    """
    try:
        table = ModelTable.model_validate(_merge(parts))
    except ValidationError as error:
        found = [f"{'.'.join(map(str, item['loc']))}: {item['msg']}" for item in error.errors()]
    else:
        found = _unknown_names(table)
        if not found:
            model = _model(table)
            found = contradictions(model)
            if not found:
                return model
    more = f" (and {len(found) - _SHOWN} more)" if len(found) > _SHOWN else ""
    raise DriverError(f"servo model file {where}, with its tables: {'; '.join(found[:_SHOWN])}{more}")


def _merge(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Tables as one; of what two of them say, the later one counts."""
    merged: dict[str, Any] = {}
    for part in parts:
        for key, value in part.items():
            if key in _JOINED:
                merged[key] = [*merged.get(key, ()), *value]
            elif key in _UPDATED:
                old = merged.get(key, {})
                both = {name: {**old[name], **row} for name, row in value.items() if name in old and key == "override"}
                merged[key] = {**old, **value, **both}
            else:
                merged[key] = value
    return merged


def _unknown_names(table: ModelTable) -> list[str]:
    """What the tables call by a name that nothing has."""
    names = [row.name for row in table.registers]
    found = [f"registers: '{name}' appears twice" for name in sorted({n for n in names if names.count(n) > 1})]
    found += [f"override.{name}: no such register" for name in table.override if name not in names]
    if ANGLE not in table.units:
        found.append(f"units: '{ANGLE}' is missing")
    for row in table.registers:
        if row.unit is not None and row.unit not in (*table.units, POSITION):
            found.append(f"registers.{row.name}.unit: no unit '{row.unit}'; have {', '.join(table.units)}, {POSITION}")
        if row.within is not None and row.within not in names:
            found.append(f"registers.{row.name}.within: no register '{row.within}'")
    return found


def _model(table: ModelTable) -> ServoModel:
    return ServoModel(
        name=table.name,
        model_number=table.model_number,
        protocols=tuple(table.protocols),
        resolution=table.resolution,
        zero_count=table.zero_count,
        sync_read=table.sync_read,
        bulk_read=table.bulk_read,
        fast_sync_read=table.fast_sync_read,
        recovery=table.recovery,
        eeprom_lock=table.eeprom_lock,
        sync_cable=table.sync_cable,
        supply_v=table.supply_v,
        nominal_v=table.nominal.v,
        no_load_rad_s=table.nominal.no_load_rpm * RAD_S_PER_RPM,
        stall_nm=table.nominal.stall_nm,
        stall_a=table.nominal.stall_a,
        size_bytes=table.size_bytes,
        registers=MappingProxyType(_registers(table)),
        indirect=tuple(IndirectBlock(row.first, row.count, row.address, row.data) for row in table.indirect),
        speed_register=table.speed_register,
        acceleration_register=table.acceleration_register,
        present_speed_register=table.present_speed_register,
        effort_register=table.effort_register,
        voltage_register=table.voltage_register,
        position_limit_registers=table.position_limit_registers,
        registered_flag=table.registered_flag,
        hardware_error_register=table.hardware_error_register,
        operating_mode_register=table.operating_mode_register,
        operating_modes=MappingProxyType(table.operating_modes),
        drive_mode_bits=MappingProxyType({int(bit): name for bit, name in table.drive_mode_bits.items()}),
        error_bits=MappingProxyType({int(bit): name for bit, name in table.error_bits.items()}),
        baud_codes=MappingProxyType({int(code): baud for code, baud in table.baud.items()}),
        unverified=MappingProxyType(table.unverified),
        sources=tuple(table.sources),
    )


def _registers(table: ModelTable) -> dict[str, Register]:
    units = {name: _unit(*measured) for name, measured in table.units.items()}
    units[POSITION] = units[ANGLE]
    rows = sorted(table.registers, key=lambda row: row.address)
    return {row.name: _register(row, table, units) for row in rows}


def _register(row: RegisterRow, table: ModelTable, units: Mapping[str, Unit]) -> Register:
    said = {"initial": row.initial, "min": row.min, "max": row.max}
    if row.name == "model_number":
        said["initial"] = table.model_number
    if row.name in table.override:
        said |= table.override[row.name].model_dump(exclude_unset=True)
    return Register(
        name=row.name,
        address=row.address,
        size=row.size,
        area=row.area,
        writable=row.access == "RW",
        encoding=row.encoding,
        initial=said["initial"],
        minimum=said["min"],
        maximum=said["max"],
        unit=None if row.unit is None else units[row.unit],
        zero=table.zero_count if row.unit == POSITION else row.zero,
        within=row.within,
    )


def _unit(counts: int, amount: float, measure: str) -> Unit:
    si, factor = MEASURES[measure]
    return Unit(si, counts, amount * factor)


@cache
def _toml(folder: str, name: str) -> Mapping[str, Any]:
    path = files(__package__ or "") / folder / f"{name}.toml"
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        raise DriverError(f"servo models: no file {folder}/{name}.toml") from error
    except tomllib.TOMLDecodeError as error:
        raise DriverError(f"servo models: {folder}/{name}.toml is no TOML: {error}") from error
