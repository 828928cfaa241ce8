"""Each defect of the SDK (dynamixel-sdk 4.1.0), first as the SDK has it, then that the driver doesn't let it through.

If a later SDK mends one, the first half of its test fails: the fence may go then.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import dynamixel_sdk as sdk
import pytest

from drivers.clock import MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.emulator.bus import AlterReply
from drivers.errors import BusLost, CorruptReply, DriverError, NoReply, ServoFault
from drivers.packets import Instruction, encode_instruction, encode_status
from drivers.sdk_fence import FencedPort, FencedProtocol2

BAUD = 1_000_000
MODEL = {1.0: "AX-18A", 2.0: "XM430-W350"}
REPLY_MS = 34  # the SDK's deadline beside the wire time


@contextmanager
def emulated(protocol: float, *, real: bool = False, alter_reply: AlterReply | None = None) -> Iterator[EmulatedBus]:
    servos = [EmulatedServo(id, MODEL[protocol], protocol=protocol) for id in (1, 2, 3)]
    for servo in servos if protocol == 2.0 else ():
        servo.set("velocity_limit", 0x7FFFFFFF)  # so that goal_velocity takes any four bytes
    clock = MonotonicClock() if real else VirtualClock()
    with EmulatedBus(servos, baud=BAUD, clock=clock, alter_reply=alter_reply) as bus:
        yield bus


@contextmanager
def raw_sdk(path: str) -> Iterator[sdk.PortHandler]:
    port = sdk.PortHandler(path)
    port.openPort()
    try:
        yield port
    finally:
        port.closePort()


def driver(path: str, protocol: float, timeout_s: float = 5.0) -> DynamixelBus:
    return DynamixelBus(path, baud=BAUD, protocol=protocol, clock=VirtualClock(), reply_timeout_s=timeout_s)


@contextmanager
def wire() -> Iterator[tuple[str, int]]:
    """A bare pseudo-terminal: the path of one end, the descriptor of the other."""
    far, near = os.openpty()
    tty.setraw(near)
    try:
        yield os.ttyname(near), far
    finally:
        os.close(far)
        os.close(near)


def test_protocol_1_bulk_read_fails_in_the_sdk() -> None:
    with emulated(1.0) as bus:
        with raw_sdk(bus.path) as port:
            group = sdk.GroupBulkRead(port, sdk.PacketHandler(1.0))
            group.addParam(1, 36, 2)
            with pytest.raises(TypeError):
                group.txRxPacket()
        with driver(bus.path, 1.0) as client:
            assert client.read_many([1, 2], "present_position")[2].value == 512


def test_what_is_sent_is_stuffed() -> None:
    value = 0x00FDFFFF  # FF FF FD 00, a header, as it would go out raw
    stuffed = encode_instruction(1, Instruction.WRITE, b"\x68\x00\xff\xff\xfd\x00", 2.0)
    assert b"\xff\xff\xfd\xfd" in stuffed
    with wire() as (path, far):
        with raw_sdk(path) as port:
            sdk.PacketHandler(2.0).write4ByteTxOnly(port, 1, 104, value)
            assert os.read(far, 100) != stuffed
        port = FencedPort(path, BAUD, None)
        port.openPort()
        FencedProtocol2().writeTxOnly(port, 1, 104, 4, list(value.to_bytes(4, "little")))
        assert os.read(far, 100) == stuffed
        port.closePort()
    with emulated(2.0) as bus, driver(bus.path, 2.0) as client:
        client.sync_write("goal_velocity", {1: value, 2: value})
        client.write(3, "goal_velocity", value)
        assert [client.read(id, "goal_velocity") for id in (1, 2, 3)] == [value] * 3


def test_what_is_received_is_unstuffed_whole() -> None:
    data = bytes.fromhex("ff ff fd ff fd fd")
    reply = encode_status(1, 0, data, 2.0)
    with wire() as (path, far):
        with raw_sdk(path) as port:
            handler = sdk.PacketHandler(2.0)
            handler.readTx(port, 1, 116, 6)
            os.write(far, reply)
            assert bytes(handler.readRx(port, 1, 6)[0]) != data
        port = FencedPort(path, BAUD, 1.0)
        port.openPort()
        handler = FencedProtocol2()
        handler.readTx(port, 1, 116, 6)
        os.write(far, reply)
        status, _ = handler.receive(port)
        assert status is not None
        assert status.parameters == data
        port.closePort()


@pytest.mark.parametrize("protocol", [1.0, 2.0])
def test_an_exception_leaves_the_port_usable(protocol: float) -> None:
    with emulated(protocol) as bus:
        with raw_sdk(bus.path) as port:
            handler = sdk.PacketHandler(protocol)
            with pytest.raises((ValueError, TypeError)):
                handler.write1ByteTxRx(port, 1, 65, 300)
            assert handler.ping(port, 1)[1] == sdk.COMM_PORT_BUSY
        with driver(bus.path, protocol) as client:
            with pytest.raises(DriverError, match="300 doesn't fit in register 'led'"):
                client.write(1, "led", 300)

            def fail() -> int:
                client._port.is_using = True
                raise ValueError("as the SDK does in mid-exchange")

            with pytest.raises(ValueError, match="mid-exchange"):
                client._line._transmit(fail)
            assert client.read(1, "led") == 0


@pytest.mark.parametrize("protocol", [1.0, 2.0])
def test_a_lost_device_is_one_error(protocol: float) -> None:
    with emulated(protocol) as bus:
        client = driver(bus.path, protocol)
        client.open()
        assert client.ping(1)
        bus.close()
        for call in (
            lambda: client.read(1, "led"),
            lambda: client.write(1, "led", 1),
            lambda: client.ping(1),
            lambda: client.sync_write("led", {1: 1}),
            lambda: client.read_many([1], "led"),
        ):
            with pytest.raises(BusLost):
                call()
        client.close()
        bus.start()  # plugged in again
        with driver(bus.path, protocol) as again:
            assert again.ping(1)


def test_a_device_lost_while_waiting_is_lost_at_once() -> None:
    with emulated(2.0, alter_reply=lambda id, reply: ()) as bus, driver(bus.path, 2.0, timeout_s=60.0) as client:
        unplug = threading.Timer(0.05, bus.close)
        unplug.start()
        with pytest.raises(BusLost, match="is gone"):
            client.ping(1)
        unplug.join()


@pytest.mark.parametrize(("protocol", "error"), [(1.0, 8), (2.0, 7)])
def test_an_error_without_data_is_no_value(protocol: float, error: int) -> None:
    def refuse(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        refused = len(reply) == (8 if protocol == 1.0 else 13)  # two bytes of data
        return ((0, encode_status(servo_id, error, b"", protocol) if refused else reply),)

    with emulated(protocol, alter_reply=refuse) as bus:
        address = 36 if protocol == 1.0 else 144
        with raw_sdk(bus.path) as port:
            handler = sdk.PacketHandler(protocol)
            if protocol == 1.0:
                with pytest.raises(IndexError):
                    handler.read2ByteTxRx(port, 1, address)
            else:
                value, comm, _ = handler.read2ByteTxRx(port, 1, address)
                assert (value != 0, comm) == (True, sdk.COMM_SUCCESS)  # the checksum, as a value
        with driver(bus.path, protocol) as client:
            client._models[1] = EmulatedServo(1, MODEL[protocol]).model
            register = "present_position" if protocol == 1.0 else "present_input_voltage"
            with pytest.raises(ServoFault):
                client.read(1, register)


@pytest.mark.parametrize("protocol", [1.0, 2.0])
def test_a_late_reply_answers_no_other_question_of_the_driver(protocol: float) -> None:
    held, release = [False], threading.Event()

    def hold(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        if held[0]:
            held[0] = False
            release.wait(10.0)
        return ((0, reply),)

    speed = "moving_speed" if protocol == 1.0 else "profile_velocity"  # 0; the goal is 512 or 2048
    with emulated(protocol, alter_reply=hold) as bus, driver(bus.path, protocol, timeout_s=0.05) as client:
        client.model(1)
        held[0] = True
        with pytest.raises(NoReply):
            client.read(1, speed)
        client._port._reply_timeout_s = 5.0
        write = client._port.writePort

        def write_then_release(packet: list[int]) -> int:
            sent = write(packet)
            release.set()  # the late replies come after the next question, and after the flush before it
            return sent

        client._port.writePort = write_then_release  # type: ignore[method-assign]
        for _ in range(5):
            assert client.read(1, "goal_position") == (512 if protocol == 1.0 else 2048)
        assert client.errors["unexpected"] > 0


@pytest.mark.parametrize("protocol", [1.0, 2.0])
def test_a_late_reply_answers_another_question_of_the_sdk(protocol: float) -> None:
    handler = sdk.PacketHandler(protocol)
    with wire() as (path, far), raw_sdk(path) as port:
        assert handler.read2ByteTxRx(port, 1, 32)[1] == sdk.COMM_RX_TIMEOUT
        handler.read2ByteTx(port, 1, 36)
        os.write(far, encode_status(1, 0, b"\x11\x22", protocol))  # of 32, for 36
        assert handler.read2ByteRx(port, 1) == (0x2211, sdk.COMM_SUCCESS, 0)


def test_a_reply_that_came_in_time_counts_though_it_is_read_late() -> None:
    with wire() as (path, far):
        port = FencedPort(path, BAUD, 0.0)  # this process was stopped: the deadline is over when it looks
        port.openPort()
        handler = FencedProtocol2()
        handler.readTx(port, 1, 116, 4)
        os.write(far, encode_status(1, 0, b"\1\2\3\4", 2.0))
        status, _ = handler.receive(port)
        assert status is not None
        assert status.parameters == b"\1\2\3\4"
        port.closePort()


@pytest.mark.parametrize("protocol", [1.0, 2.0])
def test_a_babbling_line_ends_at_the_deadline(protocol: float) -> None:
    with wire() as (path, far):
        stop = threading.Event()
        os.set_blocking(far, False)

        def babble() -> None:
            while not stop.is_set():
                with contextlib.suppress(BlockingIOError):
                    os.write(far, b"\xff\x00\xfd" * 300)

        thread = threading.Thread(target=babble)
        thread.start()
        try:
            with driver(path, protocol, timeout_s=0.05) as client, pytest.raises((NoReply, CorruptReply)):
                client.ping(1)
        finally:
            stop.set()
            thread.join()


def test_one_missing_reply_costs_no_other_value() -> None:
    drop = [False]

    def lose_servo_2(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        lost, drop[0] = drop[0] and servo_id == 2, drop[0] and servo_id != 2
        return () if lost else ((0, reply),)

    with emulated(2.0, alter_reply=lose_servo_2) as bus:
        with raw_sdk(bus.path) as port:
            group = sdk.GroupSyncRead(port, sdk.PacketHandler(2.0), 132, 4)
            for id in (1, 2, 3):
                group.addParam(id)
            drop[0] = True
            assert group.txRxPacket() != sdk.COMM_SUCCESS
            assert not group.isAvailable(1, 132, 4)  # though servo 1 did answer
        with driver(bus.path, 2.0, timeout_s=0.2) as client:
            for id in (1, 2, 3):
                client.model(id)
            drop[0] = True
            readings = client.read_many([1, 2, 3], "present_position")
            assert [readings[id].value for id in (1, 2, 3)] == [2048] * 3
            assert client.errors["fallbacks"] == 1
            with pytest.raises(NoReply, match="servo 9"):
                client._models[9] = client.model(1)
                client.read_many([1, 9], "present_position")


def test_a_step_of_the_wall_clock_is_no_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    step_s = [0.0]
    wall_s = time.time

    def stepping() -> float:
        step_s[0] += 1000.0
        return wall_s() + step_s[0]

    with emulated(2.0, alter_reply=lambda id, reply: ((0, reply[:5]), (0, reply[5:]))) as bus:
        with driver(bus.path, 2.0) as client:
            monkeypatch.setattr(time, "time", stepping)
            assert [client.read(1, "id") for _ in range(20)] == [1] * 20
            assert client.errors["timeouts"] == 0
        with raw_sdk(bus.path) as port:
            handler = sdk.PacketHandler(2.0)
            assert any(handler.read1ByteTxRx(port, 1, 7)[1] != sdk.COMM_SUCCESS for _ in range(20))


def test_waiting_is_not_spinning(monkeypatch: pytest.MonkeyPatch) -> None:
    waits = [0]
    real_select = select.select

    def counting(*arguments: object) -> object:
        if threading.current_thread().name.startswith("bus "):  # the driver's own
            waits[0] += 1
        return real_select(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(select, "select", counting)
    with emulated(2.0, alter_reply=lambda id, reply: ()) as bus, driver(bus.path, 2.0, timeout_s=0.1) as client:
        with pytest.raises(NoReply):
            client.ping(1)
        assert 0 < waits[0] < 20  # the SDK asks thousands of times


def test_a_missing_port_and_an_unopened_one_are_driver_errors() -> None:
    import serial

    with pytest.raises(serial.SerialException):
        sdk.PortHandler("/dev/ttyNOWHERE9").openPort()
    with pytest.raises(AttributeError):
        sdk.PacketHandler(2.0).ping(sdk.PortHandler("/dev/ttyNOWHERE9"), 1)
    client = driver("/dev/ttyNOWHERE9", 2.0)
    for call in (client.open, lambda: client.ping(1)):
        with pytest.raises(BusLost):
            call()
    client.close()


def test_negative_values_stay_negative() -> None:
    with emulated(2.0) as bus:
        with driver(bus.path, 2.0) as client:
            client.write(1, "homing_offset", -100)
            assert client.read(1, "homing_offset") == -100
            assert client.read_many([1, 2], "homing_offset")[1].value == -100
        with raw_sdk(bus.path) as port:
            assert sdk.PacketHandler(2.0).read4ByteTxRx(port, 1, 20)[0] == 4294967196


def test_the_baud_that_is_asked_for_is_set() -> None:
    with wire() as (path, _), raw_sdk(path) as port:
        assert port.setBaudRate(250_000) is False
        assert port.getBaudRate() == 1_000_000  # the old one is still active
    with wire() as (path, _):
        fenced = FencedPort(path, 250_000, None)
        fenced.openPort()
        assert fenced.ser.baudrate == 250_000
        fenced.closePort()


def test_an_oversized_group_write_is_split() -> None:
    data = {id: 1 for id in range(1, 251)}  # 5 bytes each in the raw write; the SDK sends 1024 at most
    with emulated(2.0) as bus:
        with raw_sdk(bus.path) as port:
            group = sdk.GroupSyncWrite(port, sdk.PacketHandler(2.0), 116, 4)
            for id in data:
                group.addParam(id, [0, 4, 0, 0])
            with pytest.raises(IndexError):
                group.txPacket()
        with driver(bus.path, 2.0) as client:
            model = client.model(1)
            client._models.update(dict.fromkeys(data, model))
            client.sync_write("led", data)
            assert [client.read(id, "led") for id in (1, 2, 3)] == [1, 1, 1]
