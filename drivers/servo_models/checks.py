"""What in a servo model can't be true, found when it is loaded."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import fields

from drivers.errors import DriverError
from drivers.servo_models.model import ServoModel

ROLES = (
    "model_number", "firmware_version", "id", "baud_rate", "return_delay_time", "status_return_level", "shutdown",
    "temperature_limit", "min_voltage_limit", "max_voltage_limit", "torque_enable", "goal_position",
    "present_position", "present_temperature", "moving",
)  # fmt: skip
# SI units of the quantities that callers convert; the effort is a current or a load.
ROLE_UNITS = {"goal_position": "rad", "present_position": "rad", "present_temperature": "degC"}


def contradictions(model: ServoModel) -> list[str]:
    """What is wrong with a model, a text each; empty if nothing is."""
    missing = [f"no register '{name}'" for name in _named(model) if name not in model.registers]
    return missing or [*_layout(model), *_ranges(model), *_units(model), *_facts(model)]


def _named(model: ServoModel) -> list[str]:
    """All registers that a model must have, and those that it gives a role."""
    optional = (
        model.acceleration_register, model.hardware_error_register, model.operating_mode_register,
        "torque_limit" if model.recovery == "torque_limit" else None,
    )  # fmt: skip
    return [
        *ROLES, model.speed_register, model.present_speed_register, model.effort_register, model.voltage_register,
        model.registered_flag, model.eeprom_lock, *model.position_limit_registers,
        *(name for name in optional if name is not None),
    ]  # fmt: skip


def _layout(model: ServoModel) -> Iterator[str]:
    spans = [(r.address, r.address + r.size, r.name) for r in model.registers.values()]
    for block in model.indirect:
        spans.append((block.address, block.address + 2 * block.count, f"indirect_address_{block.first}"))
        spans.append((block.data, block.data + block.count, f"indirect_data_{block.first}"))
    spans.sort()
    for (_, end, name), (start, _, other) in itertools.pairwise(spans):
        if end > start:
            yield f"'{name}' and '{other}' overlap"
    if spans[-1][1] > model.size_bytes:
        yield f"'{spans[-1][2]}' ends beyond size_bytes = {model.size_bytes}"


def _ranges(model: ServoModel) -> Iterator[str]:
    ram = model.registers["torque_enable"].address  # its first register
    for register in model.registers.values():
        low, high = register.span
        least = low if register.minimum is None else register.minimum
        most = high if register.maximum is None else register.maximum
        if not low <= least <= most <= high:
            yield f"'{register.name}': {least} to {most} is no range within {low} to {high}"
        elif register.initial is not None and not least <= register.initial <= most:
            yield f"'{register.name}': initial value {register.initial} is outside {least} to {most}"
        if (register.area == "RAM") != (register.address >= ram):
            yield f"'{register.name}': {register.area} at {register.address}; the RAM area begins at {ram}"


def _units(model: ServoModel) -> Iterator[str]:
    expected = {
        **ROLE_UNITS, model.speed_register: "rad/s", model.present_speed_register: "rad/s", model.voltage_register: "V",
        **dict.fromkeys(model.position_limit_registers, "rad"),
    }  # fmt: skip
    if model.acceleration_register is not None:
        expected[model.acceleration_register] = "rad/s^2"
    for name, si in expected.items():
        unit = model.registers[name].unit
        if unit is None or unit.si != si:
            yield f"'{name}': its unit must be a multiple of {si}"
    for register in model.registers.values():
        if register.within is not None and register.unit != model.registers[register.within].unit:
            yield f"'{register.name}': its unit must be that of '{register.within}', which bounds it"
    effort = model.registers[model.effort_register].unit
    if effort is None or effort.si not in ("A", "1"):
        yield f"'{model.effort_register}': its unit must be a current, or a fraction of the greatest load"


def _facts(model: ServoModel) -> Iterator[str]:
    if model.registers["baud_rate"].initial not in model.baud_codes:
        yield "'baud_rate': its initial value is no code of [baud]"
    if model.operating_mode_register is not None:
        initial = model.registers[model.operating_mode_register].initial
        if "position" not in model.operating_modes or initial not in model.operating_modes.values():
            yield f"'{model.operating_mode_register}': operating_modes must name its initial value, and 'position'"
    if not model.supply_v[0] <= model.nominal_v <= model.supply_v[1]:
        yield f"nominal.v {model.nominal_v} is outside supply_v {model.supply_v[0]} to {model.supply_v[1]}"
    known = {field.name for field in fields(model)}
    for name in model.unverified:
        if name not in known:
            try:
                model.register(name)
            except DriverError:
                yield f"unverified.{name}: no such register or fact"
