"""The Dynamixel SDK's port and packet handlers with their defects fenced in; `drivers.dynamixel` builds on these."""
# The SDK (dynamixel-sdk 4.1.0) and pyserial have no types: what they hand over is unknown to a type checker.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUntypedBaseClass=false, reportUnknownParameterType=false

from __future__ import annotations

import errno
import os
import select
import termios
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

import serial
from dynamixel_sdk import COMM_RX_CORRUPT, COMM_SUCCESS, PortHandler, Protocol1PacketHandler, Protocol2PacketHandler

from drivers.errors import BusLost, NoPort
from drivers.serial_ports import describe_holders, describe_ports, find_holders

# s. What the SDK allows beside the wire time: two periods of a USB adapter's latency timer (16 ms) and 2 ms.
REPLY_MARGIN_S = 0.034
BITS_PER_BYTE = 10  # e-manual, Protocol: 8 bits, 1 start bit, 1 stop bit, no parity
_READ_BYTES = 4096
_LOST = (OSError, termios.error, serial.SerialException, TypeError)  # TypeError: pyserial, of a port closed meanwhile


@dataclass(frozen=True, slots=True)
class Status:
    """A status packet whose checksum was right.

    Attributes:
        echo: whether it is, byte for byte, what was sent last: in protocol 1.0 instructions look like status packets.
        alone: whether it was received without a byte that belongs to no packet before it.
    """

    servo_id: int
    error: int
    parameters: bytes
    echo: bool = field(default=False, compare=False)
    alone: bool = field(default=True, compare=False)


class FencedPort(PortHandler):
    """The SDK's port: exclusive, monotonic deadlines, waits without spinning, one error when it is lost."""

    def __init__(self, path: str, baud: int, reply_timeout_s: float | None) -> None:
        super().__init__(path)
        self.path = path
        self.baudrate = baud
        self._reply_timeout_s = reply_timeout_s
        self._fd = -1
        self._received = bytearray()
        self.sent = b""  # the last packet that went out
        self._deadline_s = 0.0
        self._expired = True
        self.stale_bytes = 0  # bytes that came when none were expected
        self.taken_bytes = 0  # that the SDK has taken off the line

    # The names of the methods, and that they aren't snake_case, are the SDK's.
    def getCFlagBaud(self, baudrate: int) -> int:
        """Any baud that the system can set: the SDK's own list lacks 200k, 250k and 400k, which the AX has."""
        return baudrate

    def setupPort(self, cflag_baud: int) -> Literal[True]:
        """Open the device for this process alone; raises NoPort."""
        if self.is_open:
            self.closePort()
        try:
            self.ser = serial.Serial(port=self.port_name, baudrate=cflag_baud, timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise NoPort(_why_not_open(self.port_name, cflag_baud, error)) from error
        self._fd = int(self.ser.fileno())  # non-blocking: pyserial opens it so
        self.is_open = True
        self.is_using = False
        self.tx_time_per_byte = 1000.0 / cflag_baud * BITS_PER_BYTE
        self.clearPort()
        return True

    def closePort(self) -> None:
        """Close the device; nothing happens if it is closed already."""
        if self.is_open:
            self.ser.close()
        self.is_open, self._fd = False, -1  # or another file might get the number

    def clearPort(self) -> None:
        """Forget what was received: it answers no question that is still open."""
        stale = len(self._received)
        self._received.clear()
        try:
            stale += len(os.read(self._fd, _READ_BYTES)) if self.is_open else 0
        except BlockingIOError:
            pass
        except _LOST as error:
            raise self._lost() from error
        self.stale_bytes += stale

    def writePort(self, packet: list[int]) -> int:
        """Send the bytes of a packet."""
        self.sent = bytes(packet)
        written = 0
        try:
            while written < len(self.sent):  # once, but where the system's buffer is full; pyserial waits each time
                try:
                    written += os.write(self._fd, self.sent[written:])
                except BlockingIOError:
                    select.select([], [self._fd], [])
        except _LOST as error:
            raise self._lost() from error
        return written

    def readPort(self, length: int) -> bytes:
        """At most `length` bytes; waits for some until the deadline."""
        if length <= 0:  # the SDK asks for -1 bytes when a packet is shorter than the shortest that there is
            return b""
        if len(self._received) < length and not self._expired:
            self._receive()
        chunk = bytes(self._received[:length])
        del self._received[:length]
        self.taken_bytes += len(chunk)
        return chunk

    def setPacketTimeout(self, packet_length: int) -> None:
        """Start waiting for a reply of this many bytes."""
        wire_s = (len(self.sent) + packet_length) * self.tx_time_per_byte / 1000
        wait_s = REPLY_MARGIN_S + wire_s if self._reply_timeout_s is None else self._reply_timeout_s
        self._deadline_s = time.monotonic() + wait_s
        self._expired = False

    def setPacketTimeoutMillis(self, msec: float) -> None:
        """Start waiting for this long."""
        self._deadline_s = time.monotonic() + msec / 1000
        self._expired = False

    def isPacketTimeout(self) -> bool:
        """Whether the deadline has passed, and all that had come by then has been read."""
        return self._expired

    def _receive(self) -> None:
        """Wait for bytes until the deadline; past it, take what is there, once: this process may have been stopped."""
        wait_s = self._deadline_s - time.monotonic()
        try:
            ready, _, _ = select.select([self._fd], [], [], max(0.0, wait_s))
            data = os.read(self._fd, _READ_BYTES) if ready else b""
        except BlockingIOError:
            return
        except (*_LOST, ValueError) as error:
            raise self._lost() from error
        if ready and not data:  # the other end hung up
            raise self._lost()
        self._received += data
        self._expired = not ready or wait_s <= 0

    def _lost(self) -> BusLost:
        return BusLost(f"{self.port_name} is gone: unplugged, or closed at the other end; plug it in and reconnect")


def _why_not_open(path: str, baud: int, error: Exception) -> str:
    """A message that says what keeps the port from being opened."""
    number = getattr(error, "errno", None)
    if number == errno.ENOENT or not Path(path).exists():
        return f"no port {path}; check 'port' in rig.toml; {describe_ports()}"
    if number == errno.EACCES:
        return f"no permission for {path}; add yourself to its group (sudo usermod -aG dialout $USER), log in again"
    if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY):
        holders = describe_holders(find_holders(path))
        return f"{path} is held by {holders or 'another program'}; close that first"
    if isinstance(error, ValueError):
        return f"{path} can't be set to {baud} baud: {error}; check 'baud' in rig.toml"
    return f"{path} can't be opened as a serial port: {error}"


class FencedProtocol1(Protocol1PacketHandler):
    """The SDK's protocol 1.0 with whole status packets."""

    def receive(self, port: FencedPort) -> tuple[Status | None, int]:
        """The next status packet and the SDK's result code; None where the code is none of success."""
        before = port.taken_bytes
        packet, result = cast("tuple[list[int], int]", self.rxPacket(port))
        if result != COMM_SUCCESS:
            return None, result
        if packet[3] < 2:  # LENGTH counts error and checksum
            return None, COMM_RX_CORRUPT
        parameters = bytes(packet[5 : packet[3] + 3])
        alone = port.taken_bytes - before == packet[3] + 4
        return Status(packet[2], packet[4], parameters, bytes(packet) == port.sent, alone), result


class FencedProtocol2(Protocol2PacketHandler):
    """The SDK's protocol 2.0 with byte stuffing that works both ways and whole status packets."""

    _wire_bytes = 0  # of the packet that was received last, stuffed

    def addStuffing(self, packet: list[int]) -> list[int]:
        """Stuff the packet in place: the SDK's caller ignores what is returned, so that it sends FF FF FD raw."""
        end = 5 + packet[5] + 256 * packet[6]  # from instruction to last parameter
        body = bytes(packet[7:end]).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet[5:7] = (len(body) + 2).to_bytes(2, "little")
        packet[7:] = [*body, 0, 0]  # the checksum is filled in by the caller
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        """Undo stuffing: the SDK's own looks back at bytes that it has moved already, and loses some."""
        end = 5 + packet[5] + 256 * packet[6]
        self._wire_bytes = end + 2
        body = bytes(packet[7:end]).replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        packet[5:7] = (len(body) + 2).to_bytes(2, "little")
        packet[7:] = [*body, *packet[end : end + 2]]
        return packet

    def receive(self, port: FencedPort) -> tuple[Status | None, int]:
        """The next status packet and the SDK's result code; None where the code is none of success."""
        before = port.taken_bytes
        packet, result = cast("tuple[list[int], int]", self.rxPacket(port, False))
        if result != COMM_SUCCESS:
            return None, result
        length = packet[5] + 256 * packet[6]
        if length < 4:  # instruction, error, checksum
            return None, COMM_RX_CORRUPT
        alone = port.taken_bytes - before == self._wire_bytes
        return Status(packet[4], packet[8], bytes(packet[9 : 5 + length]), alone=alone), result


def make_handler(protocol: float) -> Any:
    """The fenced packet handler of a protocol, untyped as the SDK is."""
    return FencedProtocol1() if protocol == 1.0 else FencedProtocol2()
