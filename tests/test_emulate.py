"""`station emulate` as other programs meet it: a real process, and the real SDK as its client."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import dynamixel_sdk as sdk
import pytest

from station.formats.rig import RigTable
from station.rig_reading import joint_configs, packaged_names, read_rig
from tests.drivers.line import PatientPort

ROOT = Path(__file__).parent.parent
PATIENCE_S = 60
COMMAND = [sys.executable, "-c", "from station.cli import main; main()", "emulate"]


def environment(tmp: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp)}


@contextmanager
def emulated(tmp: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A running emulator and its device; it is stopped if the test hasn't."""
    process = subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(tmp)
    )
    try:
        assert process.stdout is not None
        path = process.stdout.readline().strip()
        assert path, process.stderr.read() if process.stderr else ""
        yield process, path
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)


@contextmanager
def client(path: str) -> Iterator[sdk.PortHandler]:
    port = PatientPort(path)
    assert port.openPort()
    try:
        yield port
    finally:
        port.closePort()


def run(tmp: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=environment(tmp)
    )


def check_servos(table: RigTable, port: sdk.PortHandler) -> None:
    """Each servo of the rig answers with its model, and stands where the park pose is; nothing else is set."""
    handler = sdk.PacketHandler(table.bus.protocol)
    for joint, limits in zip(joint_configs(table), table.limits(), strict=True):
        for servo in joint.servos:
            assert handler.ping(port, servo.id) == (servo.table.model_number, sdk.COMM_SUCCESS, 0)
            at = servo.table.registers["present_position"]
            read = handler.read4ByteTxRx if at.size == 4 else handler.read2ByteTxRx
            assert read(port, servo.id, at.address)[0] == servo.count(limits.park)
            for name in ("torque_enable", "status_return_level", "return_delay_time"):
                register = servo.table.registers[name]
                assert handler.read1ByteTxRx(port, servo.id, register.address)[0] == register.initial, name


@pytest.mark.parametrize("name", packaged_names("rigs"))
def test_every_packaged_rig_is_there_for_another_client(name: str, tmp_path: Path) -> None:
    table = read_rig(name)[0]
    with emulated(tmp_path, name) as (_, path), client(path) as port:
        port.setBaudRate(table.bus.baud)
        check_servos(table, port)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it_and_nothing_is_left(number: signal.Signals, code: int, tmp_path: Path) -> None:
    link = tmp_path / "ttyARM"
    with emulated(tmp_path, "demo", "--link", str(link)) as (process, path):
        assert path == str(link) and link.is_symlink()
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == code and out == "" and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_without_a_link_its_folder_is_gone_too(tmp_path: Path) -> None:
    with emulated(tmp_path, "demo") as (process, path):
        assert Path(path).is_relative_to(tmp_path)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 143 and list(tmp_path.iterdir()) == []


def test_an_interrupt_is_heard_also_where_the_shell_has_it_ignored(tmp_path: Path) -> None:
    shell = ["sh", "-c", "trap '' INT; exec \"$@\"", "sh", *COMMAND, "demo"]
    with subprocess.Popen(shell, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment(tmp_path)) as process:
        assert process.stdout is not None and process.stdout.readline()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130


def test_faults_befall_the_client(tmp_path: Path) -> None:
    faults = ("--faults", "mute:2", "--faults", "alert:3=overload bad_crc:4", "--seed", "3")
    with emulated(tmp_path, "demo", *faults) as (_, path), client(path) as port:
        handler = sdk.PacketHandler(1.0)
        assert handler.ping(port, 1)[1:] == (sdk.COMM_SUCCESS, 0)
        assert handler.ping(port, 2)[1] == sdk.COMM_RX_TIMEOUT
        assert handler.ping(port, 3)[1:] == (sdk.COMM_SUCCESS, 32)
        assert handler.ping(port, 4)[1] == sdk.COMM_RX_CORRUPT


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere",), "no rig 'nowhere'; packaged ones are"),
        (("demo", "--faults", "mte"), "no fault kind 'mte'; there are mute, delay"),
        (("demo", "--faults", "mute:77"), "no servo 77 on this bus; it has 1, 2, 3, 4, 5, 6"),
        (("demo", "--faults", "mute%2"), "has rate 2; want more than 0, at most 1"),
        (("demo", "--link", "/nowhere/at/all"), "can't make the link /nowhere/at/all"),
        (("demo", "--link", "/dev/null"), "/dev/null exists; name another path"),
    ],
)
def test_bad_input_is_said_and_nothing_is_started(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    done = run(tmp_path, *arguments)
    assert done.returncode == 1 and done.stdout == ""
    assert re.match(rf"error: .*{re.escape(said)}", done.stderr) and "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_neither_opencv_nor_the_viewer_is_loaded(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom station.commands.bus import emulate\n"
        "with emulate('demo') as arm:\n    assert arm.path\n"
        "print([name for name in ('cv2', 'rerun', 'matplotlib', 'serial', 'dynamixel_sdk') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment(tmp_path)
    )
    assert done.stdout == "[]\n"
