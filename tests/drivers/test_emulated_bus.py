"""The emulated bus, by raw packets: instructions, errors, silence, timing; nothing is left behind."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.clock import Clock, VirtualClock
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.emulator.bus import AlterReply
from drivers.errors import DriverError
from drivers.packets import BROADCAST, Instruction, encode_instruction
from tests.drivers.line import Line


@contextmanager
def line(
    model: str,
    protocol: float,
    *,
    clock: Clock | None = None,
    ids: tuple[int, ...] = (1, 2),
    client_baud: int = 1_000_000,
    fragment_bytes: int | None = None,
    alter_reply: AlterReply | None = None,
) -> Iterator[Line]:
    servos = [EmulatedServo(id, model, protocol=protocol) for id in ids]
    bus = EmulatedBus(
        servos,
        baud=1_000_000,
        clock=clock or VirtualClock(),
        fragment_bytes=fragment_bytes,
        alter_reply=alter_reply,
    )
    with bus:
        client = Line(bus, protocol, client_baud)
        try:
            yield client
        finally:
            client.close()


def test_protocol_1_single_instructions() -> None:
    with line("AX-18A", 1.0) as client:
        assert client.ask(1, Instruction.PING) == [(1, 0, b"")]
        assert client.ask(1, Instruction.READ, "00 02") == [(1, 0, b"\x12\x00")]
        assert client.ask(1, Instruction.WRITE, "19 01") == [(1, 0, b"")]
        assert client.ask(1, Instruction.READ, "19 01") == [(1, 0, b"\x01")]
        assert client.ask(1, Instruction.REG_WRITE, "19 00") == [(1, 0, b"")]
        assert client.ask(1, Instruction.READ, "19 01") == [(1, 0, b"\x01")]
        assert client.ask(1, Instruction.ACTION) == [(1, 0, b"")]
        assert client.ask(1, Instruction.READ, "19 01") == [(1, 0, b"\x00")]
        assert client.ask(1, Instruction.ACTION) == [(1, 64, b"")]  # nothing registered
        assert client.ask(1, Instruction.REBOOT) == [(1, 64, b"")]  # not in protocol 1.0
        assert client.ask(1, Instruction.WRITE, "1E FF 7F") == [(1, 8, b"")]  # goal 32767
        assert client.ask(1, Instruction.READ, "31 05") == [(1, 8, b"")]  # past the end of the table


def test_protocol_2_single_instructions() -> None:
    with line("XM430-W350", 2.0) as client:
        assert client.ask(1, Instruction.PING) == [(1, 0, b"\xfc\x03\x00")]
        assert client.ask(1, Instruction.READ, "84 00 04 00") == [(1, 0, b"\x00\x08\x00\x00")]
        assert client.ask(1, Instruction.WRITE, "40 00 01") == [(1, 0, b"")]
        assert client.ask(1, Instruction.WRITE, "09 00 00") == [(1, 7, b"")]  # EEPROM while torque is on
        assert client.ask(1, Instruction.WRITE, "74 00 00 20 00 00") == [(1, 6, b"")]  # goal 8192
        assert client.ask(1, Instruction.WRITE, "74 00 00 02") == [(1, 5, b"")]  # half a register
        assert client.ask(1, Instruction.WRITE, "40 00 05") == [(1, 4, b"")]
        assert client.ask(1, Instruction.REBOOT) == [(1, 0, b"")]
        assert client.ask(1, Instruction.READ, "40 00 01 00") == [(1, 0, b"\x00")]
        assert client.ask(1, Instruction.FACTORY_RESET, "02") == [(1, 0, b"")]
        assert client.ask(1, 0x77) == [(1, 2, b"")]


def test_protocol_1_groups() -> None:
    with line("AX-18A", 1.0) as client:
        assert client.ask(BROADCAST, Instruction.SYNC_WRITE, "1E 02 01 58 02 02 90 01", replies=0) == []
        assert client.ask(1, Instruction.READ, "1E 02") == [(1, 0, b"\x58\x02")]
        assert client.ask(2, Instruction.READ, "1E 02") == [(2, 0, b"\x90\x01")]
        # e-manual, protocol 1.0, Bulk Read is for the MX series alone
        assert client.ask(BROADCAST, Instruction.BULK_READ, "00 02 01 24 02 02 24", replies=0) == []
    with line("XM430-W350", 1.0) as client:
        found = client.ask(BROADCAST, Instruction.BULK_READ, "00 02 01 00 01 02 07", replies=2)
        assert found == [(1, 0, b"\xfc\x03"), (2, 0, b"\x02")]


def test_protocol_2_groups() -> None:
    with line("XM430-W350", 2.0) as client:
        goals = "74 00 04 00 01 00 04 00 00 02 00 05 00 00"
        assert client.ask(BROADCAST, Instruction.SYNC_WRITE, goals, replies=0) == []
        found = client.ask(BROADCAST, Instruction.SYNC_READ, "74 00 04 00 02 01", replies=2)
        assert found == [(2, 0, b"\x00\x05\x00\x00"), (1, 0, b"\x00\x04\x00\x00")]
        bulk = "01 41 00 01 00 01 02 74 00 04 00 00 06 00 00"
        assert client.ask(BROADCAST, Instruction.BULK_WRITE, bulk, replies=0) == []
        found = client.ask(BROADCAST, Instruction.BULK_READ, "01 41 00 01 00 02 74 00 04 00", replies=2)
        assert found == [(1, 0, b"\x01"), (2, 0, b"\x00\x06\x00\x00")]
        found = client.ask(BROADCAST, Instruction.PING, replies=2)
        assert [status.servo_id for status in found] == [1, 2]


def test_after_a_missing_servo_the_rest_of_a_sync_read_is_silent() -> None:
    with line("XM430-W350", 2.0) as client:
        assert [s.servo_id for s in client.ask(BROADCAST, Instruction.SYNC_READ, "84 00 04 00 01 09 02")] == [1]
        assert client.ask(2, Instruction.PING)[0].servo_id == 2  # and not the answer of servo 2 to the sync read


@pytest.mark.parametrize(("model", "protocol"), [("AX-18A", 1.0), ("XM430-W350", 2.0)])
def test_what_no_servo_is_asked_for_is_silence(model: str, protocol: float) -> None:
    with line(model, protocol) as client:
        assert client.ask(9, Instruction.PING, replies=0) == []
        assert client.ask(BROADCAST, 0x77, replies=0) == []
        assert client.ask(BROADCAST, Instruction.READ, "00 02", replies=0) == []
        assert client.send(b"\x00\xff\x01noise", replies=0) == []


@pytest.mark.parametrize(("model", "protocol", "error"), [("AX-18A", 1.0, 16), ("XM430-W350", 2.0, 3)])
def test_a_damaged_instruction_is_answered_by_an_error(model: str, protocol: float, error: int) -> None:
    wire = bytearray(encode_instruction(1, Instruction.PING, b"", protocol))
    wire[-1] ^= 0x55
    with line(model, protocol) as client:
        assert client.send(bytes(wire), replies=1) == [(1, error, b"")]


@pytest.mark.parametrize(("model", "protocol"), [("AX-18A", 1.0), ("XM430-W350", 2.0)])
def test_another_baud_is_silence(model: str, protocol: float) -> None:
    with line(model, protocol, client_baud=57_600) as client:
        assert client.ask(1, Instruction.PING, replies=0) == []
        client.serial.baudrate = 1_000_000
        assert client.ask(1, Instruction.PING)[0].servo_id == 1


def test_status_return_level_is_honoured() -> None:
    with line("AX-18A", 1.0) as client:
        client.ask(1, Instruction.WRITE, "10 01", replies=0)  # level 1: reads only, from now on
        assert client.ask(1, Instruction.WRITE, "19 01", replies=0) == []
        assert client.ask(1, Instruction.READ, "19 01") == [(1, 0, b"\x01")]  # it took effect
        client.ask(1, Instruction.WRITE, "10 00", replies=0)
        assert client.ask(1, Instruction.READ, "19 01", replies=0) == []
        assert client.ask(1, Instruction.PING) == [(1, 0, b"")]


def test_an_alarm_shows_in_every_status() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    with EmulatedBus([servo], baud=1_000_000, clock=VirtualClock()) as bus:
        client = Line(bus, 2.0, 1_000_000)
        bus.raise_alarm(1, "overheating")
        assert client.ask(1, Instruction.READ, "46 00 01 00") == [(1, 0x80, b"\x04")]
        client.close()


def test_wire_time_and_return_delay_pass_on_the_clock() -> None:
    clock = VirtualClock(start_ns=5_000)
    with line("AX-18A", 1.0, clock=clock) as client:
        client.ask(1, Instruction.READ, "24 02")
        # 8 bytes there, 8 back, at 10 us a byte (1 Mbaud, 10 bits), and 250 * 2 us
        assert clock.now_ns() == 5_000 + 80_000 + 500_000 + 80_000
        client.ask(1, Instruction.WRITE, "05 00")  # return delay 0: counts from the answer to this write on
        assert clock.now_ns() == 665_000 + 80_000 + 60_000


def test_a_shaft_is_where_the_goals_time_says() -> None:
    clock = VirtualClock()
    servo = EmulatedServo(1, "AX-18A", max_acceleration_rad_s2=1e6)
    with EmulatedBus([servo], baud=1_000_000, clock=clock) as bus:
        client = Line(bus, 1.0, 1_000_000)
        client.ask(1, Instruction.WRITE, "20 64 00")  # 11.1 rpm
        client.ask(1, Instruction.WRITE, "18 01")
        t_ns = clock.now_ns() + 90_000  # when the nine bytes of the goal have arrived
        client.ask(1, Instruction.WRITE, "1E FF 03")
        clock.sleep_until_ns(t_ns + 1_000_000_000)
        # 1e-5 rad: it takes 1.2 us to reach its speed
        assert bus.shaft_rad(1, t_ns + 1_000_000_000) == pytest.approx(11.1 * 6 * 3.14159265 / 180, abs=1e-5)
        assert bus.shaft_rad(1, t_ns) == 0.0
        with pytest.raises(DriverError, match="no emulated servo 5"):
            bus.shaft_rad(5, 0)
        client.close()


@pytest.mark.parametrize("fragment_bytes", [1, 3])
def test_replies_can_come_in_pieces(fragment_bytes: int) -> None:
    with line("XM430-W350", 2.0, fragment_bytes=fragment_bytes) as client:
        assert client.ask(1, Instruction.PING) == [(1, 0, b"\xfc\x03\x00")]


def test_an_id_that_is_written_is_the_new_id() -> None:
    with line("AX-18A", 1.0) as client:
        client.ask(1, Instruction.WRITE, "03 07")
        assert client.ask(7, Instruction.PING) == [(7, 0, b"")]
        assert client.ask(1, Instruction.PING, replies=0) == []


def test_wrong_setups_say_so() -> None:
    clock = VirtualClock()
    with pytest.raises(DriverError, match="one id"):
        EmulatedBus([EmulatedServo(1, "AX-18A")] * 2, baud=1_000_000, clock=clock)
    with pytest.raises(DriverError, match=r"speaks protocol 1\.0"):
        EmulatedServo(1, "AX-18A", protocol=2.0)
    with pytest.raises(DriverError, match="no baud 12345"):
        EmulatedBus([EmulatedServo(1, "AX-18A")], baud=12345, clock=clock)
    with pytest.raises(DriverError, match="isn't started"):
        _ = EmulatedBus([], baud=1_000_000, clock=clock).path


def test_closing_leaves_no_thread_and_no_descriptor() -> None:
    def left() -> tuple[int, int]:
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    before = left()
    for _ in range(20):
        bus = EmulatedBus([EmulatedServo(1, "AX-18A")], baud=1_000_000, clock=VirtualClock())
        bus.start()
        bus.start()  # twice is once
        bus.close()
        bus.close()
    assert left() == before
