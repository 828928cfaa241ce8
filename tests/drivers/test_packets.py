"""Packets against the manual's own examples, the SDK's bytes, and their inverse; what a stream's reader guarantees."""

from __future__ import annotations

import itertools
import os
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import dynamixel_sdk as sdk
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.packets import (
    BROADCAST,
    Frame,
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
from tests.benchmarks.packet_fuzz import TRICKY, scan

# ROBOTIS e-manual, "DYNAMIXEL Protocol 1.0" and "2.0" (docs/en/dxl/protocol1.md, protocol2.md of its repository),
# Instruction Details: each example's packet as printed, but for two checksums; see MISPRINTS.
INSTRUCTIONS = {
    "1.0 checksum": (1.0, 1, Instruction.WRITE, "0C 64 AA", "FF FF 01 05 03 0C 64 AA DC"),
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
    "2.0 clear": (2.0, 1, Instruction.CLEAR, "01 44 58 4C 22", "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC"),
    "2.0 backup": (
        2.0, 1, Instruction.BACKUP, "01 43 54 52 4C", "FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5",
    ),
    "2.0 restore": (
        2.0, 1, Instruction.BACKUP, "02 43 54 52 4C", "FF FF FD 00 01 08 00 20 02 43 54 52 4C 9E F5",
    ),
    "2.0 fast sync read": (
        2.0, BROADCAST, Instruction.FAST_SYNC_READ, "84 00 04 00 03 07 04",
        "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2",
    ),
    "2.0 bulk write": (
        2.0, BROADCAST, Instruction.BULK_WRITE, "01 20 00 02 00 A0 00 02 1F 00 01 00 50",
        "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68",
    ),
    "2.0 fast bulk read": (
        2.0, BROADCAST, Instruction.FAST_BULK_READ, "03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00",
        "FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 DA 2D",
    ),
}  # fmt: skip
# Checksums that the manual prints and no CRC of its bytes gives; the first is that of its example of a fast sync read.
MISPRINTS = {"2.0 fast bulk read": "20 F2", "2.0 restore": "92 F5"}
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
    "1.0 factory reset": (1.0, 0, 0, "", "FF FF 00 02 00 FD"),
    "1.0 bulk read": (1.0, 1, 0, "00 80", "FF FF 01 04 00 00 80 7A"),
    "1.0 bulk read of servo 2": (1.0, 2, 0, "00 80", "FF FF 02 04 00 00 80 79"),
}
# The one status packet of a fast sync read and a fast bulk read, as the three servos send its parts.
FAST_STATUSES = {
    "fast sync read": (
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08", "00 07 1F 08 00 00 16 CA", "00 04 FF 03 00 00 D1 9E",
    ),
    "fast bulk read": ("FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4", "00 07 A5 01 24 74", "00 04 1F D9 C1"),
}  # fmt: skip
BOTH = pytest.mark.parametrize("protocol", [1.0, 2.0])
PROTOCOLS = st.sampled_from([1.0, 2.0])
IDS = st.integers(0, 252) | st.just(BROADCAST)
# Bytes that make headers and stuffing, more often than chance would.
TRICKY_BODY = st.lists(st.sampled_from(TRICKY) | st.integers(0, 255), min_size=1, max_size=40).map(bytes)
LONGEST_BODY = {1.0: 254, 2.0: 1022}  # what LENGTH, one byte or at most 1024, leaves for it; stuffed
LONGEST_PACKET = {1.0: 4 + 255, 2.0: 7 + 1024}


@contextmanager
def line() -> Iterator[tuple[sdk.PortHandler, int]]:
    """The SDK's port on one end of a pseudo-terminal, and the descriptor of the other."""
    far, near = os.openpty()
    tty.setraw(near)
    port = sdk.PortHandler(os.ttyname(near))
    port.openPort()
    try:
        yield port, far
    finally:
        port.closePort()
        os.close(far)
        os.close(near)


# What the SDK is to be told for each of INSTRUCTIONS; None: it has no call for it, and is given the packet without
# headers and checksum.
SDK_CALLS: dict[str, Callable[[Any, sdk.PortHandler], object] | None] = {
    "1.0 checksum": lambda handler, port: handler.writeTxOnly(port, 1, 12, 2, [100, 170]),
    "1.0 ping": lambda handler, port: handler.ping(port, 1),
    "1.0 read temperature": lambda handler, port: handler.readTx(port, 1, 43, 1),
    "1.0 write id to all": lambda handler, port: handler.writeTxOnly(port, 254, 3, 1, [1]),
    "1.0 reg write": lambda handler, port: handler.regWriteTxOnly(port, 1, 30, 2, [0xF4, 0x01]),
    "1.0 action": lambda handler, port: handler.action(port, 254),
    "1.0 factory reset": lambda handler, port: handler.factoryReset(port, 0),
    "1.0 sync write": lambda handler, port: handler.syncWriteTxOnly(
        port, 30, 4, [0, 0x10, 0, 0x50, 1, 1, 0x20, 2, 0x60, 3], 10
    ),
    "1.0 bulk read": lambda handler, port: handler.bulkReadTx(port, [2, 1, 30, 2, 2, 36], 6),
    "2.0 ping": lambda handler, port: handler.ping(port, 1),
    "2.0 ping all": None,
    "2.0 read": lambda handler, port: handler.readTx(port, 1, 132, 4),
    "2.0 write": lambda handler, port: handler.writeTxOnly(port, 1, 116, 4, [0, 2, 0, 0]),
    "2.0 reg write": lambda handler, port: handler.regWriteTxOnly(port, 1, 104, 4, [200, 0, 0, 0]),
    "2.0 action": lambda handler, port: handler.action(port, 1),
    "2.0 factory reset": lambda handler, port: handler.factoryReset(port, 1, 1),
    "2.0 reboot": lambda handler, port: handler.reboot(port, 1),
    "2.0 clear": lambda handler, port: handler.clearMultiTurn(port, 1),
    "2.0 backup": None,
    "2.0 restore": None,
    "2.0 sync read": lambda handler, port: handler.syncReadTx(port, 132, 4, [1, 2], 2, False),
    "2.0 fast sync read": lambda handler, port: handler.syncReadTx(port, 132, 4, [3, 7, 4], 3, True),
    "2.0 sync write": lambda handler, port: handler.syncWriteTxOnly(
        port, 116, 4, [1, 150, 0, 0, 0, 2, 170, 0, 0, 0], 10
    ),
    "2.0 bulk read": lambda handler, port: handler.bulkReadTx(port, [1, 144, 0, 2, 0, 2, 146, 0, 1, 0], 10, False),
    "2.0 fast bulk read": lambda handler, port: handler.bulkReadTx(
        port, [3, 132, 0, 4, 0, 7, 124, 0, 2, 0, 4, 146, 0, 1, 0], 15, True
    ),
    "2.0 bulk write": lambda handler, port: handler.bulkWriteTxOnly(
        port, [1, 32, 0, 2, 0, 160, 0, 2, 31, 0, 1, 0, 80], 13
    ),
}


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


@pytest.mark.parametrize("name", INSTRUCTIONS)
def test_instructions_are_the_bytes_that_the_sdk_sends(name: str) -> None:
    protocol, _, _, _, printed = INSTRUCTIONS[name]
    wire = bytes.fromhex(printed)
    handler = sdk.PacketHandler(protocol)
    with line() as (port, far):
        if (call := SDK_CALLS[name]) is not None:
            call(handler, port)
        else:
            handler.txPacket(port, [0, 0, 0, 0, *wire[4:-2], 0, 0])
        assert os.read(far, 1000) == wire


@pytest.mark.parametrize(("name", "printed"), MISPRINTS.items())
def test_the_checksums_that_the_manual_misprints_are_wrong(name: str, printed: str) -> None:
    wire = bytes.fromhex(INSTRUCTIONS[name][-1])[:-2] + bytes.fromhex(printed)
    assert [frame.intact for frame in FrameReader(2.0).feed(wire)] == [False]


@pytest.mark.parametrize("parts", FAST_STATUSES.values(), ids=FAST_STATUSES.keys())
def test_a_fast_status_is_one_packet_whose_checksums_are_of_all_before_them(parts: tuple[str, ...]) -> None:
    sent = [bytes.fromhex(part) for part in parts]
    for whole in itertools.accumulate(sent):
        assert whole[-2:] == crc16(whole[:-2]).to_bytes(2, "little")
    (frame,) = FrameReader(2.0).feed(b"".join(sent))
    assert frame == Frame(BROADCAST, frame.body, True, sum(map(len, sent)))
    assert read_status(frame, 2.0) == (BROADCAST, 0, b"".join([sent[0][9:], *sent[1:]])[:-2])


def test_a_header_in_the_data_is_stuffed_as_the_manual_says() -> None:
    # e-manual 2.0, Packet Process: FF FF FD becomes FF FF FD FD, from instruction to last parameter; then the length,
    # then the checksum, are of what came of it.
    wire = encode_instruction(1, Instruction.WRITE, bytes.fromhex("68 00 FF FF FD 00"), 2.0)
    assert wire[:-2] == bytes.fromhex("FF FF FD 00 01 0A 00 03 68 00 FF FF FD FD 00")
    assert int.from_bytes(wire[-2:], "little") == sdk.PacketHandler(2.0).updateCRC(0, list(wire), len(wire) - 2)


@given(st.binary(max_size=60))
def test_crc_is_the_one_that_the_sdk_computes(data: bytes) -> None:
    assert crc16(data) == sdk.Protocol2PacketHandler().updateCRC(0, list(data), len(data))


@given(TRICKY_BODY)
def test_stuffing_leaves_no_header_and_can_be_undone(body: bytes) -> None:
    stuffed = stuff(body)
    assert unstuff(stuffed) == body
    assert b"\xff\xff\xfd" not in stuffed.replace(b"\xff\xff\xfd\xfd", b"")


@given(PROTOCOLS, IDS, TRICKY_BODY | st.binary(min_size=1, max_size=254))
def test_any_body_comes_back_from_the_wire(protocol: float, servo_id: int, body: bytes) -> None:
    wire = encode(servo_id, body, protocol)
    assert FrameReader(protocol).feed(wire) == [Frame(servo_id, body, True, len(wire))]


@given(PROTOCOLS, IDS, st.integers(0, 255), TRICKY_BODY | st.just(b""))
def test_any_status_comes_back_from_the_wire(protocol: float, servo_id: int, error: int, parameters: bytes) -> None:
    (frame,) = FrameReader(protocol).feed(encode_status(servo_id, error, parameters, protocol))
    assert read_status(frame, protocol) == (servo_id, error, parameters)


@given(IDS, st.sampled_from(Instruction), TRICKY_BODY)
def test_an_instruction_of_protocol_2_is_no_status(servo_id: int, instruction: Instruction, data: bytes) -> None:
    (frame,) = FrameReader(2.0).feed(encode_instruction(servo_id, instruction, data, 2.0))
    assert read_status(frame, 2.0) is None


@BOTH
def test_what_is_too_long_for_a_packet_is_an_error(protocol: float) -> None:
    longest = LONGEST_BODY[protocol]
    (frame,) = FrameReader(protocol).feed(encode(1, bytes(longest), protocol))
    assert (len(frame.body), frame.wire_bytes) == (longest, LONGEST_PACKET[protocol])
    with pytest.raises(DriverError, match=rf"servo 1: {longest + 1} B .* at most {longest} B"):
        encode(1, bytes(longest + 1), protocol)
    if protocol == 2.0:  # 766 bytes, but 1021 with stuffing; 3 more are 4 more
        assert FrameReader(2.0).feed(encode(1, b"\0" + b"\xff\xff\xfd" * 255, 2.0))
        with pytest.raises(DriverError, match="with stuffing"):
            encode(1, b"\0" + b"\xff\xff\xfd" * 256, 2.0)


def pieces(draw: st.DrawFn, protocol: float) -> list[bytes]:
    """Packets, packets with a change, headers that promise what doesn't come, and noise."""
    packet = st.builds(encode, IDS, TRICKY_BODY, st.just(protocol))

    def damaged(wire: bytes) -> bytes:
        at = draw(st.integers(0, len(wire) - 1))
        return wire[:at] + draw(st.binary(max_size=2)) + wire[at + 1 :]

    header = b"\xff\xff" if protocol == 1.0 else b"\xff\xff\xfd\x00"
    return draw(
        st.lists(packet | packet.map(damaged) | TRICKY_BODY | TRICKY_BODY.map(lambda d: header + d), max_size=8)
    )


@st.composite
def streams(draw: st.DrawFn) -> tuple[float, bytes]:
    """A protocol, and anything that may be on its wire."""
    protocol = draw(PROTOCOLS)
    return protocol, b"".join(pieces(draw, protocol))


@given(streams(), st.data())
def test_any_cutting_of_any_stream_gives_the_same_frames(stream: tuple[float, bytes], data: st.DataObject) -> None:
    protocol, wire = stream
    cuts = sorted(data.draw(st.lists(st.integers(0, len(wire)), max_size=20)))
    reader = FrameReader(protocol)
    frames = [
        frame for start, end in itertools.pairwise([0, *cuts, len(wire)]) for frame in reader.feed(wire[start:end])
    ]
    assert frames == FrameReader(protocol).feed(wire)


@given(streams())
def test_frames_are_those_of_a_plain_scan(stream: tuple[float, bytes]) -> None:
    protocol, wire = stream
    found = [(frame.wire_bytes, frame.intact) for frame in FrameReader(protocol).feed(wire)]
    assert found == [(packet.size, packet.intact) for packet in scan(wire, protocol)]


@given(streams(), IDS, TRICKY_BODY, st.sampled_from([1, 7, 5000]))
def test_a_packet_after_anything_is_found_unless_an_intact_one_runs_into_it(
    stream: tuple[float, bytes], servo_id: int, body: bytes, step: int
) -> None:
    # A false header's length may swallow what follows, but only until the longest packet would be over; nothing is
    # lost by it, as the search goes on a byte after a header whose checksum is wrong.
    protocol, before = stream
    packet = encode(servo_id, body, protocol)
    wire = before + packet + bytes(LONGEST_PACKET[protocol])
    reader = FrameReader(protocol)
    frames = [frame for at in range(0, len(wire), step) for frame in reader.feed(wire[at : at + step])]
    run_into = any(f.intact and f.at < len(before) < f.at + f.size for f in scan(wire, protocol))
    assert run_into or Frame(servo_id, body, True, len(packet)) in frames


@given(PROTOCOLS, st.data())
def test_packets_between_bytes_that_are_no_header_are_found_at_once(protocol: float, data: st.DataObject) -> None:
    header = b"\xff\xff" if protocol == 1.0 else b"\xff\xff\xfd"
    noise = TRICKY_BODY.map(lambda noise: noise.replace(header, b"")).filter(lambda noise: header not in noise)
    reader = FrameReader(protocol)
    for servo_id, body in data.draw(st.lists(st.tuples(IDS, TRICKY_BODY), max_size=4)):
        wire = encode(servo_id, body, protocol)
        assert reader.feed(data.draw(noise) + wire) == [Frame(servo_id, body, True, len(wire))]


@BOTH
@pytest.mark.parametrize("body", ["55 00 A6 00 00 00", "55 00 FF FF FD 00 FF FF FD", "02 2B 01", "01"])
def test_a_changed_byte_is_never_an_intact_packet_of_that_length(protocol: float, body: str) -> None:
    wire = encode(7, bytes.fromhex(body), protocol)
    for at, flip in itertools.product(range(len(wire)), range(1, 256)):
        changed = bytearray(wire)
        changed[at] ^= flip
        frames = FrameReader(protocol).feed(bytes(changed))
        # A changed length or header may cut a shorter packet out of it, whose checksum is right by chance: of one in
        # 256 in protocol 1.0, one in 65536 in 2.0. Who asks for so many bytes doesn't take it for the answer.
        assert all(not frame.intact or frame.wire_bytes < len(wire) for frame in frames)


@given(PROTOCOLS, TRICKY_BODY, st.integers(0, 10_000), st.integers(1, 0xFFFF))
def test_two_bytes_changed_side_by_side_are_no_intact_packet(protocol: float, body: bytes, at: int, flip: int) -> None:
    # CRC-16 tells every burst of up to 16 bits; the sum of protocol 1.0 doesn't: one more and one less is the same.
    wire = bytearray(encode(7, body, protocol))
    at %= len(wire) - 1
    wire[at] ^= flip >> 8
    wire[at + 1] ^= flip & 0xFF
    same_sum = sum(wire[2:]) % 256 == 0xFF
    frames = FrameReader(protocol).feed(bytes(wire))
    assert all(not f.intact or f.wire_bytes < len(wire) or (protocol == 1.0 and same_sum) for f in frames)


@given(streams())
def test_the_reader_keeps_no_more_than_a_packet(stream: tuple[float, bytes]) -> None:
    protocol, wire = stream
    reader = FrameReader(protocol)
    for byte in wire:
        reader.feed(bytes((byte,)))
        assert len(reader._buffer) < LONGEST_PACKET[protocol]


@BOTH
def test_a_packet_begun_can_be_forgotten(protocol: float) -> None:
    wire = encode_instruction(3, Instruction.PING, b"", protocol)
    reader = FrameReader(protocol)
    assert reader.feed(wire[:-1]) == []
    reader.clear()
    assert [frame.servo_id for frame in reader.feed(wire)] == [3]
