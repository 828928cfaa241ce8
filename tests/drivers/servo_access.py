"""Registers of an emulated servo by their names, for its tests."""

from __future__ import annotations

import math

from drivers.emulator import EmulatedServo

S = 1_000_000_000
MS = 1_000_000
RPM = 2 * math.pi / 60  # rad/s
TURN = 2 * math.pi


def write(servo: EmulatedServo, register: str, value: int, t_ns: int) -> None:
    at = servo.model.register(register)
    servo.write(at.address, at.encode(value), t_ns)


def read(servo: EmulatedServo, register: str, t_ns: int) -> int:
    at = servo.model.register(register)
    return at.decode(servo.read(at.address, at.size, t_ns))


def physical(servo: EmulatedServo, register: str, t_ns: int) -> float:
    return servo.model.register(register).physical(read(servo, register, t_ns))


def alarms(servo: EmulatedServo) -> tuple[str, ...]:
    return servo.model.error_names(servo.alarm)
