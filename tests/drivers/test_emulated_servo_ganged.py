"""Emulated servos that turn one joint: a secondary id, or a sync cable."""

from __future__ import annotations

import pytest

from drivers.emulator import EmulatedServo
from drivers.emulator.servo import Refusal, Refused
from drivers.errors import DriverError
from drivers.servo_models import MODELS, load_model
from tests.drivers.servo_access import MS, S, alarms, read, write

CABLED = [name for name in MODELS if load_model(name).sync_cable]


def pair(model: str, *, twisted: bool = False, **leader: int) -> tuple[EmulatedServo, EmulatedServo]:
    """A leader and its follower on a sync cable; the leader with torque, from time 0 on."""
    first = EmulatedServo(1, model, eeprom=leader)
    second = EmulatedServo(2, model, eeprom={"drive_mode": 2}, initial_count=1000)
    second.follow(first, twisted=twisted)
    write(first, "torque_enable", 1, 0)
    return first, second


def test_a_secondary_id_is_one_below_253() -> None:
    assert [
        EmulatedServo(1, "XM430-W350", eeprom={"secondary_id": value}).secondary_id for value in (0, 252, 253, 255)
    ] == [0, 252, None, None]
    assert EmulatedServo(1, "AX-12A").secondary_id is None


def test_by_its_secondary_id_only_ram_is_written() -> None:
    servo = EmulatedServo(1, "XM430-W350", eeprom={"secondary_id": 5})
    servo.write(servo.model.register("led").address, b"\1", 0, ram_only=True)
    with pytest.raises(Refused) as refused:
        servo.write(servo.model.register("return_delay_time").address, b"\1", 0, ram_only=True)
    assert refused.value.reason is Refusal.ACCESS
    assert (servo.get("led"), servo.get("return_delay_time")) == (1, 250)


@pytest.mark.parametrize("name", CABLED)
@pytest.mark.parametrize("twisted", [False, True])
def test_a_follower_turns_as_its_leader_does_and_ignores_its_own_goals(name: str, twisted: bool) -> None:
    leader, follower = pair(name, twisted=twisted)
    start = follower.shaft_rad(0)
    write(follower, "torque_enable", 1, 0)
    write(follower, "goal_position", 4000, 0)
    write(leader, "goal_position", 2500, 0)
    for t_ns in range(0, 4 * S, 37 * MS):
        turned = leader.shaft_rad(t_ns)
        assert follower.shaft_rad(t_ns) == pytest.approx(start + (-turned if twisted else turned), abs=1e-12)
    assert read(follower, "present_position", 4 * S) == 1000 + (-452 if twisted else 452)


def test_the_cable_decides_the_direction_not_the_reverse_bit() -> None:
    # e-manual, Drive Mode, Dual Mode
    leader, follower = pair("XM540-W270")
    write(follower, "drive_mode", 3, 0)
    write(leader, "goal_position", 2500, 0)
    assert follower.shaft_rad(9 * S) - follower.model.rad(1000) == pytest.approx(leader.shaft_rad(9 * S), abs=1e-12)
    assert read(follower, "present_position", 9 * S) == 4096 - 1000 - 452  # but it counts the other way


def test_a_follower_shares_its_leaders_load() -> None:
    leader, follower = pair("XM540-W270", twisted=True)
    leader.obstruct(None, 0.1, 0)
    write(leader, "goal_position", 3000, 0)
    assert read(follower, "present_current", S) == -read(leader, "present_current", S) < 0
    follower.advance(3 * S)
    assert alarms(leader) == alarms(follower) == ("overload",)


def test_without_cable_a_follower_stands_and_without_its_bit_it_is_free() -> None:
    alone = EmulatedServo(2, "XM540-W270", eeprom={"drive_mode": 2})
    write(alone, "torque_enable", 1, 0)
    write(alone, "goal_position", 3000, 0)
    assert alone.shaft_rad(5 * S) == 0.0
    leader, follower = pair("XM540-W270")
    write(leader, "goal_position", 2300, 0)
    standing = follower.shaft_rad(5 * S)
    write(follower, "drive_mode", 0, 5 * S)
    write(leader, "goal_position", 2048, 5 * S)
    assert follower.shaft_rad(9 * S) == standing
    write(follower, "torque_enable", 1, 9 * S)
    write(follower, "goal_position", 1000, 9 * S)
    assert follower.shaft_rad(19 * S) == pytest.approx(follower.model.rad(1000), abs=1e-9)
    assert follower.shaft_rad(14 * S + 500 * MS) < standing


def test_a_follower_that_wasnt_asked_for_long_is_where_its_leader_went() -> None:
    leader, follower = pair("XM540-W270")
    for k in range(60):
        write(leader, "goal_position", 2000 + 10 * (k % 7), k * S)
    assert follower.shaft_rad(60 * S) - follower.model.rad(1000) == pytest.approx(leader.shaft_rad(60 * S), abs=1e-12)


def test_only_two_servos_with_a_socket_are_cabled() -> None:
    with pytest.raises(DriverError, match="XM430-W350 has no sync cable"):
        EmulatedServo(1, "XM430-W350").follow(EmulatedServo(2, "XM540-W270"))
    leader, follower = pair("XM540-W270")
    with pytest.raises(DriverError, match="joins two servos"):
        leader.follow(follower)
    with pytest.raises(DriverError, match="obstruct that one"):
        follower.obstruct(None, 1.0, 0)
