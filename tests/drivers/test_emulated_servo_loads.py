"""The emulated servo under load: it droops, has play, runs into things, and falls when it is let go."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.emulator import EmulatedServo
from drivers.errors import DriverError
from drivers.servo_models import load_model
from tests.drivers.servo_access import MS, RPM, S, alarms, physical, read, write

COUNT_X = 2 * math.pi / 4096
COUNT_AX = math.radians(300) / 1023


def holding(model: str, count: int, **settings: object) -> EmulatedServo:
    """A servo with torque that went to a count from time 0 on."""
    servo = EmulatedServo(1, model, **settings)  # type: ignore[arg-type]
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", count, 0)
    return servo


@pytest.mark.parametrize("gain", [400, 800, 3200])
def test_an_x_servo_droops_by_load_over_proportional_gain(gain: int) -> None:
    # X-series manual, Position P Gain (84): gain / 128 of PWM a count; 885 is all of it
    load_nm, stall_nm = -1.5, load_model("XM430-W350").stall_nm
    servo = holding("XM430-W350", 2500, load_nm=lambda _: load_nm)
    write(servo, "position_p_gain", gain, 3 * S)
    droop = load_nm / stall_nm * 885 / (gain / 128) * COUNT_X
    assert servo.shaft_rad(6 * S) == pytest.approx((2500 - 2048) * COUNT_X + droop, abs=1e-9)
    assert read(servo, "present_position", 6 * S) == round(2500 + droop / COUNT_X)


def test_an_mx_servo_droops_by_load_over_p_gain() -> None:
    # MX manual, P Gain (28): gain / 8 a count; 1023 taken as full output
    servo = holding("MX-28", 2500, load_nm=lambda _: 0.5)
    droop = 0.5 / load_model("MX-28").stall_nm * 1023 / (32 / 8) * COUNT_X
    assert servo.shaft_rad(3 * S) == pytest.approx((2500 - 2048) * COUNT_X + droop, abs=1e-9)


@pytest.mark.parametrize(("slope", "effective"), [(32, 32), (63, 32), (64, 64), (1, 2)])
def test_an_ax_servo_droops_by_margin_and_slope(slope: int, effective: int) -> None:
    # AX manual, Compliance Slope (28, 29): its steps; Punch (48) is 32 of 1023
    share = 0.6 / load_model("AX-12A").stall_nm
    servo = holding("AX-12A", 600, load_nm=lambda _: -0.6)
    write(servo, "cw_compliance_slope", slope, S)
    write(servo, "cw_compliance_margin", 4, S)
    counts = 4 + effective * (share - 32 / 1023) / (1 - 32 / 1023)
    assert servo.shaft_rad(4 * S) == pytest.approx((600 - 512 - counts) * COUNT_AX, abs=1e-9)


def test_the_load_is_what_the_registers_tell() -> None:
    x = holding("XM430-W350", 2048, load_nm=lambda _: -2.05)
    assert physical(x, "present_current", S) == pytest.approx(2.05 / 4.1 * 2.3, abs=0.0027)  # half of the stall current
    assert physical(x, "present_pwm", S) == pytest.approx(0.5, abs=0.002)
    xl = holding("XL430-W250", 2048, load_nm=lambda _: 0.75)
    assert read(xl, "present_load", S) == -500  # it pushes clockwise, in per mille
    ax = holding("AX-12A", 512, load_nm=lambda _: 0.75)
    assert read(ax, "present_load", S) == pytest.approx(-1023 / 2, abs=1)
    mx = holding("MX-64", 2048, load_nm=lambda _: -3.0)
    assert physical(mx, "current", S) == pytest.approx(2.05, abs=0.0045)


def test_the_shaft_moves_through_its_play_when_the_direction_changes() -> None:
    play = math.radians(1)
    servo = holding("XM430-W350", 2500, backlash_rad=play)
    up = servo.shaft_rad(4 * S)
    write(servo, "goal_position", 2000, 4 * S)
    down = servo.shaft_rad(8 * S)
    write(servo, "goal_position", 2000 + round(play / 2 / COUNT_X), 8 * S)
    # it lags by half of the play on either side, and a motion smaller than the play doesn't reach it
    assert up == pytest.approx((2500 - 2048) * COUNT_X - play / 2, abs=1e-9)
    assert down == pytest.approx((2000 - 2048) * COUNT_X + play / 2, abs=1e-9)
    assert servo.shaft_rad(12 * S) == pytest.approx(down, abs=1e-9)


def test_a_load_takes_the_shaft_to_one_side_of_its_play() -> None:
    play, stall_nm = math.radians(1), load_model("XM430-W350").stall_nm
    servo = holding("XM430-W350", 2048, backlash_rad=play, load_nm=lambda t_ns: 0.1 if t_ns < 2 * S else -0.1)
    droop = 0.1 / stall_nm * 885 / (800 / 128) * COUNT_X
    assert servo.shaft_rad(1 * S) == pytest.approx(droop + play / 2, abs=1e-9)
    assert servo.shaft_rad(3 * S) == pytest.approx(-droop - play / 2, abs=1e-9)


def test_without_torque_a_load_turns_the_shaft_and_friction_holds_a_small_one() -> None:
    heavy = EmulatedServo(1, "XM430-W350", load_nm=lambda _: -0.55 * 4.1)
    light = EmulatedServo(1, "XM430-W350", load_nm=lambda _: -0.04 * 4.1)
    for servo in (heavy, light):
        servo.advance(0)
    # half of the stall torque after friction: half of the no-load speed
    assert heavy.shaft_rad(S) == pytest.approx(-0.5 * 46 * RPM, rel=1e-9)
    assert light.shaft_rad(S) == 0.0


def test_torque_off_drops_the_arm_and_torque_on_holds_it_where_it_is() -> None:
    servo = holding("XM430-W350", 2500, load_nm=lambda _: -1.0)
    held = servo.shaft_rad(3 * S)
    write(servo, "torque_enable", 0, 3 * S)
    fallen = servo.shaft_rad(4 * S)
    assert fallen < held - 0.5
    write(servo, "goal_position", read(servo, "present_position", 4 * S), 4 * S)
    write(servo, "torque_enable", 1, 4 * S)
    droop = 1.0 / 4.1 * 885 / (800 / 128) * COUNT_X
    assert servo.shaft_rad(6 * S) == pytest.approx(fallen - droop, abs=COUNT_X)


def test_a_load_over_the_stall_torque_turns_the_servo_back() -> None:
    # direct-current motor: at 1.5 times the stall torque it turns at half of the no-load speed, against its will
    servo = holding("XM430-W350", 2048, load_nm=lambda _: 1.5 * 4.1)
    assert servo.shaft_rad(S) - servo.shaft_rad(S // 2) == pytest.approx(0.5 * 46 * RPM * 0.5, rel=1e-9)


def test_a_load_that_asks_for_the_shaft_itself_gets_an_answer() -> None:
    # a pendulum of 1 Nm at 90 deg; the balance with the spring, solved by fixed-point iteration
    servo = EmulatedServo(1, "XM430-W350", load_nm=lambda t_ns: -1.0 * math.sin(servo.shaft_rad(t_ns)))
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", 2900, 0)
    spring_nm = 4.1 / 885 * (800 / 128) / COUNT_X
    rad = goal = (2900 - 2048) * COUNT_X
    for _ in range(100):
        rad = goal - math.sin(rad) / spring_nm
    assert servo.shaft_rad(5 * S) == pytest.approx(rad, abs=1e-6)


def test_servos_whose_loads_depend_on_each_other_move_the_same_whoever_is_asked_first() -> None:
    def moved(first: int) -> list[tuple[float, ...]]:
        def load_nm(t_ns: int) -> float:
            return -0.8 * math.sin(sum(servo.shaft_rad(t_ns) for servo in arm))

        arm = [EmulatedServo(id, "XM430-W350", load_nm=load_nm, backlash_rad=0.01) for id in (1, 2, 3)]
        asked = arm[first:] + arm[:first]
        angles: list[tuple[float, ...]] = []
        for t_ns in range(0, 3 * S, 111 * MS):
            for servo in asked:
                servo.hear(t_ns)
            if t_ns == 0:
                for servo in arm:
                    write(servo, "torque_enable", 1, t_ns)
                    write(servo, "goal_position", 2048 + 300 * servo.id, t_ns)
            angles.append(tuple(servo.shaft_rad(t_ns) for servo in arm))
        return angles

    assert moved(0) == moved(1) == moved(2)
    # each holds the weight at the angle of all three, by its spring
    *_, (one, two, three) = moved(0)
    droop = 0.8 * math.sin(one + two + three) / (4.1 / 885 * (800 / 128) / COUNT_X)
    assert 2 * 300 * COUNT_X - two == pytest.approx(droop + 0.005, abs=1e-6)


def test_a_push_that_rests_becomes_an_overload_when_the_gain_rises() -> None:
    servo = holding("XM430-W350", 2048)
    servo.obstruct(None, 0.2, 0)
    write(servo, "goal_position", 2190, 0)  # 0.218 rad: a push, no overload
    assert servo.shaft_rad(100 * S) == 0.2
    assert alarms(servo) == ()
    write(servo, "position_p_gain", 16_000, 100 * S)
    servo.advance(102 * S)
    assert alarms(servo) == ("overload",)


def test_the_shaft_stops_at_an_obstruction_and_goes_on_when_it_is_away() -> None:
    servo = holding("XM430-W350", 2500)
    write(servo, "goal_position", 2048, 3 * S)
    servo.obstruct(None, 0.3, 6 * S)
    write(servo, "goal_position", 2300, 6 * S)  # 0.387 rad: too near beyond it for full output
    assert servo.shaft_rad(8 * S) == 0.3
    output = (252 - 0.3 / COUNT_X) * 800 / 128 / 885  # proportional control
    assert physical(servo, "present_current", 8 * S) == pytest.approx(output * 2.3, abs=0.0027)
    servo.obstruct(None, None, 9 * S)
    assert servo.shaft_rad(11 * S) == (2300 - 2048) * COUNT_X
    assert alarms(servo) == ()


def test_a_goal_away_from_an_obstruction_is_set_out_for_from_there() -> None:
    servo = holding("XM430-W350", 2048, max_acceleration_rad_s2=1e6)
    write(servo, "profile_velocity", 10, 0)
    servo.obstruct(None, 0.05, 0)
    write(servo, "goal_position", 2150, 0)  # its profile ends 0.1 rad beyond
    assert servo.shaft_rad(2 * S) == 0.05
    write(servo, "goal_position", 2000, 2 * S)
    assert servo.shaft_rad(2 * S + S // 10) == pytest.approx(0.05 - 0.1 * 10 * 0.229 * RPM, abs=1e-6)


def test_an_obstruction_never_moves_the_shaft() -> None:
    servo = holding("XM430-W350", 2500)
    standing = servo.shaft_rad(3 * S)
    servo.obstruct(0.9, 1.5, 3 * S)
    assert servo.shaft_rad(4 * S) == standing
    write(servo, "goal_position", 2450, 4 * S)
    assert servo.shaft_rad(6 * S) == standing  # its bound is where the shaft stood
    write(servo, "goal_position", 2700, 6 * S)
    assert servo.shaft_rad(8 * S) == pytest.approx(652 * COUNT_X, abs=1e-12)


def test_pushing_with_all_it_has_is_an_overload_after_a_second() -> None:
    servo = holding("XM430-W350", 2048)
    servo.obstruct(None, 0.2, S)
    write(servo, "goal_position", 3000, S)
    t_ns = next(t for t in range(S, 5 * S, MS) if read(servo, "torque_enable", t) == 0)
    # full output where the profile is 141.6 counts beyond the obstruction: it gains 46 rpm at 40 rad/s^2 and goes on
    fastest, way = 46 * RPM, 0.2 + 885 / (800 / 128) * COUNT_X
    full_s = fastest / 40 + (way - fastest**2 / 80) / fastest
    assert t_ns == pytest.approx(S + full_s * S + S, abs=0.02 * S)  # a step of 10 ms to see it, and one to end it
    assert alarms(servo) == ("overload",)
    assert servo.shaft_rad(5 * S) == 0.2


def test_pressing_with_goal_current_is_no_overload() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"operating_mode": 5})
    servo.obstruct(None, 0.2, 0)
    write(servo, "goal_current", 200, 0)
    write(servo, "torque_enable", 1, 0)
    write(servo, "goal_position", 3000, 0)
    assert read(servo, "present_current", 5 * S) == 200
    assert alarms(servo) == ()


def test_the_shaft_is_continuous_whatever_the_load_does() -> None:
    def load_nm(t_ns: int) -> float:
        return 3.0 if t_ns // (S // 3) % 2 else -3.0

    servo = holding("XM430-W350", 3000, load_nm=load_nm, backlash_rad=0.02)
    times = range(0, 4 * S, MS)
    rad = np.array([servo.shaft_rad(t) for t in times])
    # no faster than motor and load together: 1 + 3.0 / 4.1 of the no-load speed, and once more for the play
    assert np.abs(np.diff(rad)).max() <= (2 + 3.0 / 4.1) * 46 * RPM * 1e-3 + 1e-12


def test_without_load_play_and_obstruction_the_shaft_is_its_profile() -> None:
    free, loaded = holding("XM430-W350", 3000), holding("XM430-W350", 3000, load_nm=lambda _: 0.0)
    times = range(0, 3 * S, 7 * MS)
    assert [loaded.shaft_rad(t) for t in times] == pytest.approx([free.shaft_rad(t) for t in times], abs=1e-12)


def test_the_past_under_load_is_kept_for_five_seconds() -> None:
    servo = holding("XM430-W350", 3000, load_nm=lambda t_ns: math.sin(t_ns * 2e-9), backlash_rad=0.01)
    write(servo, "profile_velocity", 5, 0)
    then = {t_ns: servo.shaft_rad(t_ns) for t_ns in range(0, 9 * S, 33 * MS)}
    now_ns = max(then)
    for t_ns, rad in then.items():
        if t_ns >= now_ns - 5 * S:
            assert servo.shaft_rad(t_ns) == rad
    with pytest.raises(DriverError, match="last 5 s"):
        servo.shaft_rad(now_ns - 6 * S)
