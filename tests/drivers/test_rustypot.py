"""An independent client, rustypot (its own codec, in Rust), talks to the emulated bus."""

from __future__ import annotations

import math

import pytest

from drivers.clock import VirtualClock
from drivers.emulated_bus import EmulatedBus
from drivers.emulated_servo import EmulatedServo

rustypot = pytest.importorskip("rustypot")

TIMEOUT_S = 5.0  # a reply takes microseconds; a stalled machine must not fail the test


def test_protocol_2_ping_torque_sync_write_sync_read() -> None:
    clock = VirtualClock()
    servos = [EmulatedServo(id, "XL430-W250") for id in (1, 2, 3)]
    with EmulatedBus(servos, baud=1_000_000, clock=clock) as bus:
        client = rustypot.Xl430PyController(bus.path, 1_000_000, TIMEOUT_S)
        assert all(client.ping(id) for id in (1, 2, 3))
        for id in (1, 2, 3):
            client.write_torque_enable(id, True)
        assert client.sync_read_present_position([1, 2, 3]) == [2048, 2048, 2048]
        goals = [2400, 1700, 2700]
        client.sync_write_goal_position([1, 2, 3], goals)
        client.sync_read_present_position([1])  # the sync write has arrived when this is answered
        clock.sleep_until_ns(clock.now_ns() + 3_000_000_000)
        assert client.sync_read_present_position([1, 2, 3]) == goals
        shafts = [bus.shaft_rad(id, clock.now_ns()) for id in (1, 2, 3)]
        assert shafts == pytest.approx([(goal - 2048) * 2 * math.pi / 4096 for goal in goals], abs=1e-9)  # rounding
        del client


def test_protocol_1_reads_of_ax() -> None:
    clock = VirtualClock()
    with EmulatedBus([EmulatedServo(1, "AX-18A", initial_count=700)], baud=1_000_000, clock=clock) as bus:
        client = rustypot.AxPyController(bus.path, 1_000_000, TIMEOUT_S)
        assert client.ping(1)
        assert client.read_raw_present_position(1) in (700, [700])
        assert client.read_present_temperature(1) in (32, [32])
        client.write_torque_enable(1, True)
        assert client.read_torque_enable(1) in (1, True, [1], [True])
        del client


def test_fast_sync_read() -> None:
    servos = [EmulatedServo(id, "XL330-M288", initial_count=1000 * id) for id in (1, 2, 3)]
    with EmulatedBus(servos, baud=1_000_000, clock=VirtualClock()) as bus:
        client = rustypot.Xl330PyController(bus.path, 1_000_000, TIMEOUT_S)
        client.set_fast_sync_read(True)
        fast = client.sync_read_present_position([3, 1, 2])
        client.set_fast_sync_read(False)
        assert fast == client.sync_read_present_position([3, 1, 2])
        assert client.sync_read_present_temperature([2, 3]) == [32, 32]
        del client


def test_both_protocols_on_one_wire() -> None:
    servos = [EmulatedServo(1, "AX-12A", initial_count=700), EmulatedServo(2, "XL430-W250", initial_count=2048)]
    with EmulatedBus(servos, baud=1_000_000, clock=VirtualClock()) as bus:
        ax = rustypot.AxPyController(bus.path, 1_000_000, TIMEOUT_S)
        assert ax.ping(1)
        del ax
        x = rustypot.Xl430PyController(bus.path, 1_000_000, TIMEOUT_S)
        assert x.sync_read_present_position([2]) == [2048]
        del x
