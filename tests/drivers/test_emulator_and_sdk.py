"""The real SDK (dynamixel-sdk 4.1.0), as it is, talks to the emulated bus: groups, fast or not, both protocols."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import dynamixel_sdk as sdk
import pytest

from drivers.clock import VirtualClock
from drivers.emulator import EmulatedBus, EmulatedServo
from tests.drivers.line import PatientPort

X = (("XL430-W250", 2), ("XM540-W270", 4), ("XC330-T288", 5))
COUNTS = {2: 166, 4: 2079, 5: 1023}
POSITION, TEMPERATURE, LED = 132, 146, 65


@contextmanager
def port() -> Iterator[sdk.PortHandler]:
    servos = [EmulatedServo(id, model, initial_count=COUNTS[id]) for model, id in X]
    servos += [EmulatedServo(1, "AX-12A", initial_count=300), EmulatedServo(3, "MX-28", initial_count=4000)]
    with EmulatedBus(servos, baud=1_000_000, clock=VirtualClock()) as bus:
        handler = PatientPort(bus.path)
        assert handler.openPort()
        try:
            yield handler
        finally:
            handler.closePort()


def test_single_instructions_of_both_protocols() -> None:
    first, second = sdk.PacketHandler(1.0), sdk.PacketHandler(2.0)
    with port() as handler:
        for _ in range(3):
            assert first.ping(handler, 1) == (12, sdk.COMM_SUCCESS, 0)
            assert second.ping(handler, 4) == (1120, sdk.COMM_SUCCESS, 0)
            assert first.read2ByteTxRx(handler, 1, 36) == (300, sdk.COMM_SUCCESS, 0)
            assert second.read4ByteTxRx(handler, 2, POSITION) == (166, sdk.COMM_SUCCESS, 0)
        assert second.write1ByteTxRx(handler, 5, LED, 1) == (sdk.COMM_SUCCESS, 0)
        assert second.read1ByteTxRx(handler, 5, LED) == (1, sdk.COMM_SUCCESS, 0)
        assert second.clearMultiTurn(handler, 5) == (sdk.COMM_SUCCESS, 0)
        assert second.reboot(handler, 5) == (sdk.COMM_SUCCESS, 0)
        assert second.read1ByteTxRx(handler, 5, LED) == (0, sdk.COMM_SUCCESS, 0)
        assert second.factoryReset(handler, 5, 0x02) == (sdk.COMM_SUCCESS, 0)


def test_broadcast_ping_finds_the_servos_of_protocol_2() -> None:
    with port() as handler:
        found, result = sdk.PacketHandler(2.0).broadcastPing(handler)
    assert result == sdk.COMM_SUCCESS
    assert {id: model for id, (model, _) in found.items()} == {2: 1060, 4: 1120, 5: 1220}


@pytest.mark.parametrize("fast", [False, True])
def test_sync_read(fast: bool) -> None:
    with port() as handler:
        group = sdk.GroupSyncRead(handler, sdk.PacketHandler(2.0), POSITION, 4)
        for id in COUNTS:
            assert group.addParam(id)
        assert (group.fastSyncRead() if fast else group.txRxPacket()) == sdk.COMM_SUCCESS
        assert {id: group.getData(id, POSITION, 4) for id in COUNTS} == COUNTS


@pytest.mark.parametrize("fast", [False, True])
def test_bulk_read(fast: bool) -> None:
    with port() as handler:
        group = sdk.GroupBulkRead(handler, sdk.PacketHandler(2.0))
        assert group.addParam(2, POSITION, 4)
        assert group.addParam(5, TEMPERATURE, 1)
        assert group.addParam(4, POSITION, 4)
        assert (group.fastBulkRead() if fast else group.txRxPacket()) == sdk.COMM_SUCCESS
        assert group.getData(2, POSITION, 4) == 166
        assert group.getData(5, TEMPERATURE, 1) == 32
        assert group.getData(4, POSITION, 4) == 2079


def test_a_fast_read_has_no_byte_stuffing() -> None:
    """FF FF FD in it comes as it is: the SDK doesn't take stuffing out of a fast read (e-manual, Fast Sync Read)."""
    model = "XL430-W250"
    servo = EmulatedServo(1, model)
    servo.set("goal_position", int.from_bytes(b"\xff\xff\xfd\x00", "little"))
    with EmulatedBus([servo], baud=1_000_000, clock=VirtualClock()) as bus:
        handler = PatientPort(bus.path)
        assert handler.openPort()
        group = sdk.GroupSyncRead(handler, sdk.PacketHandler(2.0), 116, 4)
        group.addParam(1)
        assert group.fastSyncRead() == sdk.COMM_SUCCESS
        assert group.getData(1, 116, 4).to_bytes(4, "little") == b"\xff\xff\xfd\x00"
        assert group.txRxPacket() == sdk.COMM_SUCCESS  # stuffed, and taken out again
        assert group.getData(1, 116, 4).to_bytes(4, "little") == b"\xff\xff\xfd\x00"
        handler.closePort()


def test_sync_write_and_bulk_write() -> None:
    with port() as handler:
        second = sdk.PacketHandler(2.0)
        together = sdk.GroupSyncWrite(handler, second, LED, 1)
        for id in COUNTS:
            assert together.addParam(id, [1])
        assert together.txPacket() == sdk.COMM_SUCCESS
        assert [second.read1ByteTxRx(handler, id, LED)[0] for id in COUNTS] == [1, 1, 1]
        each = sdk.GroupBulkWrite(handler, second)
        assert each.addParam(2, LED, 1, [0]) and each.addParam(5, 112, 4, [7, 0, 0, 0])
        assert each.txPacket() == sdk.COMM_SUCCESS
        assert second.read1ByteTxRx(handler, 2, LED)[0] == 0
        assert second.read4ByteTxRx(handler, 5, 112)[0] == 7


def test_sync_write_and_bulk_read_of_protocol_1() -> None:
    first = sdk.PacketHandler(1.0)
    with port() as handler:
        group = sdk.GroupSyncWrite(handler, first, 25, 1)
        assert group.addParam(1, [1]) and group.addParam(3, [1])
        assert group.txPacket() == sdk.COMM_SUCCESS
        assert first.read1ByteTxRx(handler, 3, 25)[0] == 1
        # GroupBulkRead of protocol 1.0 raises TypeError in this SDK: its own calls are used.
        assert first.bulkReadTx(handler, [2, 3, 36], 3) == sdk.COMM_SUCCESS
        assert first.readRx(handler, 3, 2)[0] == [4000 & 0xFF, 4000 >> 8]
