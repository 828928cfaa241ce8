"""Packets against the manual's own examples, the SDK's checksum, and their inverse."""

from __future__ import annotations

import pytest
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from drivers.packets import (
    BROADCAST,
    FrameReader,
    Instruction,
    crc16,
    encode,
    encode_instruction,
    encode_status,
    read_status,
    stuff,
    unstuff,
)

# ROBOTIS e-manual, "DYNAMIXEL Protocol 1.0" and "2.0", Instruction Details: each example's packet as printed.
INSTRUCTIONS = {
    "1.0 ping": (1.0, 1, Instruction.PING, "", "FF FF 01 02 01 FB"),
    "1.0 read temperature": (1.0, 1, Instruction.READ, "2B 01", "FF FF 01 04 02 2B 01 CC"),
    "1.0 write id to all": (1.0, BROADCAST, Instruction.WRITE, "03 01", "FF FF FE 04 03 03 01 F6"),
    "1.0 reg write": (1.0, 1, Instruction.REG_WRITE, "1E F4 01", "FF FF 01 05 04 1E F4 01 E2"),
    "1.0 action": (1.0, BROADCAST, Instruction.ACTION, "", "FF FF FE 02 05 FA"),
    "1.0 factory reset": (1.0, 0, Instruction.FACTORY_RESET, "", "FF FF 00 02 06 F7"),
    "1.0 sync write": (
        1.0, BROADCAST, Instruction.SYNC_WRITE, "1E 04 00 10 00 50 01 01 20 02 60 03",
        "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
    ),
    "1.0 bulk read": (
        1.0, BROADCAST, Instruction.BULK_READ, "00 02 01 1E 02 02 24", "FF FF FE 09 92 00 02 01 1E 02 02 24 1D",
    ),
    "2.0 ping": (2.0, 1, Instruction.PING, "", "FF FF FD 00 01 03 00 01 19 4E"),
    "2.0 ping all": (2.0, BROADCAST, Instruction.PING, "", "FF FF FD 00 FE 03 00 01 31 42"),
    "2.0 read": (2.0, 1, Instruction.READ, "84 00 04 00", "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    "2.0 write": (
        2.0, 1, Instruction.WRITE, "74 00 00 02 00 00", "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
    ),
    "2.0 reg write": (
        2.0, 1, Instruction.REG_WRITE, "68 00 C8 00 00 00", "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E",
    ),
    "2.0 action": (2.0, 1, Instruction.ACTION, "", "FF FF FD 00 01 03 00 05 02 CE"),
    "2.0 factory reset": (2.0, 1, Instruction.FACTORY_RESET, "01", "FF FF FD 00 01 04 00 06 01 A1 E6"),
    "2.0 reboot": (2.0, 1, Instruction.REBOOT, "", "FF FF FD 00 01 03 00 08 2F 4E"),
    "2.0 sync read": (
        2.0, BROADCAST, Instruction.SYNC_READ, "84 00 04 00 01 02",
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
    ),
    "2.0 sync write": (
        2.0, BROADCAST, Instruction.SYNC_WRITE, "74 00 04 00 01 96 00 00 00 02 AA 00 00 00",
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
    "2.0 bulk read": (
        2.0, BROADCAST, Instruction.BULK_READ, "01 90 00 02 00 02 92 00 01 00",
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
}  # fmt: skip
STATUSES = {
    "1.0 ping": (1.0, 1, 0, "", "FF FF 01 02 00 FC"),
    "1.0 overload and overheating": (1.0, 1, 0x24, "", "FF FF 01 02 24 D8"),
    "1.0 temperature": (1.0, 1, 0, "20", "FF FF 01 03 00 20 DB"),
    "2.0 ping": (2.0, 1, 0, "06 04 26", "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    "2.0 ping of servo 2": (2.0, 2, 0, "06 04 26", "FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D"),
    "2.0 position": (2.0, 1, 0, "A6 00 00 00", "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    "2.0 position of servo 2": (2.0, 2, 0, "1F 08 00 00", "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"),
    "2.0 write": (2.0, 1, 0, "", "FF FF FD 00 01 04 00 55 00 A1 0C"),
    "2.0 voltage": (2.0, 1, 0, "77 00", "FF FF FD 00 01 06 00 55 00 77 00 C3 69"),
    "2.0 temperature": (2.0, 2, 0, "24", "FF FF FD 00 02 05 00 55 00 24 8B A9"),
}
PROTOCOLS = st.sampled_from([1.0, 2.0])
# Bytes that make headers and stuffing, more often than chance would.
TRICKY = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x01]) | st.integers(0, 255), max_size=40).map(bytes)


@pytest.mark.parametrize("example", INSTRUCTIONS.values(), ids=INSTRUCTIONS.keys())
def test_instructions_are_the_manuals_bytes(example: tuple[float, int, int, str, str]) -> None:
    protocol, servo_id, instruction, parameters, printed = example
    wire = bytes.fromhex(printed)
    assert encode_instruction(servo_id, instruction, bytes.fromhex(parameters), protocol) == wire
    (frame,) = FrameReader(protocol).feed(wire)
    assert (frame.servo_id, frame.body[0], frame.body[1:]) == (servo_id, instruction, bytes.fromhex(parameters))
    assert frame.intact
    assert frame.wire_bytes == len(wire)


@pytest.mark.parametrize("example", STATUSES.values(), ids=STATUSES.keys())
def test_statuses_are_the_manuals_bytes(example: tuple[float, int, int, str, str]) -> None:
    protocol, servo_id, error, parameters, printed = example
    wire = bytes.fromhex(printed)
    assert encode_status(servo_id, error, bytes.fromhex(parameters), protocol) == wire
    (frame,) = FrameReader(protocol).feed(wire)
    assert read_status(frame, protocol) == (servo_id, error, bytes.fromhex(parameters))


@given(st.binary(max_size=60))
def test_crc_is_the_one_that_the_sdk_computes(data: bytes) -> None:
    assert crc16(data) == Protocol2PacketHandler().updateCRC(0, list(data), len(data))


@given(TRICKY)
def test_stuffing_leaves_no_header_and_can_be_undone(body: bytes) -> None:
    stuffed = stuff(body)
    assert unstuff(stuffed) == body
    assert b"\xff\xff\xfd" not in stuffed.replace(b"\xff\xff\xfd\xfd", b"")


@given(
    PROTOCOLS,
    st.lists(st.tuples(st.integers(0, 252), TRICKY.filter(bool)), max_size=4),
    st.integers(1, 7),
)
def test_packets_survive_any_cutting(protocol: float, packets: list[tuple[int, bytes]], step: int) -> None:
    wire = b"".join(encode(servo_id, body, protocol) for servo_id, body in packets)
    reader = FrameReader(protocol)
    frames = [frame for at in range(0, len(wire), step) for frame in reader.feed(wire[at : at + step])]
    assert [(frame.servo_id, frame.body) for frame in frames if frame.intact] == packets


@given(PROTOCOLS, TRICKY.filter(bool), st.integers(0, 10_000), st.integers(1, 255))
def test_a_flipped_byte_is_never_an_intact_packet(protocol: float, body: bytes, at: int, flip: int) -> None:
    wire = bytearray(encode(7, body, protocol))
    wire[at % len(wire)] ^= flip
    frames = FrameReader(protocol).feed(bytes(wire))
    # A shorter frame may be found inside it, as a changed length or header cuts it elsewhere.
    assert all(not frame.intact or frame.wire_bytes < len(wire) for frame in frames)


@given(PROTOCOLS, st.binary(max_size=300))
def test_noise_raises_nothing_and_ends(protocol: float, noise: bytes) -> None:
    FrameReader(protocol).feed(noise)


@pytest.mark.parametrize("protocol", [1.0, 2.0])
def test_a_packet_after_noise_is_found(protocol: float) -> None:
    wire = encode_instruction(3, Instruction.PING, b"", protocol)
    frames = FrameReader(protocol).feed(b"\x00\xff\x12" + wire)
    assert [frame.servo_id for frame in frames if frame.intact] == [3]
