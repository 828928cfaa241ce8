"""What can go wrong on an emulated bus: the kinds of faults, and their one-line notation."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.errors import DriverError
from drivers.packets import MAX_ID

NOISE_BYTES = 8  # at most, where a noise fault doesn't say

FaultValue = float | str | tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One kind of fault.

    Attributes:
        value: what its value means, "" where it takes none.
        optional: whether the value may be left out.
        ends: whether it can be over after a duration.
        text: what happens.
    """

    text: str
    value: str = ""
    optional: bool = False
    ends: bool = True


# Those of a reply happen at each reply in their time, with their rate; the others once, with their rate.
REPLY_KINDS: Mapping[str, FaultKind] = {
    "mute": FaultKind("the servo does what it is told and doesn't answer"),
    "delay": FaultKind("the reply comes later", value="s"),
    "bad_crc": FaultKind("the reply's checksum is wrong"),
    "corrupt": FaultKind("one byte of the reply, any one, has another value"),
    "wrong_id": FaultKind("the reply says that it is from another servo; its checksum is right"),
    "truncate": FaultKind("the reply breaks off"),
    "noise": FaultKind("random bytes come before the reply", value=f"bytes at most ({NOISE_BYTES})", optional=True),
    "echo": FaultKind("the instruction comes back before the reply"),
    "stray": FaultKind("a whole valid reply of another servo comes before the reply"),
    "duplicate_id": FaultKind("a second servo with the same id answers too: both replies at once on the wire"),
}
STATE_KINDS: Mapping[str, FaultKind] = {
    "alert": FaultKind(
        "the servo fails, with what its Shutdown register makes of it", value="alarm's name", ends=False
    ),
    "status_level": FaultKind("the servo's status return level changes", value="0, 1 or 2"),
    "baud": FaultKind("the servo listens and answers at another baud", value="baud"),
    "voltage": FaultKind("the supply voltage changes", value="V"),
    "temperature": FaultKind("the temperature changes", value="deg C"),
    "obstruct": FaultKind(
        "the shaft can't leave a range of angles", value="from..to, deg from the zero count; or deg about where it is"
    ),
    "reboot": FaultKind("the servo has no power for the duration, a moment if none is given, and starts anew"),
    "unplug": FaultKind("the device vanishes, and comes back after the duration if there is one"),
}
KINDS: Mapping[str, FaultKind] = {**REPLY_KINDS, **STATE_KINDS}

_NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
_FAULT = re.compile(
    r"(?P<kind>\w+)(?::(?P<ids>\d+(?:,\d+)*))?"
    rf"(?:@(?P<at>{_NUMBER}))?(?:\+(?P<for>{_NUMBER}))?(?:%(?P<rate>{_NUMBER}))?(?:=(?P<value>.+))?"
)
_VALUE = re.compile(_NUMBER)
SYNTAX = "kind[:ids][@start s][+duration s][%rate][=value], for instance delay:2,3@1.5+10%0.1=0.05"


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of an emulated bus; raises DriverError for one that can never happen.

    Attributes:
        kind: a name of KINDS.
        servo_ids: whom it befalls; None: all of the bus.
        at_s: when it begins, on the bus's clock, from the bus's start.
        for_s: how long it lasts.
        rate: of the replies in that time, the share that it befalls; of a lasting change, how likely it is.
        value: as KINDS says: a number, the name of an alarm, or a range in degrees.
    """

    kind: str
    servo_ids: tuple[int, ...] | None = None
    at_s: float = 0.0
    for_s: float = math.inf
    rate: float = 1.0
    value: FaultValue = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise DriverError(f"no fault kind '{self.kind}'; there are {', '.join(KINDS)}")
        for wrong in (*_wrong_numbers(self), *_wrong_servos(self), *_wrong_value(self)):
            raise DriverError(f"fault '{self.kind}': {wrong}")


def parse_fault(text: str) -> Fault:
    """The fault in a line such as `delay:2,3@1.5+10%0.1=0.05`; raises DriverError that says what is wrong."""
    match = _FAULT.fullmatch(text.strip())
    if match is None:
        raise DriverError(f"'{text}' is no fault; want {SYNTAX}")
    try:
        return Fault(
            match["kind"],
            None if match["ids"] is None else tuple(map(int, match["ids"].split(","))),
            float(match["at"] or 0.0),
            float(match["for"] or math.inf),
            float(match["rate"] or 1.0),
            _parse_value(match["value"]),
        )
    except DriverError as error:
        raise DriverError(f"'{text}': {error}") from error


def format_fault(fault: Fault) -> str:
    """The fault as one line, which `parse_fault` reads."""
    parts = [fault.kind]
    if fault.servo_ids is not None:
        parts.append(":" + ",".join(map(str, fault.servo_ids)))
    if fault.at_s:
        parts.append(f"@{_format(fault.at_s)}")
    if fault.for_s != math.inf:
        parts.append(f"+{_format(fault.for_s)}")
    if fault.rate != 1:
        parts.append(f"%{_format(fault.rate)}")
    if fault.value is not None:
        parts.append(f"={format_value(fault.value)}")
    return "".join(parts)


def format_value(value: FaultValue) -> str:
    """A fault's value as its line has it; empty if there is none."""
    if isinstance(value, tuple):
        return f"{_format(value[0])}..{_format(value[1])}"
    return value or "" if isinstance(value, str | None) else _format(value)


def _format(number: float) -> str:
    return repr(float(number)).removesuffix(".0")


def _parse_value(text: str | None) -> FaultValue:
    if text is None:
        return None
    if _VALUE.fullmatch(text):
        return float(text)
    lower, dots, upper = text.partition("..")
    if dots and _VALUE.fullmatch(lower) and _VALUE.fullmatch(upper):
        return float(lower), float(upper)
    return text


def _wrong_numbers(fault: Fault) -> list[str]:
    wrong: list[str] = []
    if not 0 <= fault.at_s < math.inf:
        wrong.append(f"starts at {fault.at_s:g} s; want 0 or later")
    if not fault.for_s > 0:
        wrong.append(f"lasts {fault.for_s:g} s; want more than 0")
    if not 0 < fault.rate <= 1:
        wrong.append(f"has rate {fault.rate:g}; want more than 0, at most 1")
    if fault.for_s != math.inf and not KINDS[fault.kind].ends:
        wrong.append("has no end of its own; leave the duration out")
    return wrong


def _wrong_servos(fault: Fault) -> list[str]:
    if fault.servo_ids is None:
        return []
    if fault.kind == "unplug":
        return ["befalls the whole bus; leave the ids out"]
    if not fault.servo_ids or len(set(fault.servo_ids)) != len(fault.servo_ids):
        return [f"has ids {list(fault.servo_ids)}; want each once"]
    return [f"has id {id}; want 0 to {MAX_ID}" for id in fault.servo_ids if not 0 <= id <= MAX_ID]


def _wrong_value(fault: Fault) -> list[str]:
    kind, value = KINDS[fault.kind], fault.value
    if not kind.value:
        return [] if value is None else [f"takes no value; have {format_value(value)}"]
    want = f"want a value: {kind.value}"
    if value is None:
        return [] if kind.optional else [want]
    return [] if _fits(fault.kind, value) else [f"{want}; have {format_value(value)}"]


def _fits(kind: str, value: float | str | tuple[float, float]) -> bool:
    if kind == "alert":
        return isinstance(value, str) and bool(re.fullmatch(r"[a-z_ ]+", value))
    if isinstance(value, tuple):
        return kind == "obstruct" and -math.inf < value[0] <= value[1] < math.inf
    if isinstance(value, str) or not math.isfinite(value):
        return False
    match kind:
        case "status_level":
            return value in (0, 1, 2)
        case "noise" | "baud":
            return value >= 1 and value == int(value)
        case "temperature":
            return True
        case "obstruct":
            return value >= 0
        case _:
            return value > 0
