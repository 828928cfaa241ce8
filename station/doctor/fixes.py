"""What software can mend in a servo, each asked for by name: checked first, written, read back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.probe import Probe
from drivers.scan import Found
from drivers.servo_models import ServoModel
from drivers.servo_settings import ALL_STATUS, LIMITED_MODE, POSITION_MODES, mode_name
from station.doctor.expectation import Expected
from station.doctor.servos import TIME_BASED, Subject
from station.errors import StationError

STATUS_LEVEL = "status-level"
FIXES: dict[str, str] = {
    "return-delay": "replies come at once (Return Delay Time 0)",
    STATUS_LEVEL: "every instruction is answered (Status Return Level 2)",
    "drive-mode": "the profile is of speeds, not of times (Drive Mode, bit 2 cleared)",
    "operating-mode": "position control (Operating Mode)",
}


@dataclass(frozen=True)
class Change:
    """What became of a fix at one servo.

    Attributes:
        done: whether the servo now reads `after`.
        said: what was changed, or why nothing was.
    """

    where: str
    fix: str
    register: str
    before: int | None
    after: int | None
    done: bool
    said: str


def check_fixes(names: Sequence[str]) -> None:
    """Raise StationError, which lists the fixes, for a name that is none."""
    for name in names:
        if name not in FIXES:
            listed = "\n".join(f"{known}: {what}" for known, what in FIXES.items())
            raise StationError(f"no fix '{name}'; there are\n{listed}")


def fix_servo(name: str, subject: Subject) -> Change | None:
    """Do a fix at a servo that answers reads; None if there is nothing to change, or nothing it could be done to."""
    target = _target(name, subject)
    if target is None:
        return None
    register, before, after = target
    if (why := _forbidden(subject)) is not None:
        return Change(subject.expected.where, name, register, before, before, False, f"nothing was written: {why}")
    subject.bus.write(subject.servo.id, register, after)
    have = subject.read(register)
    return _change(subject.expected.where, name, register, before, after, have)


def fix_status_level(probe: Probe, found: Found, expected: Expected) -> Change | None:
    """Make a servo answer everything; None if it does. One that answers pings alone can't be asked for its torque.

    Spoken by a probe, as the driver needs the answers that this servo doesn't give.
    """
    name, where, model = "status_return_level", expected.where, expected.model
    if found.model_number not in (None, model.model_number):
        said = f"nothing was written: its model number is {found.model_number}, the rig says {model.name}"
        return Change(where, STATUS_LEVEL, name, None, None, False, said)
    register = model.register(name)
    before = _probed(probe, found.servo_id, model, name)
    if before == ALL_STATUS:
        return None
    if before is not None and _probed(probe, found.servo_id, model, "torque_enable"):
        said = "nothing was written: its torque is on, switch it off first"
        return Change(where, STATUS_LEVEL, name, before, before, False, said)
    probe.write(found.servo_id, register.address, register.encode(ALL_STATUS))
    have = _probed(probe, found.servo_id, model, name)
    if have is None:
        said = f"wrote {ALL_STATUS} to '{name}', it still answers no reads"
        return Change(where, STATUS_LEVEL, name, before, have, False, said)
    change = _change(where, STATUS_LEVEL, name, 0 if before is None else before, ALL_STATUS, have)
    if register.area == "RAM" and change.done:
        return Change(where, STATUS_LEVEL, name, before, have, True, f"{change.said}; until it is switched off")
    return change


def _change(where: str, fix: str, register: str, before: int, after: int, have: int) -> Change:
    if have != after:
        return Change(where, fix, register, before, have, False, f"wrote {after} to '{register}', it reads {have}")
    return Change(where, fix, register, before, have, True, f"'{register}' was {before}, it reads {have} now")


def _target(name: str, subject: Subject) -> tuple[str, int, int] | None:
    """Register, its value and the one it should have."""
    model = subject.model
    match name:
        case "return-delay":
            register, want = "return_delay_time", lambda have: 0
        case "operating-mode" if model.operating_mode_register is not None:
            register, want = model.operating_mode_register, lambda have: model.operating_modes[LIMITED_MODE]
        case "drive-mode" if TIME_BASED in model.drive_mode_bits.values():
            bit = next(bit for bit, flag in model.drive_mode_bits.items() if flag == TIME_BASED)
            register, want = "drive_mode", lambda have: have & ~(1 << bit)
        case _:
            return None
    before = subject.read(register)
    if name == "operating-mode" and mode_name(subject.bus, subject.servo.id, model) in POSITION_MODES:
        return None
    after = want(before)
    return None if after == before else (register, before, after)


def _forbidden(subject: Subject) -> str | None:
    """Why this servo must not be written to, None if it may."""
    want = subject.expected.model
    if subject.model.model_number != want.model_number:
        return f"it is a {subject.model.name}, the rig says {want.name}"
    if subject.read("torque_enable"):
        return "its torque is on, switch it off first"
    if subject.model.eeprom_lock == "lock" and subject.read("lock"):
        return "its EEPROM is locked until it is switched off and on"  # e-manual 1.0, Lock (47)
    return None


def _probed(probe: Probe, servo_id: int, model: ServoModel, name: str) -> int | None:
    register = model.register(name)
    for _ in range(3):
        heard = probe.read(servo_id, register.address, register.size)
        for status in heard.of(servo_id):
            if len(status.parameters) == register.size:
                return register.decode(status.parameters)
    return None
