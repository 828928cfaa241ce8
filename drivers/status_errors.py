"""What the error byte of a status packet says: a damaged instruction, a refusal, an alarm of the servo."""

from __future__ import annotations

# Protocol 1.0, error byte (e-manual 1.0, Error): these bits are about the instruction, the others about the servo.
_REFUSALS_1 = {2: "angle limit", 8: "range", 64: "instruction"}
_CHECKSUM_1 = 16
# Protocol 2.0, error number (e-manual 2.0, Error); bit 7 is the alert.
_REFUSALS_2 = {
    1: "result fail",
    2: "instruction",
    4: "data range",
    5: "data length",
    6: "data limit (the value is outside the servo's own limits)",
    7: "access (read-only, or EEPROM while torque is on)",
}
_CRC_2, _ALERT_2 = 3, 0x80


def damaged(error: int, protocol: float) -> bool:
    """Whether the instruction arrived with a wrong checksum."""
    return bool(error & _CHECKSUM_1) if protocol == 1.0 else error & ~_ALERT_2 == _CRC_2


def refusals(error: int, protocol: float) -> tuple[str, ...]:
    """Why the servo didn't do what it was told; empty if it did."""
    if protocol == 1.0:
        return tuple(name for bit, name in _REFUSALS_1.items() if error & bit)
    number = error & ~_ALERT_2
    return (_REFUSALS_2.get(number, f"error {number}"),) if number and number != _CRC_2 else ()


def alarm_bits(error: int, protocol: float) -> int:
    """The bits that tell of the servo's own state: protocol 1.0 one for each alarm, 2.0 one for all of them."""
    return error & ~(_CHECKSUM_1 | sum(_REFUSALS_1)) if protocol == 1.0 else error & _ALERT_2
