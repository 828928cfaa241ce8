"""The emulated servo's protections, each at its own time: voltage, heat, overload, watchdog; and how torque returns."""

from __future__ import annotations

import math

import pytest

from drivers.emulator import EmulatedServo
from drivers.emulator.heat import FULL_LOAD_RISE_C, TIME_CONSTANT_S
from drivers.emulator.servo import Refusal, Refused
from drivers.errors import DriverError
from drivers.servo_models import MODELS
from tests.drivers.servo_access import MS, S, alarms, read, write

TWO_RECOVERIES = ["XM430-W350", "AX-18A"]


def pushing(model: str) -> EmulatedServo:
    """A servo that has pushed against an obstruction since 0 s."""
    servo = EmulatedServo(1, model)
    servo.obstruct(None, 0.0, 0)
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", servo.model.count(2.5), 0)
    return servo


def has_torque(servo: EmulatedServo, t_ns: int) -> bool:
    limit = read(servo, "torque_limit", t_ns) if "torque_limit" in servo.model.registers else 1
    return bool(read(servo, "torque_enable", t_ns) and limit)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("cause", ["input_voltage", "overheating", "overload"])
def test_every_model_raises_its_alarms_and_obeys_its_shutdown_mask(name: str, cause: str) -> None:
    servo = pushing(name) if cause == "overload" else EmulatedServo(1, name)
    write(servo, "torque_enable", 1, 0)
    if cause == "input_voltage":
        servo.set_voltage(2.0, S)
    elif cause == "overheating":
        servo.set_temperature(100.5, S)
    mask = servo.get("shutdown")
    servo.advance(3 * S)
    assert alarms(servo) == (cause,)
    assert has_torque(servo, 3 * S) is not bool(mask & servo.alarm)
    if servo.model.hardware_error_register is not None:
        assert read(servo, servo.model.hardware_error_register, 3 * S) == servo.alarm


def test_a_reboot_gives_torque_back_to_an_x_servo_and_nothing_else_does() -> None:
    servo = pushing("XM430-W350")
    servo.obstruct(None, None, 3 * S)
    with pytest.raises(Refused) as refused:
        write(servo, "torque_enable", 1, 4 * S)
    assert refused.value.reason is Refusal.ACCESS
    servo.reboot(5 * S)
    assert servo.alarm == 0
    write(servo, "torque_enable", 1, 5 * S)
    write(servo, "goal_position", 2500, 5 * S)
    assert read(servo, "present_position", 9 * S) == 2500


def test_writing_torque_limit_gives_torque_back_to_an_ax_servo() -> None:
    servo = pushing("AX-18A")
    assert read(servo, "torque_limit", 3 * S) == 0
    standing = servo.shaft_rad(3 * S)
    servo.obstruct(None, None, 3 * S)
    write(servo, "goal_position", 600, 3 * S)
    assert servo.shaft_rad(4 * S) == standing
    write(servo, "torque_limit", 1023, 4 * S)
    assert servo.alarm == 0
    assert read(servo, "present_position", 9 * S) == 600


@pytest.mark.parametrize("model", TWO_RECOVERIES)
def test_a_cause_that_stays_shuts_down_again(model: str) -> None:
    servo = EmulatedServo(1, model, ambient_c=95.0)
    servo.set_temperature(95.0, S)
    assert alarms(servo) == ()
    servo.advance(2 * S)
    if model == "XM430-W350":
        servo.reboot(2 * S)
    else:
        write(servo, "torque_limit", 1023, 2 * S)
        assert read(servo, "torque_limit", 2 * S) == 0
    assert alarms(servo) == ("overheating",)


def test_a_voltage_alarm_goes_on_the_ax_and_stays_on_the_x() -> None:
    for model, left in (("AX-18A", ()), ("XM430-W350", ("input_voltage",))):
        servo = EmulatedServo(1, model)
        servo.set_voltage(5.9, S)
        servo.set_voltage(12.0, 2 * S)
        servo.advance(S)
        assert alarms(servo) == ("input_voltage",)
        servo.advance(2 * S)
        assert alarms(servo) == left


@pytest.mark.parametrize("volt", [5.9, 14.1])
def test_both_voltage_limits_count(volt: float) -> None:
    servo = EmulatedServo(1, "AX-18A", voltage_v=volt)
    servo.advance(0)
    assert alarms(servo) == ("input_voltage",)
    assert read(servo, "present_voltage", 0) == round(10 * volt)


def test_full_load_heats_by_the_first_order_law_until_it_is_too_hot() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"shutdown": 0b100})  # overheating alone
    servo.obstruct(None, 0.0, 0)
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", 4000, 0)
    start_c, limit_c = 32.0, 80.0
    at_100_s = start_c + FULL_LOAD_RISE_C * (1 - math.exp(-100 / TIME_CONSTANT_S))
    assert read(servo, "present_temperature", 100 * S) == pytest.approx(at_100_s, abs=0.6)
    # full output is reached 0.2 s after the start
    too_hot_s = -TIME_CONSTANT_S * math.log(1 - (limit_c - start_c) / FULL_LOAD_RISE_C)
    assert has_torque(servo, round((too_hot_s - 0.5) * S))
    assert not has_torque(servo, round((too_hot_s + 0.5) * S))
    assert "overheating" in alarms(servo)


def test_half_load_heats_a_quarter_as_much() -> None:
    servo = EmulatedServo(1, "XM430-W350", load_nm=lambda _: -2.05)
    write(servo, "torque_enable", 1, 0)
    risen_c = FULL_LOAD_RISE_C / 4 * (1 - math.exp(-200 / TIME_CONSTANT_S))
    assert read(servo, "present_temperature", 200 * S) == round(32 + risen_c)


def test_too_hot_is_seen_at_its_very_time() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"operating_mode": 0})
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_current", 856, 0)  # 2.3 A, of the stall torque
    too_hot_ns = round(-TIME_CONSTANT_S * math.log(1 - (80 - 32) / FULL_LOAD_RISE_C) * S)
    assert has_torque(servo, too_hot_ns - MS)
    assert not has_torque(servo, too_hot_ns + MS)


def test_a_resting_servo_cools_to_its_surroundings() -> None:
    servo = EmulatedServo(1, "XM430-W350", temperature_c=60.0, ambient_c=20.0)
    servo.advance(0)
    later_c = 20 + 40 * math.exp(-120 / TIME_CONSTANT_S)
    assert read(servo, "present_temperature", 120 * S) == round(later_c)


def test_the_watchdog_stops_the_shaft_and_refuses_goals_until_it_is_cleared() -> None:
    # X-series manual, Bus Watchdog (98), its example
    servo = EmulatedServo(1, "XM430-W350", eeprom={"operating_mode": 1})
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_velocity", 50, 0)
    write(servo, "bus_watchdog", 5, 0)
    for t_ns in range(0, S, 90 * MS):
        servo.hear(t_ns)
        last_ns = t_ns
    strikes_ns = last_ns + 100 * MS
    servo.advance(10 * S)
    assert servo.shaft.at(strikes_ns)[1] > 0
    assert servo.shaft.at(strikes_ns + 200 * MS)[1] == 0
    assert read(servo, "bus_watchdog", 10 * S) == -1
    assert read(servo, "torque_enable", 10 * S) == 1
    for register, value in (("goal_velocity", 50), ("goal_position", 0), ("goal_pwm", 0), ("bus_watchdog", 5)):
        with pytest.raises(Refused) as refused:
            write(servo, register, value, 10 * S)
        assert refused.value.reason is Refusal.RANGE
    write(servo, "bus_watchdog", 0, 11 * S)
    assert servo.shaft.at(12 * S)[1] == 0
    write(servo, "goal_velocity", 150, 12 * S)
    assert read(servo, "present_velocity", 13 * S) == 150


def test_the_watchdog_strikes_exactly_at_its_time_whenever_it_is_asked() -> None:
    for asked in (range(0, 2 * S, 7 * MS), [2 * S]):
        servo = EmulatedServo(1, "XM430-W350")
        write(servo, "bus_watchdog", 20, 0)
        write(servo, "torque_enable", 1, 0)
        write(servo, "goal_position", 4000, 300 * MS)
        servo.hear(300 * MS)
        for t_ns in asked:
            read(servo, "present_position", t_ns)
        assert read(servo, "bus_watchdog", 2 * S) == -1
        assert servo.shaft.at(700 * MS)[1] == pytest.approx(46 * 2 * math.pi / 60)
        assert servo.shaft.at(701 * MS)[1] < 46 * 2 * math.pi / 60


def test_after_the_watchdog_no_register_but_a_goal_starts_a_motion() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    write(servo, "bus_watchdog", 5, 0)
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", 4000, 0)
    write(servo, "bus_watchdog", 0, S)
    standing = servo.shaft_rad(S)
    write(servo, "profile_velocity", 100, S)
    assert servo.shaft_rad(3 * S) == standing
    write(servo, "goal_position", 4000, 3 * S)
    assert read(servo, "present_position", 9 * S) == 4000


def test_the_watchdog_watches_only_while_torque_is_on() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    write(servo, "bus_watchdog", 1, 0)
    assert read(servo, "bus_watchdog", 5 * S) == 1
    write(servo, "torque_enable", 1, 5 * S)
    assert read(servo, "bus_watchdog", 5 * S + 20 * MS) == 1
    assert read(servo, "bus_watchdog", 5 * S + 21 * MS) == -1


@pytest.mark.parametrize("name", MODELS)
def test_the_eeprom_area_is_locked_by_the_models_register(name: str) -> None:
    servo = EmulatedServo(1, name)
    write(servo, "return_delay_time", 10, 0)
    write(servo, "torque_enable", 1, 0)
    if servo.model.eeprom_lock == "lock":
        write(servo, "return_delay_time", 11, 0)
        write(servo, "lock", 1, 0)
    with pytest.raises(Refused) as refused:
        write(servo, "return_delay_time", 12, 0)
    assert refused.value.reason is Refusal.ACCESS
    write(servo, "torque_enable", 0, 0)
    if servo.model.eeprom_lock == "lock":
        with pytest.raises(Refused):
            write(servo, "return_delay_time", 12, 0)
        servo.reboot(0)  # power off and on
    write(servo, "return_delay_time", 12, 0)


def test_an_alarm_that_is_scheduled_happens_at_its_time() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    servo.raise_alarm("electrical_shock", 2 * S)
    write(servo, "torque_enable", 1, S)
    assert read(servo, "torque_enable", 2 * S - 1) == 1
    assert read(servo, "torque_enable", 2 * S) == 0
    with pytest.raises(DriverError, match="no alarm 'boredom'; it has input_voltage, overheating"):
        servo.raise_alarm("boredom", 3 * S)


def test_a_shutdown_in_mid_motion_brakes() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", 4095, 0)
    servo.set_temperature(90.0, S // 2)
    rad, rad_s = servo.shaft_rad(S // 2), servo.shaft.at(S // 2)[1]
    assert rad_s > 0
    # it brakes at the default 40 rad/s^2
    assert servo.shaft_rad(5 * S) == pytest.approx(rad + rad_s**2 / (2 * 40), abs=1e-9)


def test_things_happen_in_the_order_of_their_times() -> None:
    seen: list[int] = []
    servo = EmulatedServo(1, "AX-12A")
    servo.advance(0)
    for t_ns in (3 * S, S, 2 * S, S):
        servo.schedule(t_ns, seen.append)
    servo.advance(2 * S)
    assert seen == [S, S, 2 * S]
    servo.schedule(0, seen.append)  # past: at once
    assert seen[-1] == 2 * S
    servo.advance(9 * S)
    assert seen[-1] == 3 * S
