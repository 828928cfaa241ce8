"""What the commands of the servo bus do, as functions: scan, doctor, emulate; as `station.commands` for sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.clock import MonotonicClock
from drivers.emulator import parse_fault
from drivers.errors import DriverError
from station.emulated_arm import EmulatedArm
from station.errors import InvalidData
from station.rig_reading import check_arm, read_rig

if TYPE_CHECKING:
    from drivers.scan import Event, Found
    from station.doctor.checkup import Checkup
    from station.doctor.expectation import Match


@dataclass(frozen=True)
class Scan:
    """What a scan asks for, and what it found.

    Attributes:
        path: the port.
        matches: each servo that was found or expected.
        complete: False where it was stopped; what had been found by then is there.
        narrowed: whether it left out bauds, protocols or ids.
    """

    path: str
    matches: tuple[Match, ...]
    complete: bool
    narrowed: bool


def scan(
    port: str | None = None,
    *,
    bauds: Sequence[int] = (),
    protocols: Sequence[float] = (),
    ids: str | None = None,
    rig: str | None = None,
    on_event: Callable[[Event], None] = lambda event: None,
) -> Scan:
    """Find the servos on a port, whatever their baud, protocol and id; nothing is written to them.

    Args:
        port: the rig's if None.
        bauds, protocols: to try; all that known models have if empty.
        ids: such as "1-20,30"; all if None.
        rig: whose servos are expected: the name of a packaged one, or a path.
        on_event: is told of every step, of what is found and of what is skipped. A KeyboardInterrupt ends the scan.

    Raises:
        StationError: for a rig, protocols or ids that can't be.
        NoPort: the port isn't there, or is held by another program.
    """
    from drivers.scan import Found
    from drivers.scan import scan as scan_port
    from station.doctor.expectation import expected_servos, match_found
    from station.doctor.scanning import choose_settings, open_wire, parse_ids

    if any(version not in (1.0, 2.0) for version in protocols):
        raise InvalidData(f"protocol {list(protocols)}: want 1.0 or 2.0")
    table = None if rig is None else read_rig(rig)[0]
    expected = () if table is None else expected_servos(table)
    settings, chosen = choose_settings(bauds, protocols, table), parse_ids(ids)
    found: list[Found] = []
    complete = True
    with open_wire(port, table) as (path, latency_s):
        known = [want.servo_id for want in expected]
        with closing(scan_port(path, settings, chosen, expected=known, latency_s=latency_s)) as events:
            try:
                for event in events:
                    if isinstance(event, Found):
                        found.append(event)
                    on_event(event)
            except KeyboardInterrupt:
                complete = False
    narrowed = bool(bauds or protocols or ids is not None or not complete)
    return Scan(path, tuple(match_found(expected, found)), complete, narrowed)


def doctor(
    rig: str,
    *,
    simulate: bool = False,
    fixes: Sequence[str] = (),
    say: Callable[[str], None] = lambda name: None,
) -> Checkup:
    """Check a rig (the name of a packaged one, or a path) before it is used; nothing moves.

    Args:
        simulate: the emulated bus and the rendered camera, whatever the rig names.
        fixes: names of what is to be mended in the servos; nothing else is ever written.
        say: is told what is looked at next.

    Raises:
        StationError: the rig can't be read, or a fix isn't known.
    """
    from station.doctor.checkup import examine

    return examine(rig, simulate=simulate, fixes=fixes, say=say)


@contextmanager
def emulate(
    rig: str, *, faults: Sequence[str] = (), link: Path | None = None, seed: int | None = None
) -> Iterator[EmulatedArm]:
    """The emulated bus of a rig on the real clock, open until the block ends; its `path` is the device.

    Registers are as the servos come out of the box, but for ids, baud, and what the rig says of how they are built;
    they stand at the park pose. A `[simulation]` of the rig, if there is one, gives their load, play and faults.

    Args:
        rig: the name of a packaged one, or a path.
        faults: lines such as "mute:3@2+1", in addition to the rig's own.
        link: path of the device; in a temporary folder if None.
        seed: of everything random; the rig's own if None.

    Raises:
        InvalidFile: a bad rig.
        InvalidData: faults or a link that can't be.
    """
    table, _, path = read_rig(rig)
    check_arm(table, str(path))
    try:
        listed = [parse_fault(fault) for fault in faults]
    except DriverError as error:
        raise InvalidData(str(error)) from error
    try:
        arm = EmulatedArm(table, table.simulation, MonotonicClock(), seed=seed, faults=listed, link=link)
        arm.start()
    except DriverError as error:
        raise InvalidData(f"{path}: {error}") from error
    try:
        yield arm
    finally:
        arm.close()
