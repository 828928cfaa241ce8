"""What is told of serial ports, by made devices, programs and drivers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.errors import NoPort
from drivers.serial_ports import (
    Holder,
    User,
    check_free,
    describe_ports,
    find_access,
    find_holders,
    list_ports,
    read_latency_ms,
)

NOBODY = User("nobody", 65534, frozenset({65534}))


def test_lasting_names_come_first_and_numbers_in_order(tmp_path: Path):
    by_id = tmp_path / "serial" / "by-id"
    by_id.mkdir(parents=True)
    for name in ("ttyUSB10", "ttyUSB2", "ttyACM0", "ttyS0"):
        (tmp_path / name).touch()
    (by_id / "usb-FTDI_U2D2-if00").symlink_to(tmp_path / "ttyUSB2")
    names = [Path(port).name for port in list_ports(tmp_path)]
    assert names == ["usb-FTDI_U2D2-if00", "ttyUSB2", "ttyUSB10", "ttyACM0"]


def test_a_port_that_is_not_there_lists_those_that_are(tmp_path: Path):
    (tmp_path / "ttyACM3").touch()
    with pytest.raises(NoPort, match=r"no port /dev/gone; ports here: .*ttyACM3"):
        check_free("/dev/gone", dev=tmp_path)
    assert "is the adapter plugged in" in describe_ports(tmp_path / "empty")


def test_a_port_held_by_another_program_names_it(tmp_path: Path):
    port = tmp_path / "ttyUSB0"
    port.touch()
    code = f"import sys; f = open({str(port)!r}); print('open', flush=True); sys.stdin.read()"
    arguments = [sys.executable, "-c", code]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "open\n"
        (holder,) = find_holders(str(port))
        assert holder.pid == other.pid and holder.command.startswith(sys.executable)
        with pytest.raises(NoPort, match=rf"is held by pid {other.pid} \(.*python"):
            check_free(str(port))
        other.communicate()
    check_free(str(port))


def made_program(proc: Path, pid: int, command: str, *files: str) -> None:
    (proc / str(pid) / "fd").mkdir(parents=True)
    (proc / str(pid) / "cmdline").write_bytes(command.replace(" ", "\0").encode() + b"\0")
    (proc / str(pid) / "comm").write_text(command.split()[0])
    for number, file in enumerate(files):
        (proc / str(pid) / "fd" / str(number)).symlink_to(file)


def test_this_program_and_the_emulator_behind_a_pseudo_terminal_hold_nothing(tmp_path: Path):
    made_program(tmp_path, 7, "screen /dev/pts/9", "/dev/pts/9", "/dev/null")
    made_program(tmp_path, 8, "station emulate demo", "/dev/ptmx", "/dev/pts/9")
    made_program(tmp_path, os.getpid(), "station scan", "/dev/pts/9")
    made_program(tmp_path, 12, "cat x", "/dev/pts/1")
    assert find_holders("/dev/pts/9", tmp_path) == [Holder(7, "screen /dev/pts/9")]


def test_permissions_are_those_of_the_group(tmp_path: Path):
    port = tmp_path / "ttyUSB0"
    port.touch()
    port.chmod(0o660)
    gid = port.stat().st_gid
    assert not find_access(str(port), NOBODY).allowed
    assert find_access(str(port), User("guest", 4711, frozenset({gid}))).allowed
    port.chmod(0o640)
    assert not find_access(str(port), User("guest", 4711, frozenset({gid}))).allowed
    assert find_access(str(port), User("root", 0, frozenset())).allowed


def test_the_latency_timer_is_of_the_device_behind_a_link(tmp_path: Path):
    device = tmp_path / "ttyUSB3"
    device.touch()
    link = tmp_path / "by-id"
    link.symlink_to(device)
    folder = tmp_path / "sys" / "bus" / "usb-serial" / "devices" / "ttyUSB3"
    folder.mkdir(parents=True)
    (folder / "latency_timer").write_text("16\n")
    assert read_latency_ms(str(link), tmp_path / "sys") == 16
    assert read_latency_ms("/dev/ttyACM0", tmp_path / "sys") is None
