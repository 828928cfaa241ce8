"""A hand that turns an emulated servo's shaft: only while torque is off, and without the motor's doing."""

from __future__ import annotations

import math

import pytest

from drivers.emulator import EmulatedServo

SECOND = 1_000_000_000


def test_a_hand_turns_a_limp_servo_and_the_servo_reads_it():
    servo = EmulatedServo(1, "XM430-W350")
    servo.advance(0)
    servo.push(1.0, 2.0, 10.0, SECOND)
    assert servo.shaft_rad(SECOND) == 0.0
    assert servo.shaft_rad(3 * SECOND) == pytest.approx(1.0)
    address = servo.model.register("present_position").address
    count = int.from_bytes(servo.read(address, 4, 3 * SECOND), "little")
    assert count == pytest.approx(2048 + 4096 / math.tau, abs=1)


def test_a_hand_gives_way_to_torque():
    servo = EmulatedServo(1, "AX-18A")
    servo.advance(0)
    servo.write(servo.model.register("torque_enable").address, b"\x01", 0)
    servo.push(1.0, 2.0, 10.0, SECOND)
    assert servo.shaft_rad(4 * SECOND) == 0.0


def test_a_hand_bears_the_weight_and_the_motor_gives_nothing():
    servo = EmulatedServo(1, "XM430-W350", load_nm=lambda t_ns: -1.0)
    servo.push(0.5, 2.0, 10.0, 0)
    for t in range(1, 40):
        servo.advance(t * SECOND // 10)
    assert servo.shaft_rad(4 * SECOND) == pytest.approx(0.5)
    register = servo.model.register("present_current")
    assert register.decode(servo.read(register.address, register.size, 4 * SECOND)) == 0
    fallen = EmulatedServo(2, "XM430-W350", load_nm=lambda t_ns: -1.0)
    for t in range(1, 40):
        fallen.advance(t * SECOND // 10)
    assert fallen.shaft_rad(4 * SECOND) < -0.5  # what nobody holds falls
