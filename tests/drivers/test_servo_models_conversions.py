"""Conversions of servo registers: each other's inverse over the whole register, outward at limits, the manual's."""

from __future__ import annotations

import dataclasses
import itertools
import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.servo_models import MODELS, Register, ServoModel, load_model

MODEL = st.sampled_from(MODELS).map(load_model)
RPM, DEG = 2 * math.pi / 60, math.pi / 180  # in rad/s and rad

# Registers that convert differently, one of each kind, with the model that it is of.
MEASURED = {
    (register.unit, register.zero, register.span): register
    for name in MODELS
    for register in load_model(name).registers.values()
    if register.unit is not None
}
SMALL = [register for register in MEASURED.values() if register.size < 4]
LARGE = [register for register in MEASURED.values() if register.size == 4]
# Speed registers that differ in unit or greatest value, one of each, with its model.
SPEEDS = {
    (speed.unit, speed.maximum): model
    for model in map(load_model, MODELS)
    for speed in [model.register(model.speed_register)]
}


def describe(register: Register) -> str:
    assert register.unit is not None
    return f"{register.name}-{register.unit.per_count:.4g}{register.unit.si.replace('/', '_per_')}-{register.size}B"


def converts_back(register: Register, count: int) -> bool:
    quantity = register.physical(count)
    return register.count(quantity) == register.count_at_most(quantity) == register.count_at_least(quantity) == count


@pytest.mark.parametrize("register", SMALL, ids=describe)
def test_every_count_of_a_small_register_survives_the_way_to_its_quantity(register: Register) -> None:
    low, high = register.span
    assert all(converts_back(register, count) for count in range(low, high + 1))


@given(st.data())
def test_any_count_of_a_large_register_survives_the_way_to_its_quantity(data: st.DataObject) -> None:
    register = data.draw(st.sampled_from(LARGE))
    assert converts_back(register, data.draw(st.integers(*register.span)))


@pytest.mark.parametrize("register", LARGE, ids=describe)
def test_counts_from_all_over_a_large_register_survive_too(register: Register) -> None:
    # All near zero, both sides of every power of two (where float64's steps change), the ends, and some anywhere.
    low, high = register.span
    powers = [sign * 2**power + near for sign in (-1, 1) for power in range(33) for near in (-1, 0, 1)]
    ends = [low, low + 1, high - 1, high]
    rng = Random(0)
    anywhere = [rng.randint(low, high) for _ in range(5000)]
    for count in {*range(-5000, 5001), *powers, *ends, *anywhere, register.zero - 1, register.zero, register.zero + 1}:
        assert not low <= count <= high or converts_back(register, count)


@given(st.data())
def test_rounding_goes_down_up_and_to_the_nearest(data: st.DataObject) -> None:
    register = data.draw(st.sampled_from(list(MEASURED.values())))
    low, high = (register.physical(count) for count in register.span)
    quantity = data.draw(st.floats(low, high))
    assert register.unit is not None
    # A quantity that is a whole number of counts but for rounding counts as that number: 1e-8 counts of slack, and
    # at 2^32 counts what float64 can't tell apart there.
    slack = register.unit.per_count * 1e-8 + abs(quantity) * 1e-14
    below, above = register.count_at_most(quantity), register.count_at_least(quantity)
    assert above - below in (0, 1)
    assert register.physical(below) <= quantity + slack
    assert register.physical(below + 1) > quantity - slack
    assert register.physical(above) >= quantity - slack
    assert register.physical(above - 1) < quantity + slack
    assert abs(register.physical(register.count(quantity)) - quantity) <= register.unit.per_count / 2 + slack


@given(MODEL, st.integers(-5000, 5000))
def test_counts_survive_the_way_to_radians_and_back(model: ServoModel, count: int) -> None:
    assert model.count(model.rad(count)) == count


@given(MODEL, st.floats(-3.0, 3.0), st.floats(0.0, 3.0))
def test_a_range_of_angles_is_covered_and_by_no_count_more(model: ServoModel, lower: float, width: float) -> None:
    upper = lower + width
    first, last = model.counts_covering(lower, upper)
    slack = 1e-8 * model.rad_per_count
    assert model.rad(first) <= lower + slack
    assert model.rad(last) >= upper - slack
    assert model.rad(first + 1) > lower - slack
    assert model.rad(last - 1) < upper + slack


def test_limits_round_outward_where_truncation_would_cut_them() -> None:
    model = load_model("XM430-W350")  # -0.5 counts and 0.5 counts from zero: truncation gives 2048 to 2048
    half = 0.5 * model.rad_per_count
    assert model.counts_covering(-half, half) == (2047, 2049)
    assert load_model("AX-18A").counts_covering(math.radians(-150), math.radians(149)) == (0, 1021)  # 0.5, 1020.09


@given(MODEL, st.floats(0.0, 20.0))
def test_a_speed_in_units_never_exceeds_the_speed(model: ServoModel, rad_s: float) -> None:
    units = model.speed_units_within(rad_s)
    assert units * model.speed_unit_rad_s <= rad_s * (1 + 1e-8) + 1e-8  # a whole number of units stays that number
    assert units == model.speed_max or (units + 1) * model.speed_unit_rad_s > rad_s


@pytest.mark.parametrize("model", SPEEDS.values(), ids=lambda model: model.name)
def test_every_speed_unit_is_within_its_own_speed_and_not_within_less(model: ServoModel) -> None:
    speed = model.register(model.speed_register)
    for units in range(1, model.speed_max + 1):
        assert model.speed_units_within(speed.physical(units)) == units
        assert model.speed_units_within(speed.physical(units - 1e-6)) == units - 1
    assert model.speed_units_within(speed.physical(model.speed_max + 1)) == model.speed_max
    assert model.speed_units_within(-1.0) == model.speed_units_within(0.0) == 0


@pytest.mark.parametrize("name", MODELS)
def test_a_models_units_are_those_of_the_registers_in_these_roles(name: str) -> None:
    model = load_model(name)
    speed = model.register(model.speed_register)
    assert model.rad_per_count == pytest.approx(
        model.rad(model.zero_count + 1) - model.rad(model.zero_count), rel=1e-12
    )
    assert model.speed_unit_rad_s == pytest.approx(speed.physical(1), rel=1e-15)
    if model.acceleration_register is None:
        assert model.acceleration_unit_rad_s2 is None
    else:
        acceleration = model.register(model.acceleration_register)
        assert model.acceleration_unit_rad_s2 == pytest.approx(acceleration.physical(1), rel=1e-15)
    assert model.group_read == (model.sync_read or model.bulk_read)
    with pytest.raises(DriverError, match="'led' has no unit"):
        _ = dataclasses.replace(model, speed_register="led").speed_unit_rad_s


@pytest.mark.parametrize("name", MODELS)
@given(bits=st.integers(0, 255))
def test_every_error_bit_has_a_name_of_its_own(name: str, bits: int) -> None:
    model = load_model(name)
    names = model.error_names(bits)
    assert len(set(names)) == len(names) == bits.bit_count()
    assert {model.error_bits.get(bit, f"bit {bit}") for bit in range(8) if bits >> bit & 1} == set(names)


@given(st.data())
def test_every_value_of_every_register_survives_its_bytes(data: st.DataObject) -> None:
    model = load_model(data.draw(st.sampled_from(MODELS)))
    register = data.draw(st.sampled_from(sorted(model.registers.values(), key=lambda r: r.address)))
    low, high = {
        "unsigned": (0, 256**register.size - 1),
        "twos_complement": (-(256**register.size) // 2, 256**register.size // 2 - 1),
        "sign_magnitude": (-1023, 1023),
    }[register.encoding]
    assert register.span == (low, high)
    value = data.draw(st.integers(low, high))
    assert len(register.encode(value)) == register.size
    assert register.decode(register.encode(value)) == value
    for outside in (low - 1, high + 1):
        with pytest.raises(DriverError, match="doesn't fit"):
            register.encode(outside)


@given(st.data())
def test_every_pattern_of_bytes_is_a_value_and_that_value_those_bytes(data: st.DataObject) -> None:
    registers = itertools.chain.from_iterable(load_model(name).registers.values() for name in MODELS)
    register = data.draw(st.sampled_from(sorted(set(registers), key=repr)))
    raw = data.draw(st.binary(min_size=register.size, max_size=register.size))
    if register.encoding == "sign_magnitude":  # bits 11 to 15 mean nothing, and 1024 is 0 with a direction
        raw = (int.from_bytes(raw, "little") & 0x7FF).to_bytes(2, "little")
        raw = raw if raw != b"\x00\x04" else b"\x00\x00"
    assert register.encode(register.decode(raw)) == raw


def test_the_direction_bit_is_a_sign() -> None:
    # e-manual, AX-18A, Present Speed (38): 0 to 1023 anticlockwise, 1024 to 2047 clockwise
    speed = Register("present_speed", 38, 2, "RAM", False, "sign_magnitude")
    assert speed.decode((1024 + 300).to_bytes(2, "little")) == -300
    assert speed.encode(-300) == (1024 + 300).to_bytes(2, "little")


@pytest.mark.parametrize(
    ("name", "register", "count", "quantity", "printed_to"),
    [  # the manual's own examples; it prints them to the last column's precision
        ("AX-18A", "cw_compliance_margin", 255, 255 * 300 / 1023 * DEG, 1e-12 * DEG),
        ("AX-18A", "moving_speed", 1023, 114 * RPM, 0.5 * RPM),
        ("MX-64", "moving_speed", 300, 34.2 * RPM, 0.05 * RPM),
        ("MX-64", "moving_speed", 1023, 116.62 * RPM, 0.05 * RPM),
        ("MX-64", "current", 2048, 0.0, 1e-15),
        ("MX-64", "current", 2148, 0.450, 1e-15),
        ("MX-64", "current", 1948, -0.450, 1e-15),
        ("MX-28", "present_load", 512, 0.50, 0.01),
        ("MX-28", "goal_acceleration", 20, 171.66 * DEG, 0.005 * DEG),
        ("XL-320", "moving_speed", 300, 33.3 * RPM, 0.05 * RPM),
        ("XL-320", "max_voltage_limit", 80, 8.0, 1e-15),
        ("XM430-W350", "bus_watchdog", 100, 2.0, 1e-15),
        ("XM430-W350", "homing_offset", 1_044_479, 255 * 360 * DEG, 0.1 * DEG),
        ("XM430-W350", "pwm_limit", 885, 1.0, 1e-15),
        ("XM430-W350", "pwm_limit", 1, 0.00113, 0.000005),
        ("XM430-W350", "present_position", 2048 + 4096, 360 * DEG, 1e-12 * DEG),
        ("XM430-W350", "return_delay_time", 250, 500e-6, 1e-15),
        ("XM430-W350", "present_temperature", 32, 32.0, 1e-15),
        ("XM430-W210", "current_limit", 1193, 3.209, 0.0005),
        ("XH430-V350", "current_limit", 689, 0.923, 0.0005),
        ("XL330-M288", "goal_current", -1750, -1.75, 1e-15),
        ("XL430-W250", "present_load", -1000, -1.0, 1e-15),
        ("XC330-T288", "pwm_slope", 1, 3.955, 1e-15),  # mV/ms is V/s
        ("XH540-V150", "max_voltage_limit", 300, 30.0, 1e-15),
    ],
)
def test_quantities_are_the_manuals(name: str, register: str, count: int, quantity: float, printed_to: float) -> None:
    at = load_model(name).register(register)
    assert at.physical(count) == pytest.approx(quantity, abs=printed_to)
    assert at.count(at.physical(count)) == count


def test_no_quantity_without_a_unit_and_none_that_is_not_finite() -> None:
    model = load_model("XM430-W350")
    for convert in (model.register("led").physical, model.register("led").count):
        with pytest.raises(DriverError, match="'led' holds a plain number"):
            convert(1)
    for worthless in (math.nan, math.inf, -math.inf):
        for convert in (model.count, model.register("goal_position").count_at_most, model.speed_units_within):
            with pytest.raises(DriverError, match="finite"):
                convert(worthless)
    for quantity in (1e308, -1e308):  # so many counts are no float64
        with pytest.raises(DriverError, match="finite"):
            model.register("goal_position").count(quantity)
