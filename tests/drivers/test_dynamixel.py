"""The driver over the emulated bus: values, stamps, retries, and errors that say what to do."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.emulator.bus import AlterReply
from drivers.errors import BusLost, DriverError, NoReply, ServoFault
from drivers.packets import encode_status

BOTH = pytest.mark.parametrize(("model", "protocol"), [("AX-18A", 1.0), ("XM430-W350", 2.0)])
PATIENT_S = 5.0  # for replies that come: a stalled machine must not fail a test
QUICK_S = 0.1  # for replies that don't


@contextmanager
def station(
    model: str,
    protocol: float,
    *,
    clock: Clock | None = None,
    ids: Iterable[int] = (1, 2, 3),
    timeout_s: float = PATIENT_S,
    alter_reply: AlterReply | None = None,
    fragment_bytes: int | None = None,
    client_baud: int = 1_000_000,
) -> Iterator[tuple[DynamixelBus, EmulatedBus]]:
    clock = clock or VirtualClock()
    servos = [EmulatedServo(id, model, protocol=protocol) for id in ids]
    emulated = EmulatedBus(
        servos,
        baud=1_000_000,
        clock=clock,
        alter_reply=alter_reply,
        fragment_bytes=fragment_bytes,
    )
    with (
        emulated,
        DynamixelBus(emulated.path, baud=client_baud, protocol=protocol, clock=clock, reply_timeout_s=timeout_s) as bus,
    ):
        yield bus, emulated


def status_like(reply: bytes, servo_id: int, parameters: bytes) -> bytes:
    """A status packet of the same protocol as `reply`."""
    return encode_status(servo_id, 0, parameters, 2.0 if reply.startswith(b"\xff\xff\xfd\x00") else 1.0)


class Once:
    """Alters one reply, the first after `arm`; the others pass."""

    def __init__(self, change: Callable[[int, bytes], Iterable[tuple[int, bytes]]]) -> None:
        self.change = change
        self.armed = 0

    def __call__(self, servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        if self.armed:
            self.armed -= 1
            return self.change(servo_id, reply)
        return ((0, reply),)


@BOTH
def test_registers_are_read_and_written_by_name(model: str, protocol: float) -> None:
    with station(model, protocol) as (bus, _):
        assert bus.ping(1) == bus.model(1).model_number
        assert bus.read(1, "return_delay_time") == 250
        bus.write(1, "return_delay_time", 5)
        bus.write(1, "led", np.int64(1))  # the SDK's arithmetic overflows in numpy's integers
        assert bus.read(np.uint8(1), "led") == 1
        assert bus.read(1, "return_delay_time") == 5
        with pytest.raises(TypeError):
            bus.write(1, "led", 0.5)  # type: ignore[arg-type]
        with pytest.raises(DriverError, match="no register 'goal'"):
            bus.read(1, "goal")
        assert not any(bus.errors.values())


def test_values_are_signed_where_the_register_is() -> None:
    with station("XM430-W350", 2.0) as (bus, _):
        bus.write(1, "homing_offset", -100)
        assert bus.read(1, "homing_offset") == -100
    with station("AX-18A", 1.0) as (bus, emulated):
        bus.write(1, "moving_speed", 200)
        bus.write(1, "torque_enable", 1)
        bus.write(1, "goal_position", 100)
        for _ in range(400):  # each exchange lets about 0.7 ms pass
            bus.read(1, "present_speed")
        assert bus.read(1, "present_speed") == -200
        assert emulated.shaft_rad(1, 10**12) == bus.model(1).rad(100)


@BOTH
def test_groups_are_written_and_read(model: str, protocol: float) -> None:
    with station(model, protocol) as (bus, _):
        bus.sync_write("goal_position", {1: 600, 2: np.int32(700), 3: 800})
        readings = bus.read_many([3, 1, 2], "goal_position")
        assert {id: reading.value for id, reading in readings.items()} == {1: 600, 2: 700, 3: 800}
        assert not any(bus.errors.values())


def test_a_group_larger_than_the_sdks_packet_is_written_in_parts() -> None:
    ids = range(1, 101)  # 500 bytes of data; the SDK sends 250 at most
    with station("XM430-W350", 2.0, ids=ids) as (bus, _):
        bus.sync_write("goal_position", {id: 1000 + id for id in ids})
        assert [bus.read(id, "goal_position") for id in (1, 50, 100)] == [1001, 1050, 1100]


@BOTH
def test_stamps_enclose_the_exchange_on_the_bus_clock(model: str, protocol: float) -> None:
    clock = VirtualClock(start_ns=1_000)
    with station(model, protocol, clock=clock) as (bus, _):
        bus.ping(1), bus.ping(2), bus.ping(3)
        before_ns = clock.now_ns()
        readings = bus.read_many([1, 2, 3], "present_position")
        assert all(before_ns <= r.t_request_ns < r.t_ns < r.t_reply_ns <= clock.now_ns() for r in readings.values())
        sent_ns = bus.sync_write("led", {1: 1, 2: 1, 3: 1})
        # the next request can't be on the wire before the bytes of the write are off it
        wire_ns = (8 if protocol == 1.0 else 14) * 10_000 + 3 * 2 * 10_000
        assert bus.read_many([1], "led")[1].t_request_ns == sent_ns + wire_ns
        turn_ns = readings[1].t_reply_ns - readings[1].t_request_ns
        assert turn_ns == (
            16 * 10_000 + 500_000  # 8 bytes there, 8 back at 10 us, return delay 500 us
            if protocol == 1.0
            else 15 * 10_000 + 500_000  # of a sync read: 15 bytes back
        )
        if protocol == 2.0:  # after the 17 bytes of the question each has its turn
            assert readings[1].t_request_ns == before_ns + 17 * 10_000
            assert [readings[k].t_request_ns - readings[1].t_request_ns for k in (2, 3)] == [turn_ns, 2 * turn_ns]


def run_program(model: str, protocol: float) -> tuple[list[tuple[int, bytes]], list[object]]:
    """A client program on a virtual clock: all bytes that the servos sent, and all that the client saw."""
    sent: list[tuple[int, bytes]] = []
    seen: list[object] = []
    clock = VirtualClock()

    def record(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        sent.append((servo_id, reply))
        return ((0, reply),)

    with station(model, protocol, clock=clock, alter_reply=record) as (bus, emulated):
        for id in (1, 2, 3):
            bus.write(id, "torque_enable", 1)
        for k in range(60):
            seen.append(bus.sync_write("goal_position", {1: 400 + 5 * k, 2: 600 - 3 * k, 3: 500}))
            readings = bus.read_many([1, 2, 3], "present_position")
            seen.append(readings)
            seen.append(emulated.shaft_rad(1, readings[1].t_ns))
            clock.sleep_until_ns(20_000_000 * (k + 1) + 50_000_000)
        seen.append(clock.now_ns())
    return sent, seen


@BOTH
def test_on_a_virtual_clock_two_runs_are_the_same_byte_by_byte(model: str, protocol: float) -> None:
    first, second = run_program(model, protocol), run_program(model, protocol)
    assert first[0] == second[0]
    assert first[1] == second[1]
    assert len(first[0]) > 180


@BOTH
@pytest.mark.parametrize(
    ("counted", "change"),
    [
        (True, lambda id, reply: ()),
        (True, lambda id, reply: ((0, reply[:-1] + bytes((reply[-1] ^ 1,))),)),
        (True, lambda id, reply: ((0, reply[:-2]),)),
        (True, lambda id, reply: ((0, status_like(reply, id, b"\1" * 9)), (0, reply))),
        (True, lambda id, reply: ((0, status_like(reply, id, b"")), (0, reply))),
        (True, lambda id, reply: ((0, status_like(reply, 77, b"\1\2\3\4")), (0, reply))),
        (False, lambda id, reply: ((0, bytes(range(17))), (0, reply))),  # the SDK skips what is no packet
        (False, lambda id, reply: ((0, b"\xff\xff\xfd\x00\xff"), (0, reply))),
    ],
    ids=["lost", "checksum", "torn", "oversized", "short", "foreign", "noise", "header"],
)
def test_a_spoilt_reply_gives_no_wrong_value(
    model: str, protocol: float, counted: bool, change: Callable[[int, bytes], Iterable[tuple[int, bytes]]]
) -> None:
    fault = Once(change)
    timeout_s = QUICK_S if counted else PATIENT_S
    with station(model, protocol, alter_reply=fault, timeout_s=timeout_s) as (bus, _):
        bus.write(1, "goal_position", 0x123)
        fault.armed = 1
        assert bus.read(1, "goal_position") == 0x123
        assert bool(sum(bus.errors.values())) == counted
        assert bus.read(1, "return_delay_time") == 250


@BOTH
def test_an_instruction_that_was_damaged_on_the_way_is_sent_again(model: str, protocol: float) -> None:
    error = 16 if protocol == 1.0 else 3  # e-manual, Error: checksum, CRC
    fault = Once(lambda id, reply: ((0, encode_status(id, error, b"", protocol)),))
    with station(model, protocol, alter_reply=fault) as (bus, _):
        bus.model(1)
        fault.armed = 1
        assert bus.read(1, "return_delay_time") == 250
        fault.armed = 1
        bus.write(1, "led", 1)
        assert (bus.read(1, "led"), bus.errors["corrupt"], bus.errors["retries"]) == (1, 2, 2)


def test_replies_in_pieces_are_put_together() -> None:
    with station("XM430-W350", 2.0, fragment_bytes=1) as (bus, _):
        assert bus.read_many([1, 2, 3], "present_position")[3].value == 2048
        assert not any(bus.errors.values())


@BOTH
def test_no_reply_says_who_where_and_what_to_check(model: str, protocol: float) -> None:
    with station(model, protocol, timeout_s=QUICK_S) as (bus, _):
        bus.label(9, "elbow")
        with pytest.raises(NoReply) as caught:
            bus.ping(9)
        assert str(caught.value) == (
            f"no reply from servo 9 (elbow) on {bus.path} at 1000000 baud, protocol {protocol}; "
            "check power and cable, baud and id in rig.toml"
        )
        assert caught.value.servo_id == 9
        assert bus.errors["timeouts"] == 3
        assert bus.errors["retries"] == 2


def test_another_baud_is_no_reply() -> None:
    with station("AX-18A", 1.0, client_baud=400_000, timeout_s=QUICK_S) as (bus, _), pytest.raises(NoReply):
        bus.ping(1)


def test_the_bauds_of_the_ax_can_be_set() -> None:
    clock = VirtualClock()
    for baud in (200_000, 250_000, 400_000):  # the SDK's list has none of them
        servo = EmulatedServo(1, "AX-18A")
        with (
            EmulatedBus([servo], baud=baud, clock=clock) as emulated,
            DynamixelBus(emulated.path, baud=baud, protocol=1.0, clock=clock, reply_timeout_s=PATIENT_S) as bus,
        ):
            assert bus.ping(1) == 18


@BOTH
def test_a_refused_write_names_the_servo_and_the_reason(model: str, protocol: float) -> None:
    with station(model, protocol) as (bus, _):
        bus.label(2, "elbow")
        with pytest.raises(ServoFault, match=r"servo 2 \(elbow\) .* refused writing 5000 to 'goal_position'") as caught:
            bus.write(2, "goal_position", 5000)
        assert caught.value.flags
        assert bus.read(2, "goal_position") == bus.model(2).zero_count  # and the bus goes on


@BOTH
def test_an_alarm_is_noted_and_the_value_is_good(model: str, protocol: float) -> None:
    with station(model, protocol) as (bus, emulated):
        bus.model(1)
        emulated.raise_alarm(1, "overheating")
        assert bus.read(1, "present_temperature") == 32
        assert bus.alarms == {1: ("overheating",) if protocol == 1.0 else ("alert",)}


def test_a_port_that_is_not_there_says_so() -> None:
    bus = DynamixelBus("/dev/ttyNOWHERE9", baud=1_000_000, protocol=1.0, clock=VirtualClock())
    with pytest.raises(BusLost, match="no port /dev/ttyNOWHERE9"):
        bus.open()
    with pytest.raises(BusLost, match=r"isn't open; call open\(\) first"):
        bus.ping(1)
    with pytest.raises(DriverError, match="no protocol 3"):
        DynamixelBus("/dev/null", baud=1_000_000, protocol=3.0, clock=VirtualClock())


def test_a_file_is_no_port(tmp_path: object) -> None:
    path = f"{tmp_path}/plain"
    with open(path, "w"):  # noqa: PTH123
        pass
    with pytest.raises(BusLost, match="can't be opened as a serial port"):
        DynamixelBus(path, baud=1_000_000, protocol=1.0, clock=VirtualClock()).open()


def test_a_port_is_held_by_one_program() -> None:
    with station("AX-18A", 1.0) as (bus, _):
        other = DynamixelBus(bus.path, baud=1_000_000, protocol=1.0, clock=VirtualClock())
        with pytest.raises(BusLost, match="is held by another program; close that first"):
            other.open()


def test_the_program_that_holds_a_port_is_named() -> None:
    program = """if True:
        import sys, serial
        port = serial.Serial(sys.argv[1], exclusive=True)
        print("open", flush=True)
        sys.stdin.readline()
    """
    with EmulatedBus([EmulatedServo(1, "AX-18A")], clock=VirtualClock()) as emulated:
        command = [sys.executable, "-c", program, emulated.path]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
            assert holder.stdout is not None and holder.stdout.readline() == "open\n"
            bus = DynamixelBus(emulated.path, baud=1_000_000, protocol=1.0, clock=VirtualClock())
            with pytest.raises(BusLost, match=rf"is held by pid {holder.pid} \(.*python"):
                bus.open()
            holder.communicate("\n")
        bus.open()
        bus.close()


def test_two_threads_share_the_bus() -> None:
    with station("XM430-W350", 2.0) as (bus, _):
        wrong: list[object] = []

        def ask(servo_id: int) -> None:
            for _ in range(100):
                number = bus.read(servo_id, "id")
                if number != servo_id:
                    wrong.append(number)

        threads = [threading.Thread(target=ask, args=(id,)) for id in (1, 2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not wrong
        assert not any(bus.errors.values())


def test_on_the_real_clock_the_default_deadline_does() -> None:
    clock = MonotonicClock()
    with (
        EmulatedBus([EmulatedServo(1, "AX-18A")], baud=1_000_000, clock=clock) as emulated,
        DynamixelBus(emulated.path, baud=1_000_000, protocol=1.0, clock=clock) as bus,
    ):
        t_ns = clock.now_ns()
        reading = bus.read_many([1], "present_position")[1]
        assert reading.value == 512
        assert t_ns <= reading.t_request_ns < reading.t_reply_ns <= clock.now_ns()
        assert reading.t_reply_ns - reading.t_request_ns >= 660_000  # the wire time and the return delay pass
