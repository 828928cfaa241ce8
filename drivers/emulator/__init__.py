"""A servo bus without hardware, for any client: `EmulatedBus([EmulatedServo(1, "AX-18A")], ...)`; docs/emulator.md."""

from drivers.emulator.bus import EmulatedBus
from drivers.emulator.faults import Fault, format_fault, parse_fault
from drivers.emulator.servo import EmulatedServo

__all__ = ["EmulatedBus", "EmulatedServo", "Fault", "format_fault", "parse_fault"]
