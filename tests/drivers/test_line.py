"""What the driver takes for an answer: echoes, impostors in group reads, blocks of registers, and one owner thread."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterable

import pytest

from drivers.errors import BusLost, DriverError, NoReply
from drivers.packets import Instruction, encode_instruction, encode_status
from tests.drivers.test_dynamixel import BOTH, PATIENT_S, QUICK_S, Once, station


def read_instruction(model: str, servo_id: int, address: int, size: int, protocol: float) -> bytes:
    width = 1 if protocol == 1.0 else 2
    parameters = address.to_bytes(width, "little") + size.to_bytes(width, "little")
    return encode_instruction(servo_id, Instruction.READ, parameters, protocol)


@BOTH
def test_an_echo_is_no_answer(model: str, protocol: float) -> None:
    """A two-byte read of protocol 1.0 and a status packet with two bytes look alike: the echo is no value."""
    with station(model, protocol) as (bus, _):
        register = bus.model(1).register("goal_position" if protocol == 1.0 else "present_input_voltage")
        want = bus.read(1, register.name)
    echo = read_instruction(model, 1, register.address, register.size, protocol)
    fault = Once(lambda id, reply: ((0, echo), (0, reply)))
    with station(model, protocol, alter_reply=fault) as (bus, _):
        bus.model(1)
        fault.armed = 1
        assert bus.read(1, register.name) == want
        assert bus.errors["retries"] == 0
        assert bus.errors["echoes"] == (1 if protocol == 1.0 else 0)  # of protocol 2.0 the SDK drops it


def test_an_echo_alone_is_no_servo() -> None:
    ping = encode_instruction(1, Instruction.PING, b"", 1.0)
    with (
        station("AX-18A", 1.0, timeout_s=QUICK_S, alter_reply=lambda id, reply: ((0, ping),)) as (bus, _),
        pytest.raises(NoReply),
    ):
        bus.ping(1)


def test_a_servo_with_a_voltage_alarm_answers_a_ping_with_the_bytes_of_the_ping() -> None:
    assert encode_status(1, 1, b"", 1.0) == encode_instruction(1, Instruction.PING, b"", 1.0)
    with station("AX-18A", 1.0, timeout_s=QUICK_S) as (bus, emulated):
        emulated.raise_alarm(1, "input_voltage")
        assert bus.ping(1) == 18
        assert bus.alarms == {1: ("input_voltage",)}


def test_a_servo_that_answers_in_anothers_place_is_not_believed() -> None:
    """Servo 2 is silent and servo 3 answers as 2: that can be told by nothing but the reply that is missing then."""
    armed = [False]

    def impostor(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        if not armed[0] or servo_id == 1:
            return ((0, reply),)
        if servo_id == 2:
            return ()
        armed[0] = False
        return ((0, encode_status(2, 0, reply[9:-2], 2.0)),)

    with station("XM430-W350", 2.0, timeout_s=QUICK_S, alter_reply=impostor) as (bus, _):
        bus.sync_write("goal_position", {1: 1000, 2: 2000, 3: 3000})
        for id in (1, 2, 3):
            bus.model(id)
        armed[0] = True
        readings = bus.read_many([1, 2, 3], "goal_position")
        assert {id: reading.value for id, reading in readings.items()} == {1: 1000, 2: 2000, 3: 3000}
        assert bus.errors["fallbacks"] == 1


@pytest.mark.parametrize(("model", "protocol"), [("MX-28", 1.0), ("XM430-W350", 2.0)])
def test_a_groups_replies_count_only_if_nothing_is_between_them(model: str, protocol: float) -> None:
    """Of servo 2's reply one byte is left, then a whole one under its id follows: both servos seem to have answered."""
    armed = [False]

    def spoil(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        if not armed[0] or servo_id == 1:
            return ((0, reply),)
        if servo_id == 2:
            return ((0, reply[:1]),)
        armed[0] = False
        return ((0, encode_status(2, 0, b"\x11\x01", protocol)), (0, reply))

    register = "goal_position" if protocol == 1.0 else "present_input_voltage"
    with station(model, protocol, timeout_s=QUICK_S, alter_reply=spoil) as (bus, _):
        want = {id: bus.read(id, register) for id in (1, 2, 3)}
        armed[0] = True
        readings = bus.read_many([1, 2, 3], register)
        assert {id: reading.value for id, reading in readings.items()} == want
        assert bus.errors["fallbacks"] == 1


@pytest.mark.parametrize(("model", "protocol"), [("AX-18A", 1.0), ("MX-28", 1.0), ("XM430-W350", 2.0), ("XL-320", 2.0)])
def test_a_block_is_what_its_registers_read(model: str, protocol: float) -> None:
    with station(model, protocol) as (bus, _):
        table = bus.model(1)
        names = (*table.status_registers, "id", "goal_position")
        blocks = bus.read_blocks({2: names, 1: table.status_registers, 3: names})
        assert set(blocks) == {1, 2, 3}
        assert {name: bus.read(2, name) for name in names} == blocks[2].values
        assert set(blocks[1].values) == set(table.status_registers)
        assert not any(bus.errors.values())


def test_servos_with_bulk_read_answer_one_question_in_protocol_1() -> None:
    for model, questions in (("MX-28", 1), ("AX-18A", 3)):
        with station(model, 1.0) as (bus, _):
            for id in (1, 2, 3):
                bus.model(id)
            sent: list[bytes] = []
            write = bus._port.writePort
            bus._port.writePort = lambda packet, write=write, sent=sent: (sent.append(packet), write(packet))[1]  # type: ignore
            bus.read_many([1, 2, 3], "present_position")
            assert len(sent) == questions


def test_what_a_slow_adapter_adds_is_no_part_of_a_servos_turn() -> None:
    """An adapter that holds bytes back makes the answer late, not the servos: turns are no longer than they can be."""
    held = [False]

    def hold(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        return ((16_000_000 if held[0] and servo_id == 3 else 0, reply),)

    with station("XM430-W350", 2.0, alter_reply=hold) as (bus, _):
        for id in (1, 2, 3):
            bus.model(id)
        held[0] = True
        readings = bus.read_many([1, 2, 3], "present_position")
        turns_us = [(reading.t_reply_ns - reading.t_request_ns) / 1000 for reading in readings.values()]
        assert turns_us == [150 + 508] * 3  # 15 bytes at 10 us, and the longest return delay


def test_a_block_of_a_markers_size_is_asked_for_with_one_byte_more() -> None:
    """Reads of five bytes are what the driver asks for to be sure that no late reply is under way."""
    sizes: list[int] = []

    def note(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        sizes.append(len(reply) - 6)
        return ((0, reply),)

    with station("AX-18A", 1.0, alter_reply=note) as (bus, _):
        bus.model(1)
        block = bus.read_blocks({1: ("present_load", "present_voltage", "registered")})[1]
        assert sizes[-1] == 6
        assert block.values["present_voltage"] == bus.read(1, "present_voltage")


@BOTH
def test_after_a_failure_no_servo_is_believed_before_the_line_is_clear(model: str, protocol: float) -> None:
    """Servo 1 was given up; what it says late stands under the id of servo 2, and has the size of its answer."""
    late = encode_status(2, 0, b"\x11\x01", protocol)

    def speak(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        if servo_id == 1:
            return ()
        sent = ((0, late), (0, reply)) if late in held else ((0, reply),)
        held.clear()
        return sent

    held: list[bytes] = []
    register = "goal_position" if protocol == 1.0 else "present_input_voltage"
    with station(model, protocol, timeout_s=QUICK_S, alter_reply=speak) as (bus, _):
        want = bus.read(2, register)
        bus._models[1] = bus.model(2)
        with pytest.raises(NoReply):
            bus.read(1, register)
        held.append(late)
        assert bus.read(2, register) == want


def test_the_echo_of_a_question_that_was_given_up_is_no_answer_to_the_next() -> None:
    """Two questions are answered late, each behind its echo: none of those packets is the answer to the third."""
    wanted = [False]
    held: list[bytes] = []

    def hold(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        size = len(reply) - 6
        echo = encode_instruction(1, Instruction.READ, bytes((0 if size > 2 else 36, size)), 1.0)
        if not wanted[0]:
            yield 0, reply
        elif len(held) < 2:
            held.append(echo + reply)
        else:
            wanted[0] = False
            yield 0, held[0] + held[1]
            time.sleep(0.05)  # a driver that believed the second one has asked its question again by now
            yield 0, echo + reply

    with station("AX-18A", 1.0, timeout_s=QUICK_S, alter_reply=hold) as (bus, _):
        bus.model(1)
        wanted[0] = True
        assert bus.read(1, "present_position") == 512
        assert bus.errors["retries"] == 2


def test_a_reboot_ends_an_alarm_of_protocol_2() -> None:
    with station("XM430-W350", 2.0) as (bus, emulated):
        emulated.raise_alarm(1, "overload")
        bus.read(1, "id")
        assert bus.alarms == {1: ("alert",)}
        bus.reboot(1)
        assert (bus.read(1, "id"), bus.alarms) == (1, {})
    with station("AX-18A", 1.0) as (bus, _), pytest.raises(DriverError, match="no reboot"):
        bus.reboot(1)


@BOTH
def test_a_signal_while_waiting_cuts_no_exchange_in_half(model: str, protocol: float) -> None:
    """Ctrl-C ends the wait, not the exchange: the next question gets its own answer and nothing is left on the line."""
    fault = Once(lambda id, reply: (time.sleep(0.2), ((0, reply),))[1])
    with station(model, protocol, alter_reply=fault, timeout_s=PATIENT_S) as (bus, _):
        bus.model(1)
        fault.armed = 1
        timer = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            bus.read(1, "id")
        timer.join()
        assert bus.read(1, "return_delay_time") == 250
        assert not any(bus.errors.values())


def test_a_lost_bus_leaves_no_thread_and_can_be_opened_again() -> None:
    with station("AX-18A", 1.0) as (bus, emulated):
        assert [thread.name for thread in threading.enumerate() if thread.name.startswith("bus ")]
        emulated.close()
        with pytest.raises(BusLost):
            bus.read(1, "id")
        assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("bus ")]
        with pytest.raises(BusLost):
            bus.open()
