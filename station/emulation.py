"""`station emulate`: a rig's servos on a pseudo-terminal, for any other program to talk to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from drivers.clock import MonotonicClock
from drivers.emulator import parse_fault
from drivers.errors import DriverError
from station.emulated_arm import EmulatedArm
from station.errors import InvalidData
from station.rig_reading import read_rig


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
