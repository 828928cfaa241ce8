"""The emulated servos' instructions: the manual's own packets, both protocols on one wire, secondary ids."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest

from drivers.clock import VirtualClock
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.errors import DriverError
from drivers.packets import BROADCAST, Instruction, encode_instruction
from tests.drivers.line import Line

MIXED = (("AX-12A", 1), ("XL430-W250", 2), ("AX-18A", 3), ("XM540-W270", 4))


@contextmanager
def clients(servos: Sequence[EmulatedServo], *protocols: float) -> Iterator[tuple[Line, ...]]:
    with EmulatedBus(servos, baud=1_000_000, clock=VirtualClock()) as bus:
        lines = [Line(bus, protocol) for protocol in protocols]
        try:
            yield tuple(lines)
        finally:
            for line in lines:
                line.close()


def at_count(id: int, count: int) -> EmulatedServo:
    return EmulatedServo(id, "XC330-T288", initial_count=count)


def test_a_fast_sync_read_is_answered_as_the_manual_prints_it() -> None:
    # e-manual 2.0, Fast Sync Read, Example: ids 3, 7, 4 at 166, 2079, 1023
    asked = encode_instruction(BROADCAST, Instruction.FAST_SYNC_READ, bytes.fromhex("84 00 04 00 03 07 04"), 2.0)
    assert asked == bytes.fromhex("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2")
    printed = (
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08"
        "00 07 1F 08 00 00 16 CA"
        "00 04 FF 03 00 00 D1 9E"
    )  # fmt: skip
    with clients([at_count(3, 166), at_count(7, 2079), at_count(4, 1023)], 2.0) as (line,):
        assert line.raw(BROADCAST, 0x8A, "84 00 04 00 03 07 04", size=32) == bytes.fromhex(printed)


def test_a_fast_bulk_read_is_answered_as_the_manual_prints_it() -> None:
    # e-manual 2.0, Fast Bulk Read, Example: position of 3, PWM of 7, temperature of 4 (its instruction's CRC is the
    # previous example's, a misprint; that of the status packet is right). PWM reads 0 here, not 421.
    with clients([at_count(3, 166), at_count(7, 2048), EmulatedServo(4, "XC330-T288", temperature_c=31)], 2.0) as (
        line,
    ):
        answer = line.raw(BROADCAST, 0x9A, "03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00", size=27)
    assert answer[:16] == bytes.fromhex("FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4")
    assert answer[16:20] == bytes.fromhex("00 07 00 00") and answer[22:25] == bytes.fromhex("00 04 1F")


def test_a_fast_read_breaks_off_at_a_missing_servo() -> None:
    with clients([at_count(3, 166), at_count(4, 1023)], 2.0) as (line,):
        answer = line.raw(BROADCAST, 0x8A, "84 00 04 00 03 07 04", size=16)
        assert answer == bytes.fromhex("FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08")
        line.reader.clear()
        assert line.ask(4, Instruction.PING)[0].servo_id == 4


def test_clear_and_backup_are_answered_as_the_manual_prints_it() -> None:
    ok = bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C")
    with clients([EmulatedServo(1, "XC330-T288")], 2.0) as (line,):
        assert line.raw(1, Instruction.CLEAR, "01 44 58 4C 22", size=11) == ok
        assert line.raw(1, Instruction.BACKUP, "01 43 54 52 4C", size=11) == ok
        assert line.raw(1, Instruction.BACKUP, "02 43 54 52 4C", size=11) == ok
        assert line.ask(1, Instruction.CLEAR, "01 44 58 4C 23") == [(1, 4, b"")]  # another key
        assert line.ask(1, Instruction.BACKUP, "03 43 54 52 4C") == [(1, 4, b"")]


def test_a_backup_brings_the_eeprom_back() -> None:
    with clients([EmulatedServo(1, "XC330-T288")], 2.0) as (line,):
        assert line.ask(1, Instruction.BACKUP, "02 43 54 52 4C") == [(1, 1, b"")]  # nothing stored
        line.ask(1, Instruction.WRITE, "09 00 11")  # return delay time
        line.ask(1, Instruction.BACKUP, "01 43 54 52 4C")
        line.ask(1, Instruction.WRITE, "09 00 22")
        line.ask(1, Instruction.WRITE, "40 00 01")
        assert line.ask(1, Instruction.BACKUP, "02 43 54 52 4C") == [(1, 1, b"")]  # torque is on: Result Fail
        line.ask(1, Instruction.WRITE, "40 00 00")
        assert line.ask(1, Instruction.BACKUP, "02 43 54 52 4C") == [(1, 0, b"")]
        assert line.ask(1, Instruction.READ, "09 00 01 00") == [(1, 0, b"\x11")]


def test_reboot_in_protocol_1_is_for_the_models_that_have_it() -> None:
    # e-manual 1.0, Reboot: MX and X
    with clients([EmulatedServo(1, "XM430-W210", protocol=1.0), EmulatedServo(2, "AX-12A")], 1.0) as (line,):
        assert line.raw(1, Instruction.REBOOT, size=6) == bytes.fromhex("FF FF 01 02 00 FC")
        assert line.ask(2, Instruction.REBOOT) == [(2, 64, b"")]


def test_a_broadcast_factory_reset_keeps_the_ids_or_is_not_done() -> None:
    with clients([EmulatedServo(1, "XM430-W210"), EmulatedServo(2, "XM430-W210")], 2.0) as (line,):
        line.ask(1, Instruction.WRITE, "09 00 11")
        line.ask(BROADCAST, Instruction.FACTORY_RESET, "FF", replies=0)
        assert line.ask(1, Instruction.READ, "09 00 01 00") == [(1, 0, b"\x11")]
        line.ask(BROADCAST, Instruction.FACTORY_RESET, "02", replies=0)
        assert line.ask(1, Instruction.READ, "09 00 01 00") == [(1, 0, b"\xfa")]
        assert line.ask(2, Instruction.PING)[0].servo_id == 2


def test_servos_of_both_protocols_share_a_wire() -> None:
    servos = [EmulatedServo(id, model) for model, id in MIXED]
    with clients(servos, 1.0, 2.0) as (ax, x):
        for _ in range(3):
            assert [ax.ask(id, Instruction.PING) for id in (1, 3)] == [[(1, 0, b"")], [(3, 0, b"")]]
            assert [status.servo_id for status in x.ask(BROADCAST, Instruction.PING, replies=2)] == [2, 4]
            assert ax.hears_nothing(2, Instruction.PING) and x.hears_nothing(1, Instruction.PING)
            assert x.ask(2, Instruction.READ, "84 00 04 00") == [(2, 0, b"\x00\x08\x00\x00")]
            assert ax.ask(1, Instruction.READ, "24 02") == [(1, 0, b"\x00\x02")]


def test_packets_of_two_protocols_in_one_breath_are_done_in_their_order() -> None:
    # Goal -1 is FF FF FF FF inside the packet of protocol 2.0: nothing that is a packet of protocol 1.0.
    goals = encode_instruction(BROADCAST, Instruction.SYNC_WRITE, bytes.fromhex("74 00 04 00 02 FF FF FF FF"), 2.0)
    led = encode_instruction(BROADCAST, Instruction.WRITE, bytes.fromhex("19 01"), 1.0)
    with clients([EmulatedServo(id, model) for model, id in MIXED], 1.0) as (line,):
        assert line.send(goals + led + encode_instruction(1, Instruction.READ, b"\x19\x01", 1.0), 1) == [(1, 0, b"\1")]


def test_each_servo_has_its_own_baud() -> None:
    servos = [EmulatedServo(1, "AX-12A"), EmulatedServo(2, "XL430-W250")]  # 1 Mbaud and 57600, out of the box
    with EmulatedBus(servos, clock=VirtualClock()) as bus:
        line = Line(bus, 2.0, 57_600)
        assert line.ask(2, Instruction.PING)[0].servo_id == 2
        line.speak(1.0)
        assert line.hears_nothing(1, Instruction.PING)
        line.close()
        line = Line(bus, 1.0, 1_000_000)
        assert line.ask(1, Instruction.PING)[0].servo_id == 1
        line.close()


def followers() -> list[EmulatedServo]:
    """A leader with id 2 and a follower with id 3 that obeys id 2 too."""
    follower = EmulatedServo(3, "XM430-W350")
    follower.set("secondary_id", 2)
    return [EmulatedServo(2, "XM430-W350"), follower]


def test_a_secondary_id_is_obeyed_without_a_word() -> None:
    with clients(followers(), 2.0) as (line,):
        ok = line.raw(2, Instruction.WRITE, "41 00 01")
        assert len(ok) == 11 and ok[4] == 2  # one status packet, of the leader
        assert line.ask(3, Instruction.READ, "41 00 01 00") == [(3, 0, b"\x01")]
        # e-manual, Secondary ID: the EEPROM area can't be changed by it
        line.ask(2, Instruction.WRITE, "09 00 11")
        assert line.ask(3, Instruction.READ, "09 00 01 00") == [(3, 0, b"\xfa")]


@pytest.mark.parametrize(
    ("instruction", "parameters"),
    [
        (Instruction.SYNC_WRITE, "41 00 01 00 02 01"),
        (Instruction.BULK_WRITE, "02 41 00 01 00 01"),
    ],
)
def test_a_secondary_id_is_obeyed_in_group_writes(instruction: int, parameters: str) -> None:
    with clients(followers(), 2.0) as (line,):
        line.ask(BROADCAST, instruction, parameters, replies=0)
        assert line.ask(3, Instruction.READ, "41 00 01 00") == [(3, 0, b"\x01")]


def test_a_secondary_id_answers_no_group_read() -> None:
    with clients(followers(), 2.0) as (line,):
        found = line.ask(BROADCAST, Instruction.SYNC_READ, "84 00 04 00 02 03", replies=2)
        assert [status.servo_id for status in found] == [2, 3]


def test_two_servos_that_got_one_id_talk_at_once() -> None:
    with clients([EmulatedServo(1, "AX-12A"), EmulatedServo(2, "AX-18A")], 1.0) as (line,):
        line.ask(2, Instruction.WRITE, "03 01")
        garbled = line.raw(1, Instruction.READ, "00 02")
        assert garbled and garbled not in (
            bytes.fromhex("FF FF 01 04 00 0C 00 EE"),
            bytes.fromhex("FF FF 01 04 00 12 00 E8"),
        )


def test_a_model_that_does_not_speak_the_protocol_is_refused() -> None:
    with pytest.raises(DriverError, match=r"AX-12A speaks protocol 1\.0"):
        EmulatedServo(1, "AX-12A", protocol=2.0)


def test_clear_forgets_whole_turns_of_a_shaft_at_rest() -> None:
    clock = VirtualClock()
    with EmulatedBus([EmulatedServo(1, "XC330-T288")], baud=1_000_000, clock=clock) as bus:
        line = Line(bus, 2.0)
        line.ask(1, Instruction.WRITE, "0B 00 04")  # extended position
        line.ask(1, Instruction.WRITE, "40 00 01")
        line.ask(1, Instruction.WRITE, "74 00 88 13 00 00")  # goal 5000
        clock.sleep_until_ns(200_000_000)
        assert line.ask(1, Instruction.CLEAR, "01 44 58 4C 22") == [(1, 1, b"")]  # it moves: Result Fail
        clock.sleep_until_ns(5_000_000_000)
        assert line.ask(1, Instruction.READ, "84 00 04 00")[0].parameters == (5000).to_bytes(4, "little")
        before_rad = bus.shaft_rad(1, clock.now_ns())
        assert line.ask(1, Instruction.CLEAR, "01 44 58 4C 22") == [(1, 0, b"")]
        clock.sleep_until_ns(6_000_000_000)
        assert line.ask(1, Instruction.READ, "84 00 04 00")[0].parameters == (5000 - 4096).to_bytes(4, "little")
        assert bus.shaft_rad(1, clock.now_ns()) == pytest.approx(before_rad, abs=1e-3)  # nothing moved
        line.close()
