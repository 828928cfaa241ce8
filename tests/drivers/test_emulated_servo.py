"""The emulated servo: its shaft keeps to its limits, its table to the manual."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.emulator import EmulatedServo
from drivers.emulator.servo import Refusal, Refused
from drivers.emulator.shaft import Shaft
from drivers.errors import DriverError
from drivers.servo_models import MODELS, load_model

S = 1_000_000_000
MOVES = st.lists(
    st.tuples(st.integers(1, 800_000_000), st.floats(-2.5, 2.5), st.floats(0.05, 6.0), st.floats(0.5, 60.0)),
    min_size=1,
    max_size=6,
)


def write(servo: EmulatedServo, register: str, value: int, t_ns: int) -> None:
    at = servo.model.register(register)
    servo.write(at.address, at.encode(value), t_ns)


def read(servo: EmulatedServo, register: str, t_ns: int) -> int:
    at = servo.model.register(register)
    return at.decode(servo.read(at.address, at.size, t_ns))


@given(MOVES)
def test_the_shaft_never_jumps_nor_exceeds_its_limits(moves: list[tuple[int, float, float, float]]) -> None:
    shaft, t_ns, fastest, hardest = Shaft(0.0), 0, 0.0, 0.0
    for wait_ns, goal, speed, acceleration in moves:
        shaft.move(t_ns, goal, speed, acceleration)
        fastest, hardest = max(fastest, speed), max(hardest, acceleration)
        times = np.linspace(t_ns, t_ns + wait_ns, 80).astype(np.int64)
        rad, rad_s = np.array([shaft.at(int(t)) for t in times]).T
        dt = np.diff(times) * 1e-9
        # 1e-7: phases begin on whole nanoseconds, at up to 6 rad/s and 60 rad/s^2
        assert np.all(np.abs(rad_s) <= fastest + 1e-7)
        assert np.all(np.abs(np.diff(rad)) <= fastest * dt + 1e-7)
        assert np.all(np.abs(np.diff(rad_s)) <= hardest * dt + 1e-6)
        t_ns += wait_ns
    arrived = t_ns + 300 * S
    assert shaft.at(arrived) == (goal, 0.0)
    assert not shaft.moving(arrived)


@given(st.floats(-2.5, 2.5), st.floats(0.05, 6.0), st.floats(0.5, 60.0))
def test_a_motion_from_rest_takes_the_trapezoids_time(goal: float, speed: float, acceleration: float) -> None:
    # Textbook time of a trapezoidal profile from rest to rest, or of a triangular one.
    distance = abs(goal)
    trapezoid = distance / speed + speed / acceleration
    triangle = 2 * math.sqrt(distance / acceleration)
    duration_s = trapezoid if distance >= speed * speed / acceleration else triangle
    shaft = Shaft(0.0)
    shaft.move(0, goal, speed, acceleration)
    assert not shaft.moving(math.ceil(duration_s * 1e9) + 10)
    assert duration_s < 1e-6 or shaft.moving(math.floor(duration_s * 1e9) - 10)
    assert shaft.at(math.floor(duration_s * 0.5e9))[0] == pytest.approx(goal / 2, abs=1e-7)  # it is symmetric


def test_a_goal_set_in_mid_motion_is_taken_up_at_the_present_speed() -> None:
    shaft = Shaft(0.0)
    shaft.move(0, 2.0, 1.0, 10.0)
    before = shaft.at(S)
    shaft.move(S, -2.0, 1.0, 10.0)
    assert shaft.at(S) == pytest.approx(before, abs=1e-12)
    assert shaft.at(S + S // 20)[0] > before[0]  # it runs on while it brakes from 1 rad/s, at 10 rad/s^2
    assert shaft.at(9 * S) == (-2.0, 0.0)


def test_the_past_is_kept_for_five_seconds() -> None:
    shaft = Shaft(0.0)
    for k in range(100):
        shaft.move(k * S // 10, 1.0 if k % 2 else -1.0, 1.0, 10.0)
    now_ns = 99 * S // 10
    again = Shaft(0.0)
    for k in range(60):  # as it was known 4 s before
        again.move(k * S // 10, 1.0 if k % 2 else -1.0, 1.0, 10.0)
    for t_ns in range(now_ns - 49 * S // 10, 59 * S // 10, 10_000_000):
        assert shaft.at(t_ns) == again.at(t_ns)
    with pytest.raises(DriverError, match="last 5 s"):
        shaft.at(now_ns - 7 * S)


@pytest.mark.parametrize("name", MODELS)
def test_registers_start_at_the_manuals_initial_values(name: str) -> None:
    servo = EmulatedServo(4, name)
    assert read(servo, "model_number", 0) == load_model(name).model_number
    assert read(servo, "id", 0) == 4
    assert read(servo, "return_delay_time", 0) == 250
    assert read(servo, "status_return_level", 0) == 2
    assert read(servo, "torque_enable", 0) == 0
    assert read(servo, "goal_position", 0) == read(servo, "present_position", 0) == load_model(name).zero_count


@pytest.mark.parametrize(
    ("name", "speed_register", "units", "rad_s"),
    [
        ("AX-18A", "moving_speed", 100, 100 * 0.111 * 2 * math.pi / 60),
        ("AX-18A", "moving_speed", 0, 97 * 2 * math.pi / 60),  # 0 is no limit: the no-load speed
        ("AX-18A", "moving_speed", 1023, 97 * 2 * math.pi / 60),  # faster than it can
        ("XM430-W350", "profile_velocity", 50, 50 * 0.229 * 2 * math.pi / 60),
        ("XM540-W270", "profile_velocity", 0, 128 * 0.229 * 2 * math.pi / 60),  # its Velocity Limit (44)
    ],
)
def test_the_shaft_turns_at_the_speed_of_the_register(name: str, speed_register: str, units: int, rad_s: float) -> None:
    servo = EmulatedServo(1, name, initial_count=0, max_acceleration_rad_s2=1e5)
    write(servo, speed_register, units, 0)
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", servo.model.resolution - 1, 0)
    rad0, rad1 = servo.shaft.at(S // 10)[0], servo.shaft.at(2 * S // 10)[0]
    assert (rad1 - rad0) * 10 == pytest.approx(rad_s, rel=1e-6)


def test_profile_acceleration_limits_the_acceleration() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    write(servo, "profile_acceleration", 10, 0)
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", 3000, 0)
    # X-series manual, Profile Acceleration (108): 214.577 rev/min^2 a unit
    assert servo.shaft.at(S // 10)[1] == pytest.approx(0.1 * 10 * 214.577 * 2 * math.pi / 3600, rel=1e-9)


def test_without_torque_nothing_moves_and_torque_off_stops_it() -> None:
    servo = EmulatedServo(1, "AX-18A")
    write(servo, "goal_position", 800, 0)
    assert servo.shaft.at(S)[0] == 0.0
    write(servo, "torque_enable", 1, S)
    write(servo, "torque_enable", 0, S + S // 10)
    rad, rad_s = servo.shaft.at(S + S // 2)
    assert 0 < rad < servo.model.rad(800)
    assert rad_s == 0.0
    assert servo.shaft.at(9 * S)[0] == rad


def test_the_present_is_told_in_whole_counts_and_units() -> None:
    servo = EmulatedServo(1, "AX-18A")
    write(servo, "moving_speed", 86, 0)  # 1.0 rad/s
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", 200, 0)
    rad, _ = servo.shaft.at(S)
    assert read(servo, "present_position", S) == round(512 + rad / servo.model.rad_per_count)
    assert read(servo, "present_speed", S) == -86
    assert read(servo, "present_load", S) < 0
    assert read(servo, "moving", S) == 1
    assert 110 <= read(servo, "present_voltage", S) <= 125
    assert 20 <= read(servo, "present_temperature", S) <= 50
    assert read(servo, "moving", 9 * S) == 0
    assert read(servo, "present_position", 9 * S) == 200


@pytest.mark.parametrize(
    ("name", "address", "data", "reason"),
    [
        ("XM430-W350", 36 + 96, b"\0\0\0\0", Refusal.ACCESS),  # Present Position is read-only
        ("XM430-W350", 116, b"\0\0", Refusal.LENGTH),  # half of Goal Position
        ("XM430-W350", 116, (5000).to_bytes(4, "little"), Refusal.LIMIT),
        ("XM430-W350", 112, (40_000).to_bytes(4, "little"), Refusal.RANGE),
        ("XM430-W350", 700, b"\0", Refusal.ACCESS),
        ("AX-18A", 30, (1023).to_bytes(2, "little"), Refusal.LIMIT),  # over CCW Angle Limit, set to 1000
        ("AX-18A", 48, (5).to_bytes(2, "little"), Refusal.RANGE),
    ],
)
def test_writes_that_the_manual_forbids_are_refused_and_change_nothing(
    name: str, address: int, data: bytes, reason: Refusal
) -> None:
    servo = EmulatedServo(1, name)
    if name == "AX-18A":
        write(servo, "ccw_angle_limit", 1000, 0)
    before = servo.read(0, servo.model.size_bytes, 0)
    with pytest.raises(Refused) as refused:
        servo.write(address, data, 0)
    assert refused.value.reason is reason
    assert servo.read(0, servo.model.size_bytes, 0) == before


def test_eeprom_is_locked_by_torque_on_x_and_by_lock_on_ax() -> None:
    x = EmulatedServo(1, "XM430-W350")
    write(x, "return_delay_time", 0, 0)
    write(x, "torque_enable", 1, 0)
    with pytest.raises(Refused):
        write(x, "return_delay_time", 10, 0)
    ax = EmulatedServo(1, "AX-18A")
    write(ax, "torque_enable", 1, 0)
    write(ax, "return_delay_time", 0, 0)
    write(ax, "lock", 1, 0)
    for register, value in (("return_delay_time", 10), ("lock", 0)):
        with pytest.raises(Refused):
            write(ax, register, value, 0)


def test_a_shutdown_takes_torque_until_reboot_on_x_and_sets_torque_limit_to_0_on_ax() -> None:
    x = EmulatedServo(1, "XM430-W350")
    write(x, "torque_enable", 1, 0)
    x.raise_alarm("overload", 0)
    assert read(x, "torque_enable", 0) == 0
    assert x.model.error_names(read(x, "hardware_error_status", 0)) == ("overload",)
    with pytest.raises(Refused):
        write(x, "torque_enable", 1, 0)
    x.reboot(S)
    write(x, "torque_enable", 1, S)
    ax = EmulatedServo(1, "AX-18A")
    write(ax, "torque_enable", 1, 0)
    ax.raise_alarm("overheating", 0)
    assert read(ax, "torque_limit", 0) == 0
    write(ax, "goal_position", 600, 0)
    assert ax.shaft.at(S)[0] == 0.0
    write(ax, "torque_limit", 1023, S)
    assert ax.shaft.at(9 * S)[0] == ax.model.rad(600)


def test_a_reboot_keeps_eeprom_and_a_factory_reset_does_not() -> None:
    servo = EmulatedServo(7, "XM430-W350")
    write(servo, "return_delay_time", 20, 0)
    write(servo, "led", 1, 0)
    servo.reboot(0)
    assert (read(servo, "return_delay_time", 0), read(servo, "led", 0)) == (20, 0)
    servo.factory_reset(0, keep=("id", "baud_rate"))
    assert (read(servo, "return_delay_time", 0), read(servo, "id", 0)) == (250, 7)


def test_a_registered_write_waits_for_action() -> None:
    servo = EmulatedServo(1, "AX-18A")
    servo.register_write(25, b"\1")
    assert (read(servo, "led", 0), read(servo, "registered", 0)) == (0, 1)
    servo.action(0)
    assert (read(servo, "led", 0), read(servo, "registered", 0)) == (1, 0)
    with pytest.raises(Refused) as refused:
        servo.action(0)
    assert refused.value.reason is Refusal.INSTRUCTION
