"""The emulated servo's modes and frames: what a goal means, and what the present is counted in."""

from __future__ import annotations

import math

import pytest

from drivers.emulator import EmulatedServo
from drivers.emulator.servo import Refusal, Refused
from drivers.emulator.shaft import limits_for_duration, plan_motion
from drivers.errors import DriverError
from tests.drivers.servo_access import MS, RPM, TURN, S, physical, read, write

COUNT_X = TURN / 4096


def x_servo(model: str = "XM430-W350", **eeprom: int) -> EmulatedServo:
    """A servo with torque, configured so, at time 0."""
    servo = EmulatedServo(1, model, eeprom=eeprom)
    write(servo, "torque_enable", 1, 0)
    return servo


def test_velocity_mode_turns_on_and_on_at_goal_velocity() -> None:
    servo = x_servo(operating_mode=1)
    write(servo, "goal_velocity", -100, 0)
    rad_s = -100 * 0.229 * RPM
    assert servo.shaft_rad(9 * S) - servo.shaft_rad(1 * S) == pytest.approx(8 * rad_s, rel=1e-9)
    assert read(servo, "present_velocity", 9 * S) == -100
    assert read(servo, "present_position", 9 * S) < -4096  # several turns
    write(servo, "goal_velocity", 0, 9 * S)
    assert read(servo, "present_velocity", 10 * S) == 0


def test_velocity_mode_gains_speed_by_profile_acceleration() -> None:
    servo = x_servo(operating_mode=1)
    write(servo, "profile_acceleration", 10, 0)
    write(servo, "goal_velocity", 150, 0)
    # X-series manual, Profile Velocity (112): t1 = 64 * goal velocity / profile acceleration, in ms
    t1_s = 64 * 150 / 10 * 1e-3
    assert servo.shaft.at(round(t1_s * 0.5 * S))[1] == pytest.approx(75 * 0.229 * RPM, rel=2e-3)  # the 64 is rounded
    assert servo.shaft.at(round(t1_s * 1.01 * S))[1] == pytest.approx(150 * 0.229 * RPM, rel=1e-9)


def test_pwm_mode_turns_in_proportion_to_the_output() -> None:
    servo = x_servo(operating_mode=16)
    assert servo.shaft_rad(S) == 0.0  # its goal is 0 at first
    write(servo, "goal_pwm", 885 // 3, S)
    assert servo.shaft.at(3 * S)[1] == pytest.approx(46 * RPM / 3, rel=1e-9)
    assert read(servo, "present_pwm", 3 * S) == 885 // 3
    assert read(servo, "present_current", 3 * S) == 0  # at the speed of no load
    servo.obstruct(None, servo.shaft_rad(3 * S), 3 * S)
    assert physical(servo, "present_current", 4 * S) == pytest.approx(2.3 / 3, abs=0.0027)


def test_current_mode_turns_if_the_current_beats_friction() -> None:
    servo = x_servo(operating_mode=0)
    servo.obstruct(None, 0.5, 0)
    write(servo, "goal_current", 20, 0)
    assert servo.shaft_rad(S) == 0.0
    write(servo, "goal_current", 100, S)
    assert servo.shaft_rad(10 * S) == 0.5
    assert read(servo, "present_current", 10 * S) == 100


@pytest.mark.parametrize(("model", "full_rpm"), [("AX-12A", 59), ("XL-320", 114)])
def test_wheel_mode_of_ax_and_xl_320_is_a_part_of_the_output(model: str, full_rpm: int) -> None:
    wheel = {"control_mode": 1} if model == "XL-320" else {"cw_angle_limit": 0, "ccw_angle_limit": 0}
    servo = x_servo(model, **wheel)
    write(servo, "moving_speed", -512, 0)
    assert servo.shaft.at(5 * S)[1] == pytest.approx(-512 / 1023 * full_rpm * RPM, rel=1e-9)
    assert all(0 <= read(servo, "present_position", t) <= 1023 for t in range(5 * S, 9 * S, 100 * MS))


def test_wheel_mode_of_mx_is_a_speed() -> None:
    servo = x_servo("MX-28", cw_angle_limit=0, ccw_angle_limit=0)
    write(servo, "moving_speed", 200, 0)
    assert servo.shaft.at(5 * S)[1] == pytest.approx(200 * 0.114 * RPM, rel=1e-9)
    assert all(0 <= read(servo, "present_position", t) < 4096 for t in range(5 * S, 9 * S, 100 * MS))
    assert read(servo, "present_speed", 9 * S) == 200


def test_mx_multi_turn_mode_counts_turns_with_offset_and_divider() -> None:
    limits = {"cw_angle_limit": 4095, "ccw_angle_limit": 4095}
    servo = x_servo("MX-28", **limits, multi_turn_offset=1024, resolution_divider=2)
    # MX manual, Multi Turn Offset (20): it is added to the present position
    assert read(servo, "present_position", 0) == 2048 // 2 + 1024
    write(servo, "goal_position", 9216, 0)
    assert servo.shaft_rad(20 * S) == pytest.approx(((9216 - 1024) * 2 - 2048) * COUNT_X, abs=1e-9)
    assert read(servo, "present_position", 20 * S) == 9216


@pytest.mark.parametrize("mode", [4, 5])
def test_extended_and_current_based_position_go_beyond_the_position_limits(mode: int) -> None:
    servo = x_servo(operating_mode=mode, max_position_limit=3000)
    write(servo, "goal_position", 3 * 4096, 0)
    assert servo.shaft_rad(30 * S) == pytest.approx((3 * 4096 - 2048) * COUNT_X, abs=1e-12)
    with pytest.raises(Refused) as refused:
        write(servo, "goal_position", 1_048_576, 30 * S)
    assert refused.value.reason is Refusal.RANGE


def test_turns_are_forgotten_at_power_up_and_the_shaft_stays() -> None:
    servo = x_servo(operating_mode=4)
    write(servo, "goal_position", 3 * 4096 + 100, 0)
    standing = servo.shaft_rad(30 * S)
    servo.reboot(30 * S)
    assert read(servo, "present_position", 31 * S) == 100
    assert servo.shaft_rad(31 * S) == standing
    write(servo, "torque_enable", 1, 31 * S)
    write(servo, "goal_position", 500, 31 * S)
    assert servo.shaft_rad(40 * S) == pytest.approx(standing + 400 * COUNT_X, abs=1e-9)


def test_position_mode_begins_within_one_turn() -> None:
    servo = x_servo(operating_mode=1)
    write(servo, "goal_velocity", 100, 0)
    write(servo, "torque_enable", 0, 20 * S)
    assert read(servo, "present_position", 21 * S) > 4096
    write(servo, "operating_mode", 3, 21 * S)
    assert 0 <= read(servo, "present_position", 21 * S) < 4096
    assert read(servo, "goal_position", 21 * S) == read(servo, "present_position", 21 * S)


def test_a_change_of_mode_resets_profile_and_goals() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    write(servo, "profile_velocity", 30, 0)
    write(servo, "goal_current", 5, 0)
    write(servo, "operating_mode", 5, 0)
    assert read(servo, "profile_velocity", 0) == 0
    assert read(servo, "goal_current", 0) == read(servo, "current_limit", 0)
    assert read(servo, "goal_pwm", 0) == 885
    with pytest.raises(Refused) as refused:
        write(servo, "operating_mode", 2, 0)
    assert refused.value.reason is Refusal.RANGE


@pytest.mark.parametrize("offset", [-700, 1024])
def test_homing_offset_is_added_to_all_positions(offset: int) -> None:
    servo = x_servo(homing_offset=offset)
    assert read(servo, "present_position", 0) == 2048 + offset
    write(servo, "goal_position", 3000, 0)
    assert servo.shaft_rad(9 * S) == pytest.approx((3000 - offset - 2048) * COUNT_X, abs=1e-12)
    assert read(servo, "present_position", 9 * S) == 3000


def test_position_mode_ignores_a_homing_offset_over_a_quarter_turn() -> None:
    assert read(x_servo(homing_offset=1025), "present_position", 0) == 2048
    assert read(x_servo(homing_offset=1025, operating_mode=4), "present_position", 0) == 2048 + 1025


def test_a_reversed_servo_turns_and_counts_the_other_way() -> None:
    servo, straight = x_servo(drive_mode=1, homing_offset=100), x_servo()
    for each in (servo, straight):
        write(each, "profile_velocity", 20, 0)
    write(servo, "goal_position", 3100, 0)
    write(straight, "goal_position", 3000, 0)
    assert servo.shaft_rad(S) == -straight.shaft_rad(S) != 0
    assert read(servo, "present_velocity", S) == read(straight, "present_velocity", S) == 20
    assert read(servo, "present_current", S) == read(straight, "present_current", S) > 0
    # the sign of the offset isn't reversed (e-manual, Homing Offset)
    assert read(servo, "present_position", 20 * S) == 3100


def test_a_time_based_profile_arrives_at_its_time() -> None:
    servo = x_servo(drive_mode=4)
    write(servo, "profile_velocity", 2000, 0)
    write(servo, "profile_acceleration", 500, 0)
    write(servo, "goal_position", 3048, 0)
    way = 1000 * COUNT_X
    # X-series manual, Profile Velocity (112): t3 = 2000 ms, of which t1 = 500 ms at either end
    assert servo.shaft.at(S) == pytest.approx((way / 2, way / 1.5), rel=1e-6)
    assert servo.shaft_rad(S // 2) == pytest.approx(way / 1.5 * 0.25, rel=1e-6)
    assert read(servo, "moving", 2 * S - MS) == 1
    assert read(servo, "moving", 2 * S + MS) == 0
    assert servo.shaft_rad(3 * S) == way


@pytest.mark.parametrize("ramp", [0.0, 0.1, 0.5, 3.0])
@pytest.mark.parametrize("duration", [0.2, 1.0, 4.0])
def test_a_motion_takes_the_time_that_it_is_given(duration: float, ramp: float) -> None:
    speed, acceleration = limits_for_duration(1.0, duration, ramp, 100.0, 400.0)
    phases = plan_motion(0.0, 0.0, 1.0, speed, acceleration)
    assert sum(phase for phase, _ in phases) == pytest.approx(duration, rel=1e-6)


def test_torque_comes_with_a_goal_if_drive_mode_says_so() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"drive_mode": 8})
    write(servo, "goal_position", 2500, 0)
    assert read(servo, "torque_enable", 0) == 1
    assert servo.shaft_rad(9 * S) == 452 * COUNT_X


def test_moving_status_tells_profile_and_arrival() -> None:
    # X-series manual, Moving Status (123)
    servo = x_servo()
    write(servo, "goal_position", 3000, 0)
    assert read(servo, "moving_status", S // 10) == 0x02  # no profile, under way
    assert read(servo, "moving_status", 9 * S) == 0x01
    write(servo, "profile_velocity", 50, 9 * S)
    write(servo, "profile_acceleration", 50, 9 * S)
    write(servo, "goal_position", 2000, 9 * S)
    assert read(servo, "moving_status", 9 * S + S // 10) == 0x32
    write(servo, "goal_position", 1999, 19 * S)
    assert read(servo, "moving_status", 19 * S) == 0x22  # too short to reach its velocity


def test_goals_keep_to_the_limits_of_their_registers() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"operating_mode": 1, "velocity_limit": 100, "current_limit": 50})
    for register, value in (("goal_velocity", 101), ("goal_velocity", -101), ("goal_current", 51)):
        with pytest.raises(Refused) as refused:
            write(servo, register, value, 0)
        assert refused.value.reason is Refusal.LIMIT
    write(servo, "goal_velocity", -100, 0)


def test_indirect_data_is_the_registers_that_its_addresses_name() -> None:
    # X-series manual, Indirect Address, examples 1 and 2
    servo = x_servo()
    for number, address in enumerate((65, 116, 117, 118, 119, 132, 133, 134, 135), start=1):
        write(servo, f"indirect_address_{number}", address, 0)
    data = servo.model.register("indirect_data_1").address
    servo.write(data, bytes([1]) + (2300).to_bytes(4, "little"), 0)
    assert (read(servo, "led", 0), read(servo, "goal_position", 0)) == (1, 2300)
    assert servo.read(data, 9, 9 * S) == bytes([1]) + (2300).to_bytes(4, "little") * 2
    for values, reason in ((b"\1\0", Refusal.LENGTH), (b"\5", Refusal.RANGE)):
        with pytest.raises(Refused) as refused:
            servo.write(data, values, 9 * S)
        assert refused.value.reason is reason
    with pytest.raises(Refused) as refused:
        servo.write(data + 5, bytes(4), 9 * S)  # Present Position is read-only
    assert refused.value.reason is Refusal.ACCESS
    with pytest.raises(Refused) as refused:
        write(servo, "indirect_address_1", 7, 9 * S)  # EEPROM
    assert refused.value.reason is Refusal.RANGE


def test_indirect_data_that_points_at_itself_is_memory() -> None:
    servo = EmulatedServo(1, "XL330-M288")
    write(servo, "indirect_data_20", 77, 0)
    assert read(servo, "indirect_data_20", 0) == 77


def test_torque_control_of_mx_64_is_current_mode() -> None:
    servo = x_servo("MX-64")
    servo.obstruct(-0.5, None, 0)
    write(servo, "goal_torque", -300, 0)
    assert servo.shaft_rad(S) == 0.0
    write(servo, "torque_control_mode_enable", 1, S)
    assert servo.shaft_rad(10 * S) == -0.5
    assert physical(servo, "current", 10 * S) == pytest.approx(-300 * 0.0045, abs=1e-9)


def test_protocol_is_the_registers_or_the_models_only_one() -> None:
    assert [EmulatedServo(1, name).protocol for name in ("AX-12A", "XL-320", "MX-28", "MX-28(2.0)")] == [1, 2, 1, 2]
    servo = EmulatedServo(1, "XM430-W350", protocol=1.0)
    assert (servo.protocol, servo.get("protocol_type")) == (1.0, 1)
    servo.reboot(0)
    assert servo.protocol == 1.0
    servo.factory_reset(0)
    assert servo.protocol == 2.0
    with pytest.raises(DriverError, match=r"AX-12A speaks protocol 1\.0, not 2\.0"):
        EmulatedServo(1, "AX-12A", protocol=2.0)


def test_what_the_owner_configured_outlives_a_reboot_but_no_factory_reset() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"max_position_limit": 3000, "operating_mode": 4})
    servo.reboot(0)
    assert (servo.get("max_position_limit"), servo.get("operating_mode")) == (3000, 4)
    servo.factory_reset(0, keep=("id",))
    assert (servo.get("max_position_limit"), servo.get("operating_mode")) == (4095, 3)
    with pytest.raises(DriverError, match="isn't in the EEPROM area"):
        EmulatedServo(1, "XM430-W350", eeprom={"led": 1})


def test_voltage_is_nominal_and_time_ticks_in_milliseconds() -> None:
    servo = EmulatedServo(1, "XL330-M288")
    assert physical(servo, "present_input_voltage", 0) == pytest.approx(5.0)
    assert read(servo, "realtime_tick", 40 * S) == 40_000 % 32_768


def test_the_trajectory_registers_tell_where_control_wants_the_shaft() -> None:
    servo = EmulatedServo(1, "XM430-W350", load_nm=lambda _: -1.0)
    write(servo, "torque_enable", 1, 0)
    write(servo, "profile_velocity", 30, 0)
    write(servo, "goal_position", 3000, 0)
    assert read(servo, "velocity_trajectory", S) == 30
    assert read(servo, "position_trajectory", 30 * S) == 3000
    assert read(servo, "present_position", 30 * S) == 3000 - round(1.0 / 4.1 * 885 / (800 / 128))


def test_a_frames_counts_and_angles_are_inverse() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"drive_mode": 1, "homing_offset": -300, "operating_mode": 4})
    write(servo, "torque_enable", 1, 0)
    for k, count in enumerate((-9000, -1, 0, 4096, 20_000)):
        write(servo, "goal_position", count, 60 * k * S)
        assert read(servo, "present_position", 60 * (k + 1) * S) == count
        assert math.isclose(-servo.shaft_rad(60 * (k + 1) * S), (count + 300 - 2048) * COUNT_X, abs_tol=1e-9)
