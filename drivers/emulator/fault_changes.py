"""What faults that last do to emulated servos when they begin and when they end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from drivers.emulator.fault_schedule import Change
from drivers.emulator.faults import FaultValue
from drivers.emulator.servo import EmulatedServo

Member = TypeVar("Member")


class FaultChanges:
    """The faults that have begun on these servos and haven't ended, and what was before them."""

    def __init__(self, servos: Sequence[EmulatedServo]) -> None:
        self._servos = servos
        self._unplugged: set[int] = set()  # numbers of the faults
        self._unpowered: set[tuple[int, EmulatedServo]] = set()
        self._values: dict[tuple[str, EmulatedServo], _Overlaid] = {}

    @property
    def plugged(self) -> bool:
        """Whether no fault keeps the device away."""
        return not self._unplugged

    def powered(self, servo: EmulatedServo) -> bool:
        """Whether the servo has power."""
        return all(servo is not other for _, other in self._unpowered)

    def apply(self, change: Change) -> None:
        """Let a fault begin or end."""
        if change.fault.kind == "unplug":
            _toggle(self._unplugged, change.number, present=change.begins)
            return
        for servo in self._servos:
            if servo.id in change.servo_ids:
                self._befall(servo, change)

    def _befall(self, servo: EmulatedServo, change: Change) -> None:
        t_ns = change.t_ns
        match change.fault.kind:
            case "alert":
                servo.raise_alarm(str(change.fault.value), t_ns)
            case "status_level":
                servo.set("status_return_level", int(self._value(servo, change, servo.get("status_return_level"))))
            case "baud":
                codes = {baud: code for code, baud in servo.model.baud_codes.items()}
                servo.set("baud_rate", codes[int(self._value(servo, change, servo.baud))])
            case "voltage":
                servo.set_voltage(self._value(servo, change, servo.voltage_v), t_ns)
            case "temperature":
                servo.set_temperature(self._value(servo, change, servo.temperature_c(t_ns)), t_ns)
            case "obstruct":
                free_rad = _free_rad(change.fault.value, servo.shaft_rad(t_ns))
                servo.obstruct(*(free_rad if change.begins else (None, None)), t_ns)
            case _:  # reboot
                servo.reboot(t_ns)
                if change.fault.for_s != math.inf:
                    _toggle(self._unpowered, (change.number, servo), present=change.begins)

    def _value(self, servo: EmulatedServo, change: Change, present: float) -> float:
        """What holds from now on: the value of the fault that began last and hasn't ended, else what was before."""
        overlaid = self._values.setdefault((change.fault.kind, servo), _Overlaid(present))
        if not overlaid.values:
            overlaid.before = present
        if change.begins:
            overlaid.values[change.number] = _number(change.fault.value)
        else:
            overlaid.values.pop(change.number, None)
        return list(overlaid.values.values())[-1] if overlaid.values else overlaid.before


@dataclass(slots=True)
class _Overlaid:
    """A quantity that faults have changed: what it was before them, and their values in the order of their begin."""

    before: float
    values: dict[int, float] = field(default_factory=dict[int, float])


def _toggle(members: set[Member], member: Member, *, present: bool) -> None:
    (members.add if present else members.discard)(member)


def _number(value: FaultValue) -> float:
    return value if isinstance(value, float | int) else 0.0


def _free_rad(value: FaultValue, present_rad: float) -> tuple[float, float]:
    """The angles that an obstructed shaft can take, rad from the zero count."""
    if isinstance(value, tuple):
        return math.radians(value[0]), math.radians(value[1])
    around = math.radians(_number(value))
    return present_rad - around, present_rad + around
