"""The emulated bus as a device: its path stays, its plug comes out, and nothing is left after it."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from drivers.clock import MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.errors import BusLost, DriverError, NoPort
from drivers.packets import Instruction
from tests.drivers.line import Line


def bus_at(link: Path | None = None) -> EmulatedBus:
    return EmulatedBus([EmulatedServo(1, "XM430-W350")], baud=1_000_000, clock=VirtualClock(), link=link)


def client_of(bus: EmulatedBus) -> DynamixelBus:
    return DynamixelBus(bus.path, baud=1_000_000, protocol=2.0, clock=VirtualClock(), reply_timeout_s=5.0)


def test_after_a_replug_the_device_is_at_the_same_path_and_the_servos_have_kept_their_power() -> None:
    with bus_at() as bus:
        path = bus.path
        line = Line(bus, 2.0)
        line.ask(1, Instruction.WRITE, "40 00 01")
        bus.unplug()
        line.close()
        assert bus.path == path and not os.path.lexists(path)
        bus.replug()
        line = Line(bus, 2.0)
        assert line.ask(1, Instruction.READ, "40 00 01 00") == [(1, 0, b"\x01")]
        line.close()


def test_a_client_finds_the_device_gone_and_its_port_missing() -> None:
    with bus_at() as bus:
        with client_of(bus) as client:
            client.ping(1)
            bus.unplug()
            with pytest.raises(BusLost):
                client.ping(1)
        with pytest.raises(NoPort), client_of(bus):
            pass
        bus.replug()
        with client_of(bus) as client:
            client.ping(1)


def test_a_client_that_waits_for_a_reply_finds_the_device_gone() -> None:
    with bus_at() as bus, client_of(bus) as client:
        timer = threading.Timer(0.1, bus.unplug)
        timer.start()
        with pytest.raises(BusLost):
            client.ping(9)  # nobody has this id
        timer.join()


def test_unplug_and_replug_are_no_matter_twice() -> None:
    with bus_at() as bus:
        bus.unplug()
        bus.unplug()
        bus.replug()
        bus.replug()
        with client_of(bus) as client:
            client.ping(1)
    with pytest.raises(DriverError, match="isn't started"):
        bus.unplug()


@pytest.mark.parametrize("unplugged", [False, True])
def test_the_link_is_gone_after_close(tmp_path: Path, unplugged: bool) -> None:
    link = tmp_path / "ttyARM"
    with bus_at(link) as bus:
        assert bus.path == str(link) and link.is_symlink()
        if unplugged:
            bus.unplug()
    assert not link.is_symlink()
    with bus_at() as bus:
        folder = Path(bus.path).parent
        if unplugged:
            bus.unplug()
    assert not folder.exists()


def test_a_dead_link_is_replaced_and_anything_else_is_left_alone(tmp_path: Path) -> None:
    link = tmp_path / "ttyARM"
    link.symlink_to("/dev/pts/999999")
    with bus_at(link) as bus, client_of(bus) as client:
        client.ping(1)
    link.write_text("mine", encoding="utf-8")
    with pytest.raises(DriverError, match="ttyARM exists; name another path"):
        bus_at(link).start()
    assert link.read_text(encoding="utf-8") == "mine"
    with pytest.raises(DriverError, match="can't make the link"):
        bus_at(tmp_path / "no" / "folder").start()


def test_a_bus_that_is_closed_can_be_started_again() -> None:
    bus = bus_at()
    for _ in range(2):
        with bus, client_of(bus) as client:
            client.ping(1)


def test_two_hundred_unpluggings_leave_nothing() -> None:
    clock = MonotonicClock()
    bus = EmulatedBus([EmulatedServo(1, "XM430-W350")], baud=1_000_000, clock=clock)
    with bus:
        before = threading.active_count(), len(os.listdir("/proc/self/fd"))  # noqa: PTH208
        for _ in range(200):
            bus.unplug()
            bus.replug()
        assert (threading.active_count(), len(os.listdir("/proc/self/fd"))) == before  # noqa: PTH208
