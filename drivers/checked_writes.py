"""Writing registers so that it is known what the servos hold afterwards: together, and read back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from drivers.dynamixel import DynamixelBus
from drivers.errors import CorruptReply, DriverError, NoReply, ServoFault


def write_checked(bus: DynamixelBus, servo_id: int, register: str, value: int) -> None:
    """Write a register and read it back; raises ServoFault for a refusal, and for another value than was written."""
    bus.write(servo_id, register, value)
    have = bus.read(servo_id, register)
    if have != value:
        text = f"{bus.describe(servo_id)}: wrote {value} to '{register}', it reads {have}"
        text = f"{text}; check the servo's limits and that nothing else writes to it"
        raise ServoFault(text, servo_id=servo_id, joint=bus.joint(servo_id))


def write_together(bus: DynamixelBus, wanted: Mapping[str, Mapping[int, int]]) -> None:
    """Write registers of many servos, {register: {servo: value}}, one sync write each, and read all of them back.

    A servo that doesn't hold what it should is written to by itself, which tells why. All servos are told even if one
    fails; the first failure is raised then.
    """
    failures: list[DriverError] = []
    for register, values in wanted.items():
        bus.sync_write(register, values)
        have, _ = read_each(bus, values, register)
        for servo_id, value in values.items():
            if have.get(servo_id) != value:
                try:
                    write_checked(bus, servo_id, register, value)
                except DriverError as failure:
                    failures.append(failure)
    if failures:
        raise failures[0]


def read_each(bus: DynamixelBus, servo_ids: Iterable[int], register: str) -> tuple[dict[int, int], list[DriverError]]:
    """A register of each servo that answers, and the failures of those that don't; raises BusLost."""
    ids = list(servo_ids)
    try:
        return {servo_id: reading.value for servo_id, reading in bus.read_many(ids, register).items()}, []
    except (NoReply, CorruptReply):
        values: dict[int, int] = {}
        failures: list[DriverError] = []
    for servo_id in ids:
        try:
            values[servo_id] = bus.read(servo_id, register)
        except (NoReply, CorruptReply) as failure:
            failures.append(failure)
    return values, failures
