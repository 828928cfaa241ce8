"""An independent client, rustypot (its own codec, in Rust), talks to the emulated bus."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from drivers.clock import VirtualClock
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.servo_models import load_model

rustypot = pytest.importorskip("rustypot")

BAUD = 1_000_000
TIMEOUT_S = 5.0  # a reply takes microseconds; a stalled machine must not fail the test
IDS = [1, 2, 3]
# Models that rustypot's two classes of the X series say they cover (their `models()`), but for the 2XL430.
XL430, XL330 = "Xl430PyController", "Xl330PyController"
X_SERIES = {
    "XL430-W250": XL430,
    "XC430-W150": XL430,
    "XM430-W350": XL430,
    "XM540-W270": XL430,
    "XH540-W150": XL430,
    "XL330-M077": XL330,
    "XL330-M288": XL330,
    "XC330-T288": XL330,
}
EACH = pytest.mark.parametrize("model", X_SERIES)
# e-manual 2.0, Error: what a status packet may say.
DATA_RANGE, DATA_LIMIT, ACCESS, ALERT = 4, 6, 7, 0x80


@contextmanager
def bus_of(*models: str) -> Iterator[tuple[EmulatedBus, VirtualClock]]:
    """An emulated bus with a servo of each model, from id 1 on, 31 degrees Celsius and up, at its nominal voltage."""
    clock = VirtualClock()
    servos = [
        EmulatedServo(id, model, voltage_v=load_model(model).nominal_v, temperature_c=30.0 + id)
        for id, model in enumerate(models, 1)
    ]
    with EmulatedBus(servos, baud=BAUD, clock=clock) as bus:
        yield bus, clock


@contextmanager
def three(model: str) -> Iterator[tuple[Any, EmulatedBus, VirtualClock]]:
    """Three servos of a model, and rustypot's controller for them."""
    with bus_of(*[model] * 3) as (bus, clock):
        client = getattr(rustypot, X_SERIES[model])(bus.path, BAUD, TIMEOUT_S)
        try:
            yield client, bus, clock
        finally:
            client.close()


def pass_s(clock: VirtualClock, seconds: float) -> None:
    clock.sleep_until_ns(clock.now_ns() + round(seconds * 1e9))


@EACH
def test_servos_are_found_with_their_model_numbers(model: str) -> None:
    with three(model) as (client, _, _):
        assert all(client.ping(id) for id in IDS)
        assert client.sync_read_register(IDS, "model_number") == [load_model(model).model_number] * 3


def test_a_broadcast_ping_finds_them_too() -> None:
    with three("XM430-W350") as (client, _, _):
        # It listens for 0.8 s, whatever its timeout is: on a machine that is stalled for so long, again.
        assert any(client.broadcast_scan() == dict.fromkeys(IDS, 1020) for _ in range(5))


@EACH
def test_a_sync_write_moves_the_shafts_and_a_sync_read_sees_it(model: str) -> None:
    goals = [2400, 1700, 2700]
    with three(model) as (client, bus, clock):
        for id in IDS:
            client.write_register(id, "torque_enable", 1)
        assert client.sync_read_register(IDS, "torque_enable") == [1, 1, 1]
        assert client.sync_read_register(IDS, "present_position") == [2048, 2048, 2048]
        client.sync_write_register(IDS, "goal_position", goals)
        assert client.sync_read_register(IDS, "goal_position") == goals  # the sync write has arrived
        pass_s(clock, 3.0)
        assert client.sync_read_register(IDS, "present_position") == goals
        shafts = [bus.shaft_rad(id, clock.now_ns()) for id in IDS]
        assert shafts == pytest.approx([(goal - 2048) * 2 * math.pi / 4096 for goal in goals], abs=1e-9)  # rounding


@EACH
def test_the_speed_that_is_read_is_the_profiles_and_signed(model: str) -> None:
    with three(model) as (client, _, clock):
        client.sync_write_register(IDS, "profile_velocity", [40, 40, 40])
        for id in IDS:
            client.write_register(id, "torque_enable", 1)
        client.sync_write_register(IDS, "goal_position", [4000, 100, 2048])
        assert client.sync_read_register(IDS, "moving") == [1, 1, 0]
        pass_s(clock, 0.5)
        assert client.sync_read_register(IDS, "present_velocity") == [40, -40, 0]


@EACH
def test_temperatures_voltages_and_limits_are_read(model: str) -> None:
    known = load_model(model)
    with three(model) as (client, _, _):
        assert client.sync_read_register(IDS, "present_temperature") == [31, 32, 33]
        assert client.sync_read_register(IDS, "present_input_voltage") == [round(10 * known.nominal_v)] * 3
        for name in ("max_position_limit", "min_position_limit", "velocity_limit", "temperature_limit", "pwm_limit"):
            assert client.read_register(2, name) == known.register(name).initial


@EACH
def test_negative_values_stay_negative(model: str) -> None:
    with three(model) as (client, _, _):
        client.write_register(1, "homing_offset", -100)
        assert client.read_register(1, "homing_offset") == -100


@EACH
def test_refusals_are_told_by_their_numbers(model: str) -> None:
    with three(model) as (client, _, _):
        assert client.write_register_with_error(1, "max_position_limit", 5000) == DATA_RANGE
        assert client.write_register_with_error(1, "max_position_limit", 3000) == 0
        assert client.write_register_with_error(1, "torque_enable", 1) == 0
        assert client.write_register_with_error(1, "goal_position", 3500) == DATA_LIMIT
        assert client.write_register_with_error(1, "max_position_limit", 4095) == ACCESS  # torque is on
        assert client.read_register(1, "max_position_limit") == 3000


@EACH
def test_an_alert_is_told_until_a_reboot(model: str) -> None:
    with three(model) as (client, bus, _):
        client.write_register(3, "torque_enable", 1)
        bus.raise_alarm(3, "overload")
        assert client.read_register_with_error(3, "hardware_error_status") == (1 << 5, ALERT)
        assert client.sync_read_register_with_error(IDS, "torque_enable") == [(0, 0), (0, 0), (0, ALERT)]
        assert client.reboot(3)
        assert client.read_register_with_error(3, "hardware_error_status") == (0, 0)


@pytest.mark.parametrize("model", ["XM430-W350", "XM540-W270", "XL330-M288"])
def test_data_that_look_like_a_header_pass_both_ways(model: str) -> None:
    # Goal PWM (100) -1 and Goal Current (102) -515: FF FF FD FD, stuffed by the one, unstuffed by the other.
    data = b"\xff\xff\xfd\xfd"
    with three(model) as (client, _, _):
        assert client.write_raw_data_with_error(2, 100, list(data)) == 0
        assert bytes(client.read_raw_data(2, 100, 4)) == data
        client.sync_write_raw_data([1, 3], 100, [list(data), list(data)])
        assert [bytes(read) for read in client.sync_read_raw_data(IDS, 100, 4)] == [data, data, data]


@EACH
def test_a_fast_sync_read_tells_what_a_sync_read_does(model: str) -> None:
    with three(model) as (client, _, clock):
        for id in IDS:
            client.write_register(id, "torque_enable", 1)
        client.sync_write_register(IDS, "goal_position", [1000, 2000, 3000])
        assert client.sync_read_register(IDS, "goal_position") == [1000, 2000, 3000]
        pass_s(clock, 3.0)
        client.set_fast_sync_read(True)
        assert client.sync_read_register([3, 1, 2], "present_position") == [3000, 1000, 2000]
        assert client.sync_read_register([2, 3], "present_temperature") == [32, 33]


def test_both_protocols_on_one_wire() -> None:
    with bus_of("AX-12A", "XL430-W250") as (bus, _):
        for controller, id, number in (("AxPyController", 1, 12), (XL430, 2, 1060)):
            client = getattr(rustypot, controller)(bus.path, BAUD, TIMEOUT_S)
            assert client.ping(id)
            assert client.read_register(id, "model_number") == number
            client.close()


def test_models_of_two_kinds_on_one_wire() -> None:
    definitions = {
        1: rustypot.Xl430PyController.definition(),
        2: rustypot.Xl430PyController.definition(),
        3: rustypot.Xl330PyController.definition(),
    }
    with (
        bus_of("XM540-W270", "XL430-W250", "XL330-M288") as (bus, clock),
        rustypot.Bus(bus.path, BAUD, TIMEOUT_S, definitions) as client,
    ):
        assert client.set_torque(IDS, True) == {}
        client.sync_write_register(IDS, "goal_position", [2000, 2100, 2200])
        assert client.sync_read_register(IDS, "goal_position") == [2000, 2100, 2200]
        pass_s(clock, 3.0)
        assert client.sync_read_register(IDS, "present_position") == [2000, 2100, 2200]


def test_protocol_1_reads_of_ax() -> None:
    clock = VirtualClock()
    with EmulatedBus([EmulatedServo(1, "AX-18A", initial_count=700)], baud=BAUD, clock=clock) as bus:
        client = rustypot.AxPyController(bus.path, BAUD, TIMEOUT_S)
        assert client.ping(1)
        assert client.read_raw_present_position(1) in (700, [700])
        assert client.read_present_temperature(1) in (32, [32])
        client.write_torque_enable(1, True)
        assert client.read_torque_enable(1) in (1, True, [1], [True])
        client.close()


@pytest.mark.parametrize(("model", "controller"), [("AX-12A", "AxPyController"), ("MX-64", "MxPyController")])
def test_protocol_1_motion_and_refusals(model: str, controller: str) -> None:
    known = load_model(model)
    with bus_of(model, model) as (bus, clock):
        client = getattr(rustypot, controller)(bus.path, BAUD, TIMEOUT_S)
        assert [client.read_register(id, "model_number") for id in (1, 2)] == [known.model_number] * 2
        client.write_register(1, "torque_enable", 1)
        client.sync_write_register([1, 2], "goal_position", [600, 500])
        assert client.read_register(2, "goal_position") == 500  # the sync write has arrived
        pass_s(clock, 5.0)
        assert client.read_register(1, "present_position") == 600
        assert client.write_register_with_error(1, "ccw_angle_limit", known.resolution) == 1 << 3  # Range Error
        bus.raise_alarm(2, "overheating")
        assert client.read_register_with_error(2, "present_temperature") == (32, 1 << 2)
        client.close()
