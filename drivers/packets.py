"""Codec of Dynamixel packets, protocols 1.0 and 2.0: bytes to frames and back, checksums and byte stuffing included.

Written from the e-manual (ROBOTIS, "DYNAMIXEL Protocol 1.0" and "2.0"), apart from the SDK: each tests the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from drivers.errors import DriverError

BROADCAST = 0xFE  # e-manual, Packet ID: all devices execute, none of them answers (but for ping and group reads)
MAX_ID = 0xFC
_STATUS = 0x55  # protocol 2.0, Instruction of a status packet
_HEADER_1 = b"\xff\xff"
_HEADER_2 = b"\xff\xff\xfd"
_HEADER_2_FULL = b"\xff\xff\xfd\x00"
_LONGEST_BODY_1 = 254  # LENGTH is one byte and counts the checksum
# What LENGTH may count, two bytes of checksum included. Our own: the manual names no limit, the SDK takes no more, no
# control table is that long; a false header's length may keep the packets after it waiting for no longer than this.
_MAX_LENGTH_2 = 1024


class Instruction(IntEnum):
    """Instruction codes; CLEAR, BACKUP, the sync and fast reads and BULK_WRITE: protocol 2.0 only."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    BACKUP = 0x20
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


@dataclass(frozen=True, slots=True)
class Frame:
    """One packet off the wire.

    Attributes:
        servo_id: whom it is for, or from.
        body: instruction and parameters; of a protocol 1.0 status packet, error and parameters; of a protocol 2.0
            status packet, 0x55, error and parameters. Byte stuffing is removed.
        intact: whether the checksum was right.
        wire_bytes: its length on the wire.
    """

    servo_id: int
    body: bytes
    intact: bool
    wire_bytes: int


class Status(NamedTuple):
    """What a status packet says."""

    servo_id: int
    error: int
    parameters: bytes


def _crc_table() -> tuple[int, ...]:
    """CRC-16 of polynomial x^16 + x^15 + x^2 + 1, 0x8005, not reflected (e-manual, CRC Calculation)."""
    table: list[int] = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """The protocol 2.0 checksum of `data`, from header to last parameter."""
    crc = 0
    for byte in data:  # a byte depends on the one before it: no vector form
        crc = (crc << 8 ^ _CRC_TABLE[(crc >> 8 ^ byte) & 0xFF]) & 0xFFFF
    return crc


def checksum(data: bytes) -> int:
    """The protocol 1.0 checksum of `data`, from ID to last parameter."""
    return ~sum(data) & 0xFF


def stuff(body: bytes) -> bytes:
    """Add 0xFD after each FF FF FD, so that no header appears in a packet (e-manual 2.0, Packet Process)."""
    return body.replace(_HEADER_2, _HEADER_2 + b"\xfd")


def unstuff(body: bytes) -> bytes:
    """Undo `stuff`."""
    return body.replace(_HEADER_2 + b"\xfd", _HEADER_2)


def encode(servo_id: int, body: bytes, protocol: float) -> bytes:
    """The bytes on the wire of a packet with this `body` (see Frame); raises DriverError for one that is too long."""
    if protocol == 1.0:
        if len(body) > _LONGEST_BODY_1:
            raise DriverError(
                f"servo {servo_id}: {len(body)} B in a packet of protocol 1.0; at most {_LONGEST_BODY_1} B"
            )
        inner = bytes((servo_id, len(body) + 1)) + body
        return _HEADER_1 + inner + bytes((checksum(inner),))
    stuffed = stuff(body)
    if len(stuffed) > _MAX_LENGTH_2 - 2:
        raise DriverError(
            f"servo {servo_id}: {len(stuffed)} B (with stuffing) in a packet of protocol 2.0; "
            f"at most {_MAX_LENGTH_2 - 2} B; ask for less at once"
        )
    packet = _HEADER_2_FULL + bytes((servo_id,)) + (len(stuffed) + 2).to_bytes(2, "little") + stuffed
    return packet + crc16(packet).to_bytes(2, "little")


def encode_instruction(servo_id: int, instruction: int, parameters: bytes, protocol: float) -> bytes:
    """An instruction packet."""
    return encode(servo_id, bytes((instruction,)) + parameters, protocol)


def encode_status(servo_id: int, error: int, parameters: bytes, protocol: float) -> bytes:
    """A status packet."""
    start = bytes((error,)) if protocol == 1.0 else bytes((_STATUS, error))
    return encode(servo_id, start + parameters, protocol)


def read_status(frame: Frame, protocol: float) -> Status | None:
    """The frame as a status packet; None if it isn't an intact one."""
    body = frame.body if protocol == 1.0 else frame.body[1:]
    if not frame.intact or not body or (protocol == 2.0 and frame.body[0] != _STATUS):
        return None
    return Status(frame.servo_id, body[0], body[1:])


class FrameReader:
    """Cuts a stream of bytes into frames, skipping what is no packet.

    The frames don't depend on how the stream is cut. Every intact packet is found, unless an intact one before it runs
    into it (noise that has a right checksum by chance). It is found at once after bytes that hold no header; behind a
    false header, whose length promises more than there is, it is found as soon as so many bytes have come, 259 at most
    in protocol 1.0, 1031 in 2.0. `clear` gives up waiting for them.
    """

    def __init__(self, protocol: float) -> None:
        self._take = _take_1 if protocol == 1.0 else _take_2
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Sequence[Frame]:
        """The frames that `data` completes, in order; the rest is kept for the next call."""
        self._buffer += data
        frames: list[Frame] = []
        while (frame := self._take(self._buffer)) is not None:
            frames.append(frame)
        return frames

    def clear(self) -> None:
        """Forget a packet begun but not completed."""
        self._buffer.clear()


def _skip_to(buffer: bytearray, header: bytes) -> None:
    """Drop what precedes the header; keep a header's beginning at the end of the buffer."""
    at = buffer.find(header)
    if at >= 0:
        del buffer[:at]
        return
    keep = next((n for n in range(len(header) - 1, 0, -1) if buffer.endswith(header[:n])), 0)
    del buffer[: len(buffer) - keep]


def _take_1(buffer: bytearray) -> Frame | None:
    while True:
        _skip_to(buffer, _HEADER_1)
        if len(buffer) < 4:
            return None
        servo_id, length = buffer[2], buffer[3]
        if servo_id > BROADCAST or length < 2:  # FF FF FF: the header may begin a byte later
            del buffer[:1]
            continue
        size = 4 + length
        if len(buffer) < size:
            return None
        packet = bytes(buffer[:size])
        intact = checksum(packet[2:-1]) == packet[-1]
        # A wrong checksum may mean a false header: what follows is searched again, from the next byte.
        del buffer[: size if intact else 1]
        return Frame(servo_id, packet[4:-1], intact, size)


def _take_2(buffer: bytearray) -> Frame | None:
    while True:
        _skip_to(buffer, _HEADER_2)
        if len(buffer) < 7:
            return None
        servo_id, length = buffer[4], int.from_bytes(buffer[5:7], "little")
        if buffer[3] != 0 or servo_id in (0xFD, 0xFF) or not 3 <= length <= _MAX_LENGTH_2:
            del buffer[:1]
            continue
        size = 7 + length
        if len(buffer) < size:
            return None
        packet = bytes(buffer[:size])
        intact = crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
        del buffer[: size if intact else 1]
        return Frame(servo_id, unstuff(packet[7:-2]), intact, size)
