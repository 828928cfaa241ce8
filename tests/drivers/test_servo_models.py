"""Servo models: the data is whole, conversions are each other's inverse, a new model is tested the day it exists."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.servo_models import MODELS, Register, ServoModel, load_model, model_by_number

ROLES = ("goal_position", "present_position", "torque_enable", "return_delay_time", "status_return_level", "baud_rate")
MODEL = st.sampled_from(MODELS).map(load_model)


def test_the_models_of_the_supported_arms_are_here() -> None:
    assert {"AX-12A", "AX-18A", "XL430-W250", "XM430-W350", "XM540-W270"} <= set(MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_a_models_registers_are_whole(name: str) -> None:
    model = load_model(name)
    assert model.name == name
    assert model.sources
    assert model_by_number(model.model_number) is model
    named = {*ROLES, model.speed_register, model.present_speed_register, model.voltage_register, model.registered_flag}
    named |= {*model.position_limit_registers, "model_number", "id", "moving", "present_temperature"}
    named |= {register for register in (model.acceleration_register, model.hardware_error_register) if register}
    assert named <= set(model.registers)
    ends = [(register.address, register.address + register.size) for register in model.registers.values()]
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(ends)), "registers overlap"
    assert ends[-1][1] <= model.size_bytes
    for register in model.registers.values():
        for value in (register.initial, register.minimum, register.maximum):
            assert value is None or register.decode(register.encode(value)) == value


@pytest.mark.parametrize(
    ("name", "register", "address", "size"),
    [
        ("AX-18A", "goal_position", 30, 2),  # e-manual, AX-18A, Control Table of RAM Area
        ("AX-18A", "moving_speed", 32, 2),
        ("AX-18A", "present_position", 36, 2),
        ("XM430-W350", "profile_velocity", 112, 4),  # e-manual, XM430-W350, Control Table of RAM Area
        ("XM430-W350", "goal_position", 116, 4),
        ("XM430-W350", "present_position", 132, 4),
        ("XL430-W250", "present_load", 126, 2),
    ],
)
def test_addresses_are_the_manuals(name: str, register: str, address: int, size: int) -> None:
    at = load_model(name).register(register)
    assert (at.address, at.size) == (address, size)


def test_a_revolution_is_4096_counts_and_300_degrees_are_1023() -> None:
    assert load_model("XM430-W350").rad(2048 + 1024) == pytest.approx(math.pi / 2, rel=1e-15)
    ax = load_model("AX-18A")
    assert ax.rad(1023) - ax.rad(0) == pytest.approx(math.radians(300), rel=1e-15)


@given(MODEL, st.integers(-5000, 5000))
def test_counts_survive_the_way_to_radians_and_back(model: ServoModel, count: int) -> None:
    assert model.count(model.rad(count)) == count


@given(MODEL, st.floats(0.0, 20.0))
def test_a_speed_in_units_never_exceeds_the_speed(model: ServoModel, rad_s: float) -> None:
    units = model.speed_units_within(rad_s)
    assert units * model.speed_unit_rad_s <= rad_s * (1 + 1e-8) + 1e-8  # a whole number of units stays that number
    assert units == model.speed_max or (units + 1) * model.speed_unit_rad_s > rad_s


@given(st.data())
def test_every_value_of_every_register_survives_its_bytes(data: st.DataObject) -> None:
    model = load_model(data.draw(st.sampled_from(MODELS)))
    register = data.draw(st.sampled_from(sorted(model.registers.values(), key=lambda r: r.address)))
    low, high = {
        "unsigned": (0, 256**register.size - 1),
        "twos_complement": (-(256**register.size) // 2, 256**register.size // 2 - 1),
        "sign_magnitude": (-1023, 1023),
    }[register.encoding]
    value = data.draw(st.integers(low, high))
    assert len(register.encode(value)) == register.size
    assert register.decode(register.encode(value)) == value
    for outside in (low - 1, high + 1):
        with pytest.raises(DriverError, match="doesn't fit"):
            register.encode(outside)


def test_the_direction_bit_is_a_sign() -> None:
    # e-manual, AX-18A, Present Speed (38): 0 to 1023 anticlockwise, 1024 to 2047 clockwise
    speed = Register("present_speed", 38, 2, "RAM", False, "sign_magnitude")
    assert speed.decode((1024 + 300).to_bytes(2, "little")) == -300
    assert speed.encode(-300) == (1024 + 300).to_bytes(2, "little")


def test_unknown_names_list_what_there_is() -> None:
    with pytest.raises(DriverError, match="AX-18A"):
        load_model("MX-99")
    with pytest.raises(DriverError, match="goal_position"):
        load_model("AX-18A").register("goal")
    assert model_by_number(9999) is None
