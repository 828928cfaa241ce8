"""Servo models: the data is whole, found by name, number and protocol, and says what isn't verified."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys

import pytest

from drivers.errors import DriverError
from drivers.servo_models import MODELS, load_model, model_by_number

ROLES = ("goal_position", "present_position", "torque_enable", "return_delay_time", "status_return_level", "baud_rate")
PROTOCOL_1_ONLY = {"AX-12A", "AX-18A", "MX-28", "MX-64", "MX-106"}
NO_CURRENT_SENSOR = {"MX-28(2.0)", "XL430-W250", "XC430-W150", "XC430-W240"}


def test_the_models_of_the_supported_arms_are_here() -> None:
    assert len(MODELS) == 30
    assert {"AX-12A", "AX-18A", "XL430-W250", "XM430-W350", "XM540-W270", "XL330-M077", "XL330-M288"} <= set(MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_a_models_registers_are_whole(name: str) -> None:
    model = load_model(name)
    assert model.name == name
    assert model.sources
    assert model_by_number(model.model_number) is model
    named = {*ROLES, model.speed_register, model.present_speed_register, model.voltage_register, model.registered_flag}
    named |= {*model.position_limit_registers, "model_number", "id", "moving", "present_temperature", "shutdown"}
    named |= {model.effort_register, model.eeprom_lock}
    named |= {register for register in (model.acceleration_register, model.hardware_error_register) if register}
    assert named <= set(model.registers)
    ends = [(register.address, register.address + register.size) for register in model.registers.values()]
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(ends)), "registers overlap"
    assert ends[-1][1] <= model.size_bytes
    for register in model.registers.values():
        for value in (register.initial, register.minimum, register.maximum):
            assert value is None or register.decode(register.encode(value)) == value


def test_no_two_models_have_the_same_number() -> None:
    assert len({load_model(name).model_number for name in MODELS}) == len(MODELS)


@pytest.mark.parametrize(
    ("name", "register", "address", "size"),
    [
        ("AX-18A", "goal_position", 30, 2),  # e-manual, AX-18A, Control Table of RAM Area
        ("AX-18A", "moving_speed", 32, 2),
        ("AX-18A", "present_position", 36, 2),
        ("MX-106", "drive_mode", 10, 1),  # e-manual, MX-106, Control Table of EEPROM Area
        ("MX-64", "goal_torque", 71, 2),
        ("XL-320", "torque_limit", 35, 2),  # e-manual, XL-320, Control Table of RAM Area; not 34, as on the AX
        ("XL-320", "shutdown", 18, 1),
        ("XL330-M288", "shutdown", 63, 1),
        ("XM430-W350", "profile_velocity", 112, 4),  # e-manual, XM430-W350, Control Table of RAM Area
        ("XM430-W350", "goal_position", 116, 4),
        ("XM430-W350", "present_position", 132, 4),
        ("XM540-W150", "external_port_data_3", 156, 2),
        ("XM430-W350", "indirect_address_28", 222, 2),
        ("XM430-W350", "indirect_address_29", 578, 2),
        ("XM430-W350", "indirect_data_56", 661, 1),
        ("XL330-M288", "indirect_data_20", 227, 1),
    ],
)
def test_addresses_are_the_manuals(name: str, register: str, address: int, size: int) -> None:
    at = load_model(name).register(register)
    assert (at.address, at.size) == (address, size)


@pytest.mark.parametrize(("name", "number"), [("AX-12A", 12), ("MX-28", 29), ("MX-64", 310), ("MX-106", 320)])
def test_model_numbers_of_protocol_1_are_the_manuals(name: str, number: int) -> None:
    assert load_model(name).model_number == number  # e-manual, Model Number (0); the other oracles have protocol 2.0


@pytest.mark.parametrize("name", [name for name in MODELS if 2.0 in load_model(name).protocols and name != "XL-320"])
def test_address_126_is_the_load_without_a_current_sensor_and_the_current_with_one(name: str) -> None:
    model = load_model(name)
    effort = model.register(model.effort_register)
    assert effort.address == 126
    assert effort.unit is not None
    assert effort.unit.si == ("1" if name in NO_CURRENT_SENSOR else "A")
    assert (
        ("goal_current" in model.registers) == ("current_limit" in model.registers) == (name not in NO_CURRENT_SENSOR)
    )


@pytest.mark.parametrize("name", MODELS)
def test_protocol_decides_how_a_servo_recovers_and_what_locks_its_eeprom(name: str) -> None:
    model = load_model(name)
    if name in PROTOCOL_1_ONLY:  # e-manual, Shutdown (18), Lock (47)
        assert model.protocols == (1.0,)
        assert (model.recovery, model.eeprom_lock, model.hardware_error_register) == ("torque_limit", "lock", None)
    else:  # e-manual, X series, Shutdown (63); protocol 2.0 has the instruction
        assert 2.0 in model.protocols
        assert (model.recovery, model.eeprom_lock) == ("reboot", "torque_enable")
        assert model.hardware_error_register is not None


@pytest.mark.parametrize(
    ("name", "errors"),
    [  # e-manual, Shutdown: the initial value, 36, 3, 52 or 53, and the table of its bits
        ("AX-12A", ("overheating", "overload")),
        ("MX-64", ("overheating", "overload")),
        ("XL-320", ("overload", "overheating")),
        ("XM430-W350", ("overheating", "electrical_shock", "overload")),
        ("XL330-M077", ("input_voltage", "overheating", "electrical_shock", "overload")),
        ("XC330-T181", ("overheating", "electrical_shock", "overload")),
    ],
)
def test_a_new_servo_shuts_down_for_the_errors_of_the_manual(name: str, errors: tuple[str, ...]) -> None:
    model = load_model(name)
    assert model.error_names(model.register("shutdown").initial or 0) == errors


def test_a_new_servo_talks_at_1_million_or_57600_baud() -> None:
    # e-manual, Baud Rate: the initial values of AX and XL-320 against those of MX and X
    fast = {name for name in MODELS if load_model(name).factory_baud == 1_000_000}
    assert fast == {"AX-12A", "AX-18A", "XL-320"}
    assert {load_model(name).factory_baud for name in MODELS} == {57_600, 1_000_000}


@pytest.mark.parametrize("name", MODELS)
def test_a_servo_reaches_its_no_load_speed_within_its_registers(name: str) -> None:
    # Two facts of the manual that must agree: speed limits as delivered are a little over the no-load speed, but for
    # those of old pages, which are marked. A wrong unit or a slipped digit is a factor of two at least.
    model = load_model(name)
    assert model.stall_nm > 0
    assert model.stall_a > 0
    if "velocity_limit" in model.registers and "velocity_limit" not in model.unverified:
        limit = model.register("velocity_limit")
        assert limit.initial is not None
        assert 0.8 < limit.physical(limit.initial) / model.no_load_rad_s < 1.35
    else:
        assert model.speed_max * model.speed_unit_rad_s > 0.99 * model.no_load_rad_s


@pytest.mark.parametrize(
    ("name", "register", "limit"),
    [  # e-manual, Goal PWM (100), Goal Current (102), Goal Velocity (104): their ranges
        ("XM430-W350", "goal_pwm", "pwm_limit"),
        ("XM430-W350", "goal_current", "current_limit"),
        ("XL430-W250", "goal_velocity", "velocity_limit"),
        ("XM430-W350", "goal_position", None),
    ],
)
def test_a_goal_names_the_register_that_bounds_it(name: str, register: str, limit: str | None) -> None:
    assert load_model(name).register(register).within == limit


def test_what_is_not_verified_is_named_with_the_reason() -> None:
    assert "recovery" in load_model("XL-320").unverified
    assert "1188" in load_model("XH540-V270").unverified["current_limit"]
    assert "208" in load_model("XL330-M288").unverified["indirect"]
    assert not load_model("AX-18A").unverified.keys() & {"goal_position", "moving_speed", "shutdown"}


def test_of_an_mx_servo_the_protocol_tells_which_firmware_it_has() -> None:
    assert load_model("MX-28") is load_model("MX-28", protocol=1.0)
    assert load_model("MX-28", protocol=2.0) is load_model("MX-28(2.0)")
    assert load_model("MX-28(2.0)", protocol=1.0) is load_model("MX-28(2.0)")  # Protocol Type (13) can be 1
    assert (load_model("MX-28").model_number, load_model("MX-28(2.0)").model_number) == (29, 30)
    with pytest.raises(DriverError, match=r"AX-18A speaks protocol 1\.0, not 2\.0"):
        load_model("AX-18A", protocol=2.0)
    with pytest.raises(DriverError, match=r"XL-320 speaks protocol 2\.0, not 1\.0"):
        load_model("XL-320", protocol=1.0)


@pytest.mark.parametrize(("said", "meant"), [("XM430-W350-T", "XM430-W350"), ("ax-18a", "AX-18A"), ("MX-28T", "MX-28")])
def test_a_name_with_a_connectors_suffix_is_not_taken_but_understood(said: str, meant: str) -> None:
    with pytest.raises(DriverError, match=f"no servo model '{said}'; did you mean {meant}"):
        load_model(said)


def test_unknown_names_list_what_there_is() -> None:
    with pytest.raises(DriverError, match="AX-18A"):
        load_model("MX-99")
    with pytest.raises(DriverError, match=r"goal_position.*indirect_address_29 to 56"):
        load_model("XM430-W350").register("goal")
    for past_the_end in ("indirect_data_57", "indirect_data_0", "indirect_address_57"):
        with pytest.raises(DriverError, match="no register"):
            load_model("XM430-W350").register(past_the_end)
    with pytest.raises(DriverError, match="no register"):
        load_model("AX-18A").register("indirect_data_1")
    assert model_by_number(9999) is None


def test_listing_the_models_reads_no_file_of_them() -> None:
    code = "import sys, drivers.servo_models as s; assert len(s.MODELS) == 30; print('tomllib' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.strip() == "False"


def test_a_revolution_is_4096_counts_and_300_degrees_are_1023() -> None:
    assert load_model("XM430-W350").rad(2048 + 1024) == pytest.approx(math.pi / 2, rel=1e-15)
    ax = load_model("AX-18A")
    assert ax.rad(1023) - ax.rad(0) == pytest.approx(math.radians(300), rel=1e-15)
