"""A scan as people ask for it: which settings and ids, on whose port, and what the result means."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from drivers.clock import MonotonicClock
from drivers.packets import MAX_ID
from drivers.probe import Setting
from drivers.scan import ALL_IDS, Found, known_settings
from drivers.serial_ports import DEFAULT_LATENCY_MS, check_free, describe_ports, read_latency_ms
from station.doctor.expectation import Match, rig_setting
from station.emulated_arm import EmulatedArm
from station.errors import StationError
from station.formats.rig import EMULATED, RigTable

UNEXPECTED = "unexpected"
AS_EXPECTED = "as expected"


def parse_ids(text: str | None) -> tuple[int, ...]:
    """Ids of a text such as "1-20,30", all if None; raises StationError."""
    if text is None:
        return ALL_IDS
    ids: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise StationError(f"ids '{text}': '{part}' is no id and no range; want for instance 1-20,30")
        low, high = int(first), int(last or first)
        if not low <= high <= MAX_ID:
            raise StationError(f"ids '{text}': '{part}' isn't within 0 to {MAX_ID}; want for instance 1-20,30")
        ids += range(low, high + 1)
    return tuple(dict.fromkeys(ids))


def choose_settings(bauds: Sequence[int], protocols: Sequence[float], table: RigTable | None) -> list[Setting]:
    """Settings to try, the rig's own first; those of all known models but for what `bauds` and `protocols` leave."""
    known = known_settings(first=[] if table is None else [rig_setting(table)])
    chosen = [
        setting
        for setting in known
        if (not bauds or setting.baud in bauds) and (not protocols or setting.protocol in protocols)
    ]
    asked = [Setting(protocol, baud) for protocol in protocols or (2.0, 1.0) for baud in bauds]
    return [*chosen, *(setting for setting in asked if setting not in chosen)]


@contextmanager
def open_wire(port: str | None, table: RigTable | None) -> Iterator[tuple[str, float]]:
    """Path and latency (s) of the port to scan: the one given, else the rig's, which may be emulated.

    Raises:
        StationError: neither is given.
        NoPort: the port isn't there, or is held by another program.
    """
    if port is None and table is not None:
        port = table.bus.port
    if port is None:
        raise StationError(f"name a port, or a rig with --rig\n{describe_ports()}")
    if port == EMULATED:
        if table is None or table.simulation is None:
            raise StationError('port "emulated" needs a rig with a [simulation]: --rig RIG')
        with EmulatedArm(table, table.simulation, MonotonicClock()) as arm:
            yield arm.path, DEFAULT_LATENCY_MS / 1000
        return
    check_free(port)
    yield port, (read_latency_ms(port) or DEFAULT_LATENCY_MS) / 1000


def found_document(found: Found) -> dict[str, object]:
    """A servo that was found, for JSON."""
    return {
        "id": found.servo_id,
        "model": None if found.model is None else found.model.name,
        "model_number": found.model_number,
        "firmware": found.firmware,
        "protocol": found.setting.protocol,
        "baud": found.setting.baud,
        "answers_reads": found.answers_reads,
        "alarms": list(found.alarms),
        "shared_id": found.shared,
        "asked": found.asked,
        "damaged_replies": found.damaged,
        "doubled_replies": found.doubled,
    }


def match_document(match: Match) -> dict[str, object]:
    """An expected or found servo, for JSON."""
    want = match.expected
    expected = None
    if want is not None:
        expected = {
            "id": want.servo_id,
            "joint": want.joint,
            "model": want.model.name,
            "model_number": want.model.model_number,
            "protocol": want.setting.protocol,
            "baud": want.setting.baud,
        }
    return {
        "verdict": match.verdict,
        "expected": expected,
        "found": None if match.found is None else found_document(match.found),
    }


def match_rows(matches: Sequence[Match], *, with_rig: bool) -> list[list[str]]:
    """A table of them, the header first; without a rig there is nothing to compare with."""
    rows = [["id", "model (number)", "firmware", "protocol", "baud", *(["joint"] if with_rig else []), "remarks"]]
    for match in matches:
        have, want = match.found, match.expected
        joint = [want.joint if want else ""] if with_rig else []
        if have is None:
            cells = [str(want.servo_id), want.model.name] if want else ["", ""]
            rows.append([*cells, "", "", "", *joint, match.verdict])
            continue
        firmware = "" if have.firmware is None else str(have.firmware)
        setting = [f"{have.setting.protocol:.1f}", str(have.setting.baud)]
        remarks = "; ".join(_remarks(match, with_rig=with_rig))
        rows.append([str(have.servo_id), _model_text(have), firmware, *setting, *joint, remarks])
    return rows


def _model_text(found: Found) -> str:
    if found.model_number is None:
        return "not told"
    return f"{found.model.name if found.model else 'unknown'} ({found.model_number})"


def _remarks(match: Match, *, with_rig: bool) -> list[str]:
    remarks = [match.verdict] if with_rig else []
    if match.verdict == "wrong model" and match.expected is not None:
        remarks = [f"wrong model: the rig says {match.expected.model.name}"]
    have = match.found
    if have is None:
        return remarks
    if have.shared:
        remarks.append("replies collide: several servos with this id?")
    if not have.answers_reads:
        remarks.append("answers pings alone")
    return [*remarks, *(alarm.replace("_", " ") for alarm in have.alarms)]


def explain(matches: Sequence[Match], *, narrowed: bool) -> list[str]:
    """What to check and do, most likely first; empty where all is well.

    Args:
        narrowed: whether less than all bauds, protocols and ids were asked.
    """
    if all(match.found is None for match in matches):
        return _explain_silence(narrowed=narrowed)
    unexpected = [match.found for match in matches if match.expected is None and match.found is not None]
    lines = [line for match in matches for line in _explain_one(match, unexpected)]
    if any(match.verdict == "missing" for match in matches):
        lines.append("what is missing: the cable to it from the servo before, its power, the LED at power-up")
        if narrowed:
            lines.append("not all bauds, protocols and ids were asked: scan without --baud, --protocol and --ids")
    return lines


def _explain_silence(*, narrowed: bool) -> list[str]:
    everywhere = ["not all bauds, protocols and ids were asked: scan without --baud, --protocol and --ids"]
    return [
        *(everywhere if narrowed else []),
        "power: the servos have a supply of their own; their LEDs flash once when it is switched on",
        "cable: the right connector (3 pins TTL, 4 pins RS-485), firmly in, the chain unbroken from the adapter on",
        "adapter: a half-duplex one for Dynamixel servos, its switch (TTL, RS-485) at the servos' kind",
        "port: is it the adapter's? unplug it, see which port vanishes",
        "ids: new servos all have id 1 and talk at once: plug in one alone",
        "a servo that is stuck: switch it off and on; a firmware recovery is the last resort",
    ]


def _explain_one(match: Match, unexpected: Sequence[Found]) -> list[str]:
    want, have = match.expected, match.found
    lines: list[str] = []
    if have is not None and have.shared:
        lines.append(f"id {have.servo_id}: plug in one servo at a time, give each its own id; else check the cable")
    if have is not None and not have.answers_reads:
        lines.append(f"id {have.servo_id}: its status return level is 0: station doctor RIG --fix status-level")
    if have is not None and have.alarms:
        lines.append(f"id {have.servo_id}: it has an alarm: relieve its load, let it cool, switch it off and on")
    if want is None:
        return lines
    if match.verdict == "missing":
        twins = [other for other in unexpected if other.model_number == want.model.model_number]
        if twins:
            said = f"{want.where} is missing, and an {want.model.name} that the rig doesn't name has id"
            lines.append(f"{said} {twins[0].servo_id}: if that is it, give it id {want.servo_id}")
    elif match.verdict == "wrong model":
        lines.append(f"{want.where}: correct its model or id in the rig, or swap the servos")
    elif match.verdict != AS_EXPECTED and have is not None:
        lines.append(f"{want.where}: it speaks at {have.setting}: set it, or 'baud' and 'protocol' in the rig")
    return lines
