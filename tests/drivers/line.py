"""A client of the emulated bus that sends packets and collects what comes back, byte by byte or as status packets."""

from __future__ import annotations

import select

import dynamixel_sdk as sdk
import serial

from drivers.emulator import EmulatedBus
from drivers.packets import FrameReader, Status, encode_instruction, read_status

SILENCE_S = 0.05  # how long a reply is waited for that must not come
PATIENCE_S = 5.0  # for replies that come


class PatientPort(sdk.PortHandler):
    """The SDK's port, whose 34 ms for a reply a machine with other work to do can miss."""

    def setPacketTimeout(self, packet_length: int) -> None:
        self.setPacketTimeoutMillis(1000 * PATIENCE_S)


class Line:
    """A serial line to the bus, at one baud, with one protocol at a time."""

    def __init__(self, bus: EmulatedBus, protocol: float, baud: int = 1_000_000) -> None:
        self.serial = serial.Serial(bus.path, baud, timeout=0)
        self.speak(protocol)

    def speak(self, protocol: float) -> None:
        """Go over to a protocol."""
        self.protocol = protocol
        self.reader = FrameReader(protocol)

    def ask(self, servo_id: int, instruction: int, parameters: str = "", *, replies: int = 1) -> list[Status]:
        return self.send(encode_instruction(servo_id, instruction, bytes.fromhex(parameters), self.protocol), replies)

    def send(self, wire: bytes, replies: int) -> list[Status]:
        self.serial.write(wire)
        found: list[Status] = []
        while len(found) < max(1, replies):
            if not select.select([self.serial], [], [], PATIENCE_S if replies else SILENCE_S)[0]:
                break
            for frame in self.reader.feed(self.serial.read(4096)):
                status = read_status(frame, self.protocol)
                assert status is not None
                found.append(status)
        return found

    def raw(self, servo_id: int, instruction: int, parameters: str = "", *, size: int = 1) -> bytes:
        """The bytes that come back: `size` of them, and what comes until there is silence."""
        self.serial.write(encode_instruction(servo_id, instruction, bytes.fromhex(parameters), self.protocol))
        found = b""
        while select.select([self.serial], [], [], PATIENCE_S if len(found) < size else SILENCE_S)[0]:
            found += self.serial.read(4096)
        return found

    def hears_nothing(self, servo_id: int, instruction: int, parameters: str = "") -> bool:
        """Whether no byte comes back."""
        return self.raw(servo_id, instruction, parameters, size=0) == b""

    def close(self) -> None:
        self.serial.close()
