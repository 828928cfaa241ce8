"""Every kind of fault as a client meets it, with its times and rates, the same in every run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from drivers.clock import MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo, parse_fault
from drivers.emulator.faults import KINDS
from drivers.emulator.wire import Wire
from drivers.errors import BusLost, NoReply, ServoFault
from drivers.packets import FrameReader, Instruction, encode_instruction, read_status
from tests.drivers.line import Line

S = 1_000_000_000
MODEL = {1.0: "AX-18A", 2.0: "XM430-W350"}
POSITION = {1.0: "24 02", 2.0: "84 00 04 00"}
SIZE = {1.0: 8, 2.0: 15}  # of the status packet with the position
BOTH = pytest.mark.parametrize("protocol", [1.0, 2.0])


@contextmanager
def faulty(protocol: float, *faults: str, seed: int = 0) -> Iterator[tuple[Line, VirtualClock, EmulatedBus]]:
    clock = VirtualClock()
    servos = [EmulatedServo(id, MODEL[protocol], protocol=protocol) for id in (1, 2)]
    with EmulatedBus(servos, baud=1_000_000, clock=clock, faults=list(map(parse_fault, faults)), seed=seed) as bus:
        line = Line(bus, protocol)
        try:
            yield line, clock, bus
        finally:
            line.close()


def position(line: Line, servo_id: int, size: int = 1) -> bytes:
    return line.raw(servo_id, Instruction.READ, POSITION[line.protocol], size=size)


def silent(line: Line, servo_id: int) -> bool:
    return line.hears_nothing(servo_id, Instruction.READ, POSITION[line.protocol])


def healthy(protocol: float, servo_id: int) -> bytes:
    with faulty(protocol) as (line, _, _):
        return position(line, servo_id, SIZE[protocol])


def intact(reply: bytes, protocol: float) -> bool:
    return any(read_status(frame, protocol) is not None for frame in FrameReader(protocol).feed(reply))


@BOTH
def test_mute_lasts_its_time_and_befalls_whom_it_names(protocol: float) -> None:
    good = healthy(protocol, 1)
    with faulty(protocol, "mute:1@2+1") as (line, clock, _):
        assert position(line, 1, len(good)) == good
        clock.sleep_until_ns(2 * S)
        assert silent(line, 1)
        assert position(line, 2, len(good))[:5] != b""
        clock.sleep_until_ns(3 * S)
        assert position(line, 1, len(good)) == good


def test_a_mute_servo_does_what_it_is_told() -> None:
    with faulty(2.0, "mute:1+1") as (line, clock, _):
        assert line.hears_nothing(1, Instruction.WRITE, "41 00 01")
        clock.sleep_until_ns(S)
        assert line.ask(1, Instruction.READ, "41 00 01 00") == [(1, 0, b"\x01")]


@BOTH
def test_delay_passes_on_the_clock(protocol: float) -> None:
    with faulty(protocol) as (line, clock, _):
        position(line, 1, SIZE[protocol])
        prompt_ns = clock.now_ns()
    with faulty(protocol, "delay:1=0.25") as (line, clock, _):
        position(line, 1, SIZE[protocol])
        assert clock.now_ns() == prompt_ns + S // 4


@BOTH
@pytest.mark.parametrize("kind", ["bad_crc", "corrupt"])
def test_one_byte_is_wrong_and_no_packet_is_intact(protocol: float, kind: str) -> None:
    good = healthy(protocol, 1)
    places = set()
    with faulty(protocol, kind) as (line, _, _):
        for _ in range(60):
            reply = position(line, 1, len(good))
            changed = [at for at, (have, want) in enumerate(zip(reply, good, strict=True)) if have != want]
            assert len(changed) == 1 and not intact(reply, protocol)
            places |= set(changed)
    checksum = {len(good) - 1} if protocol == 1.0 else {len(good) - 1, len(good) - 2}
    assert places == checksum if kind == "bad_crc" else len(places) > len(good) // 2


@BOTH
def test_wrong_id_is_an_intact_packet_of_somebody_else(protocol: float) -> None:
    with faulty(protocol, "wrong_id:1") as (line, _, _):
        found = [line.ask(1, Instruction.READ, POSITION[protocol])[0] for _ in range(20)]
    assert 1 not in {status.servo_id for status in found}
    assert len({status.parameters for status in found}) == 1


@BOTH
def test_truncate_sends_a_beginning(protocol: float) -> None:
    good = healthy(protocol, 1)
    with faulty(protocol, "truncate") as (line, _, _):
        sizes = set()
        for _ in range(20):
            reply = position(line, 1)
            assert good.startswith(reply) and 0 < len(reply) < len(good)
            sizes.add(len(reply))
    assert len(sizes) > 2


@BOTH
def test_noise_comes_before_the_reply(protocol: float) -> None:
    good = healthy(protocol, 1)
    with faulty(protocol, "noise=3") as (line, _, _):
        sizes = set()
        for _ in range(20):
            reply = position(line, 1)
            assert reply.endswith(good) and 0 < len(reply) - len(good) <= 3
            sizes.add(len(reply))
    assert len(sizes) == 3


@BOTH
def test_echo_returns_the_instruction_before_the_first_reply(protocol: float) -> None:
    good = healthy(protocol, 1)
    asked = encode_instruction(1, Instruction.READ, bytes.fromhex(POSITION[protocol]), protocol)
    with faulty(protocol, "echo") as (line, _, _):
        assert position(line, 1, len(asked + good)) == asked + good
        if protocol == 2.0:
            echoed = line.raw(0xFE, Instruction.SYNC_READ, "84 00 04 00 01 02", size=16 + 2 * len(good))
            assert echoed.count(bytes((0x82, 0x84))) == 1 and echoed.count(b"\x55\x00") == 2


@BOTH
def test_a_stray_reply_is_valid_and_the_true_one_follows(protocol: float) -> None:
    good = healthy(protocol, 1)
    with faulty(protocol, "stray:1") as (line, _, _):
        reply = position(line, 1, 2 * len(good))
        stray = [read_status(frame, protocol) for frame in FrameReader(protocol).feed(reply[: len(good)])]
        assert reply[len(good) :] == good
        assert stray[0] is not None and stray[0].servo_id == 2


@BOTH
def test_two_servos_with_one_id_garble_each_other(protocol: float) -> None:
    good = healthy(protocol, 1)
    with faulty(protocol, "duplicate_id:1") as (line, _, _):
        replies = [position(line, 1) for _ in range(20)]
    assert all(reply and reply != good for reply in replies)
    assert not any(intact(reply, protocol) for reply in replies)


@BOTH
def test_an_alert_shows_from_its_time_on(protocol: float) -> None:
    with faulty(protocol, "alert:1@1=overload") as (line, clock, _):
        assert line.ask(1, Instruction.PING)[0].error == 0
        clock.sleep_until_ns(S)
        assert line.ask(1, Instruction.PING)[0].error == (0x20 if protocol == 1.0 else 0x80)
        assert line.ask(2, Instruction.PING)[0].error == 0


@BOTH
def test_a_status_level_comes_and_goes(protocol: float) -> None:
    with faulty(protocol, "status_level:1+1=0") as (line, clock, _):
        assert silent(line, 1)
        assert line.ask(1, Instruction.PING)[0].servo_id == 1
        clock.sleep_until_ns(S)
        assert len(position(line, 1, SIZE[protocol])) == SIZE[protocol]


@BOTH
def test_a_servo_that_changes_its_baud_is_silent_at_the_old_one(protocol: float) -> None:
    with faulty(protocol, "baud:1@1+1=57600") as (line, clock, _):
        clock.sleep_until_ns(S)
        assert silent(line, 1)
        line.serial.baudrate = 57_600
        assert len(position(line, 1, SIZE[protocol])) == SIZE[protocol]
        assert silent(line, 2)
        clock.sleep_until_ns(2 * S)
        assert silent(line, 1)


def read(line: Line, register: str, servo_id: int = 1) -> int:
    model = EmulatedServo(servo_id, MODEL[line.protocol]).model
    at = model.register(getattr(model, register, register))
    if line.protocol == 1.0:
        asked = bytes((at.address, at.size))
    else:
        asked = at.address.to_bytes(2, "little") + at.size.to_bytes(2, "little")
    return at.decode(line.ask(servo_id, Instruction.READ, asked.hex())[0].parameters)


@BOTH
def test_voltages_lie_over_each_other_and_end(protocol: float) -> None:
    with faulty(protocol, "voltage:1@1+4=11", "voltage:1@2+1=10.5") as (line, clock, _):
        seen = []
        for t_s in (0.5, 1.5, 2.5, 3.5, 5.5):
            clock.sleep_until_ns(int(t_s * S))
            seen.append(read(line, "voltage_register"))
    assert seen == [seen[0], 110, 105, 110, seen[0]] and seen[0] not in (110, 105)


@BOTH
def test_a_temperature_is_what_the_servo_measures(protocol: float) -> None:
    with faulty(protocol, "temperature:1@1=61") as (line, clock, _):
        assert read(line, "present_temperature") < 40
        clock.sleep_until_ns(S)
        assert read(line, "present_temperature") == 61
        assert read(line, "present_temperature", 2) < 40


@BOTH
@pytest.mark.parametrize(("value", "stops_deg"), [("-5..10", 10.0), ("4", 4.0)])
def test_an_obstructed_shaft_stops_at_the_obstruction(protocol: float, value: str, stops_deg: float) -> None:
    with faulty(protocol, f"obstruct:1@0.5+1.3={value}") as (line, clock, bus):
        torque, goal = ("18 01", "1E 58 02") if protocol == 1.0 else ("40 00 01", "74 00 00 0A 00 00")
        clock.sleep_until_ns(S)
        line.ask(1, Instruction.WRITE, torque)
        line.ask(1, Instruction.WRITE, goal)
        clock.sleep_until_ns(S + S // 2)  # it isn't stalled long enough for an overload
        assert math.degrees(bus.shaft_rad(1, S + S // 2)) == pytest.approx(stops_deg, abs=0.5)
        clock.sleep_until_ns(4 * S)
        assert math.degrees(bus.shaft_rad(1, 4 * S)) > 20


@BOTH
def test_a_servo_without_power_is_silent_and_starts_anew(protocol: float) -> None:
    with faulty(protocol, "reboot:1@1+0.5") as (line, clock, _):
        line.ask(1, Instruction.WRITE, "18 01" if protocol == 1.0 else "40 00 01")
        assert read(line, "torque_enable") == 1
        clock.sleep_until_ns(S)
        assert line.hears_nothing(1, Instruction.PING)
        clock.sleep_until_ns(S + S // 2)
        assert read(line, "torque_enable") == 0


def test_a_fault_that_unplugs_takes_the_device_away_and_brings_it_back() -> None:
    with faulty(2.0, "unplug@1+1") as (line, clock, bus):
        clock.sleep_until_ns(S)
        with pytest.raises((OSError, serial.SerialException)):
            for _ in range(20):
                line.ask(1, Instruction.PING, replies=0)
        line.close()
        assert not Path(bus.path).exists()
        clock.sleep_until_ns(2 * S)
        for _ in range(10_000):
            if Path(bus.path).exists():
                break
            MonotonicClock().sleep_until_ns(MonotonicClock().now_ns() + 1_000_000)
        again = Line(bus, 2.0)
        assert again.ask(1, Instruction.PING)[0].servo_id == 1
        again.close()


def test_a_reply_that_is_on_its_way_when_the_plug_is_pulled_is_lost() -> None:
    servo = EmulatedServo(1, "XM430-W350")
    faults = [parse_fault("delay=1"), parse_fault("unplug@0.5+3")]
    wire = Wire([servo], faults=faults, seed=0, start_ns=0)
    servo.set("baud_rate", 3)
    ping = FrameReader(2.0).feed(encode_instruction(1, Instruction.PING, b"", 2.0))[0]
    assert list(wire.hear(ping, 2.0, 1_000_000, 0)) == [] and not wire.plugged
    assert list(wire.hear(ping, 2.0, 1_000_000, 2 * S)) == []
    assert [sending.servo_id for sending in wire.hear(ping, 2.0, 1_000_000, 4 * S)] == [1]


def test_every_kind_is_tested_here() -> None:
    tested = Path(__file__).read_text(encoding="utf-8")
    for kind in KINDS:
        assert f'"{kind}' in tested, kind


@BOTH
def test_a_rate_is_a_share_and_the_seed_decides_which(protocol: float) -> None:
    def answered(seed: int) -> list[bool]:
        with faulty(protocol, "mute:1%0.5", "noise:2%0.5", seed=seed) as (line, _, _):
            return [len(position(line, 2)) % 2 == 0 and not silent(line, 1) for _ in range(12)]

    first = answered(1)
    assert answered(1) == first and 0 < sum(first) < 12
    assert answered(2) != first


def test_the_driver_meets_the_faults_as_its_own_errors() -> None:
    clock = VirtualClock()
    faults = list(map(parse_fault, ["mute:1@1+1", "alert:2@3=overload", "unplug@5"]))
    servos = [EmulatedServo(id, "XM430-W350") for id in (1, 2)]
    with (
        EmulatedBus(servos, baud=1_000_000, clock=clock, faults=faults) as emulated,
        DynamixelBus(emulated.path, baud=1_000_000, protocol=2.0, clock=clock, reply_timeout_s=0.5) as bus,
    ):
        bus.ping(1)
        clock.sleep_until_ns(S)
        with pytest.raises(NoReply):
            bus.ping(1)
        clock.sleep_until_ns(3 * S)
        with pytest.raises(ServoFault):
            bus.write(2, "torque_enable", 1)  # refused after a shutdown
        clock.sleep_until_ns(5 * S)
        with pytest.raises(BusLost):
            bus.ping(1)
