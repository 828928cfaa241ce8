"""Random and mutated byte strings: through the parsers, through the driver's receiving path, at the emulated bus."""

from __future__ import annotations

import os
import select
import time
from random import Random

import pytest
import serial
from dynamixel_sdk import COMM_RX_CORRUPT
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import VirtualClock
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.emulator.bus import PACKET_TIMEOUT_S
from drivers.packets import BROADCAST, FrameReader, Instruction, encode, encode_instruction, encode_status, read_status
from drivers.sdk_fence import Status, make_handler
from tests.benchmarks import packet_fuzz
from tests.benchmarks.packet_fuzz import TRICKY, TimedBytes

STRINGS = 4000
BABBLE = 10_000  # strings that the emulated bus is sent: of the order of a second
ANSWER_S = 5.0  # an answer takes microseconds; a stalled machine must not fail the test
BAUD = 1_000_000
BOTH = pytest.mark.parametrize("protocol", [1.0, 2.0])


def test_no_string_breaks_a_parser_holds_it_up_or_makes_it_see_what_is_not_there() -> None:
    tallies = packet_fuzz.fuzz((1, STRINGS))
    for name, tally in tallies.items():
        assert (name, tally.strings, tally.example) == (name, STRINGS, "")
        assert tally.intact > STRINGS / 20, "strings too broken to tell anything"


def statuses(protocol: float) -> st.SearchStrategy[Status]:
    """What a servo may send: no id over 252, no error bit 7 in protocol 1.0."""
    error = st.integers(0, 0x7F if protocol == 1.0 else 0xFF)
    return st.builds(Status, st.integers(0, 252), error, st.lists(st.sampled_from(TRICKY), max_size=30).map(bytes))


@BOTH
@given(data=st.data())
def test_the_receiving_path_and_the_reader_find_the_same_in_packets_with_noise_between(
    protocol: float, data: st.DataObject
) -> None:
    header = b"\xff\xff" if protocol == 1.0 else b"\xff\xff\xfd"
    noise = st.lists(st.sampled_from(TRICKY) | st.integers(0, 255), max_size=20).map(bytes)
    sent = data.draw(st.lists(statuses(protocol), max_size=4))
    wire = b""
    for status in sent:
        wire += data.draw(noise.map(lambda noise: noise.replace(header, b"")).filter(lambda noise: header not in noise))
        wire += encode_status(status.servo_id, status.error, status.parameters, protocol)
    frames = [read_status(frame, protocol) for frame in FrameReader(protocol).feed(wire)]
    assert [Status(*found) for found in frames if found is not None] == sent
    assert packet_fuzz.received(wire, protocol, data.draw(st.sampled_from([1, 3, 16, 4096]))) == sent


@BOTH
def test_a_packet_too_short_for_a_status_is_damaged(protocol: float) -> None:
    # LENGTH 0 and up, each with every byte that could pass for its checksum, and bytes after it: the SDK takes some.
    if protocol == 1.0:
        wires = [bytes((0xFF, 0xFF, 1, length, check, check, 0)) for length in (0, 1) for check in range(256)]
    else:
        whole = encode(1, b"\x55", 2.0)
        wires = [
            whole + bytes(8),
            *(bytes((0xFF, 0xFF, 0xFD, 0, id, n, 0, 0x55)) + bytes(8) for id in range(253) for n in range(4)),
        ]
    for wire in wires:
        status, result = make_handler(protocol).receive(TimedBytes(wire, 4096))
        assert (status, result) == (None, COMM_RX_CORRUPT)


class Babbler:
    """A client of an emulated bus that sends what it likes and reads what comes."""

    def __init__(self, bus: EmulatedBus) -> None:
        self.port = serial.Serial(bus.path, BAUD, timeout=0, write_timeout=ANSWER_S)

    def babble(self, rng: Random) -> None:
        """Send BABBLE strings, as fast as the bus takes them."""
        for _ in range(BABBLE):
            self.port.write(rng.choice((packet_fuzz.noise, packet_fuzz.mixed, packet_fuzz.mutated))(rng))
            self.port.read(4096)

    def answers(self, servo_ids: set[int], protocol: float) -> bool:
        """Whether one of the servos answers a ping, after all that is on the line has passed."""
        time.sleep(3 * PACKET_TIMEOUT_S)  # a packet that has begun is forgotten
        self.port.reset_input_buffer()
        reader = FrameReader(protocol)
        self.port.write(b"".join(encode_instruction(id, Instruction.PING, b"", protocol) for id in servo_ids))
        while select.select([self.port], [], [], ANSWER_S)[0]:
            found = (read_status(frame, protocol) for frame in reader.feed(os.read(self.port.fileno(), 4096)))
            if any(status is not None and status.servo_id in servo_ids for status in found):
                return True
        return False


@BOTH
@pytest.mark.parametrize("seed", [1, 2])
def test_no_string_ends_the_emulated_bus(protocol: float, seed: int) -> None:
    # Some strings are proper instructions: servos may have another baud or protocol afterwards, or one id.
    servos = [EmulatedServo(id, "AX-18A" if protocol == 1.0 else "XM430-W350") for id in (1, 2, 3)]
    with EmulatedBus(servos, baud=BAUD, clock=VirtualClock()) as bus:
        client = Babbler(bus)
        try:
            client.babble(Random(seed))
            time.sleep(PACKET_TIMEOUT_S)
            for id, servo in enumerate(servos, 1):
                servo.set("id", id)
                servo.set("baud_rate", {baud: code for code, baud in servo.model.baud_codes.items()}[BAUD])
                if "protocol_type" in servo.model.registers:
                    servo.set("protocol_type", 2)
            assert client.answers({1, 2, 3}, protocol)
        finally:
            client.port.close()


@pytest.mark.parametrize("instruction", [Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ])
def test_a_fast_read_of_more_than_a_packet_holds_is_silence(instruction: Instruction) -> None:
    each = bytes.fromhex("84 00 FF FF")  # from 132 on, 65535 bytes
    parameters = each + b"\1\2" if instruction == Instruction.FAST_SYNC_READ else b"\1" + each + b"\2" + each
    with EmulatedBus([EmulatedServo(id, "XM430-W350") for id in (1, 2)], baud=BAUD, clock=VirtualClock()) as bus:
        client = Babbler(bus)
        try:
            client.port.write(encode_instruction(BROADCAST, instruction, parameters, 2.0))
            assert client.answers({1, 2}, 2.0)
        finally:
            client.port.close()
