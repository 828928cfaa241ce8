"""scan and doctor on the command line: tables, JSON, exit codes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.clock import MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo
from station.doctor.scanning import choose_settings, parse_ids
from station.errors import StationError
from tests.test_doctor import RIG

WIDTH = 100
CODE = "from station.cli import main; main()"


@contextmanager
def ax_bus(*ids: int, model: str = "AX-18A") -> Iterator[EmulatedBus]:
    servos = [EmulatedServo(id, model) for id in ids]
    with EmulatedBus(servos, baud=1_000_000, clock=VirtualClock()) as bus:
        yield bus


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scan that waits longer for answers: other tests may keep the emulated bus from its turn."""
    monkeypatch.setattr("drivers.probe.MARGIN_S", 0.15)


def write_rig(folder: Path, port: str) -> Path:
    path = folder / "arm.toml"
    path.write_text(RIG.format(port=port, protocol=1.0, model="AX-18A"), encoding="utf-8")
    return path


NARROW = ("--baud", "1000000", "--protocol", "1.0", "--ids", "0-4,9")


def test_scan_shows_what_is_there(station):
    with ax_bus(1, 9) as bus:
        code, out, _ = station("scan", bus.path, *NARROW)
        assert code == 0 and "2 servos found" in out
        assert re.search(r"^ +9 +AX-18A \(18\) +0 +1\.0 +1000000", out, re.MULTILINE)
        code, out, _ = station("scan", bus.path, *NARROW, "--json")
    (first, _second) = json.loads(out)["servos"]
    assert first["found"]["id"] == 1 and first["found"]["model"] == "AX-18A" and first["expected"] is None


def test_scan_holds_what_is_there_against_the_rig(station, tmp_path: Path):
    with ax_bus(1, 2, 9) as bus:
        rig = write_rig(tmp_path, bus.path)
        code, out, err = station("scan", "--rig", rig, *NARROW)
    assert code == 1
    assert re.search(r"3 +AX-18A +lift +missing", out) and re.search(r"9 +AX-18A .* unexpected", out)
    assert "servo 3 (lift) is missing, and an AX-18A that the rig doesn't name has id 9" in err
    with ax_bus(1, 2, 3) as bus:
        code, out, _ = station("scan", bus.path, "--rig", rig, *NARROW)
    assert code == 0 and out.count("as expected") == 3
    with ax_bus(1, 2, 3, model="AX-12A") as bus:
        code, out, _ = station("scan", bus.path, "--rig", rig, *NARROW)
    assert code == 1 and out.count("wrong model: the rig says AX-18A") == 3


def test_scan_says_at_which_baud_an_expected_servo_is(station, tmp_path: Path):
    servos = [EmulatedServo(id, "AX-18A") for id in (1, 2, 3)]
    with EmulatedBus(servos, baud=1_000_000, clock=VirtualClock()) as bus:
        servos[1].set("baud_rate", 34)
        narrow = (*NARROW, "--baud", "57600")
        code, out, err = station("scan", "--rig", write_rig(tmp_path, bus.path), *narrow)
    assert code == 1 and "wrong baud" in out and "57600 baud, protocol 1.0" in err


def test_scan_that_finds_nothing_says_what_to_check_in_order(station):
    with ax_bus(1) as bus:
        code, out, err = station("scan", bus.path, "--baud", "57600", "--protocol", "1.0", "--ids", "1-3")
    assert code == 1 and "no servo answers" in out
    hints = [line.split(":")[0] for line in err.splitlines() if line.startswith("- ")]
    assert hints[:4] == ["- not all bauds, protocols and ids were asked", "- power", "- cable", "- adapter"]


def test_scan_of_a_port_that_is_not_there_is_one_error(station):
    code, out, err = station("scan", "/dev/gone")
    assert code == 1 and not out and err.startswith("error: no port /dev/gone")
    code, _, err = station("scan")
    assert code == 1 and "name a port, or a rig with --rig" in err


@pytest.mark.parametrize("ids", ["", "a", "5-", "9-3", "0-253", "1,,2"])
def test_ids_that_are_none_are_refused(ids: str):
    with pytest.raises(StationError, match=re.escape(f"ids '{ids}'")):
        parse_ids(ids)


def test_ids_are_ids_and_ranges():
    assert parse_ids("3, 1-4,30") == (3, 1, 2, 4, 30)
    assert parse_ids(None) == tuple(range(253))


def test_a_baud_that_no_model_has_can_be_asked_for():
    (setting,) = choose_settings([123_456], [2.0], None)
    assert (setting.protocol, setting.baud) == (2.0, 123_456)


def test_an_interrupted_scan_shows_what_it_found_and_frees_the_port():
    servos = [EmulatedServo(id, "AX-18A") for id in (1, 2)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent)}
    with EmulatedBus(servos, baud=1_000_000, clock=MonotonicClock()) as bus:
        arguments = [sys.executable, "-c", CODE, "scan", bus.path, "--protocol", "1.0"]
        with subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        ) as running:
            try:
                deadline = time.monotonic() + 60
                while servos[1].get("present_position") == 0 and time.monotonic() < deadline:
                    time.sleep(0.02)  # until the second servo has been asked where it stands
                time.sleep(1.0)
                running.send_signal(signal.SIGINT)
                out, err = running.communicate(timeout=60)
            finally:
                running.kill()
        assert running.returncode == 130, err
        assert "2 servos found" in out and "Traceback" not in err
        with DynamixelBus(bus.path, baud=1_000_000, protocol=1.0, clock=MonotonicClock()) as client:
            assert client.ping(1) == 18


def test_doctor_shows_a_table_that_fits_and_how_to_mend(station, tmp_path: Path):
    with ax_bus(1, 2) as bus:
        rig = write_rig(tmp_path, bus.path)
        code, out, err = station("doctor", rig)
    assert code == 1
    rows = out.splitlines()
    assert max(map(len, rows)) <= WIDTH
    assert not [row for row in rows[4:-1] if row.startswith("  ")]  # each row begins with its place: none is wrapped
    assert re.search(r"servo 3 \(lift\) +blocks +answers: no reply", out)
    assert "--fix return-delay" in err and "- servo 3 (lift): check its power" in err


def test_doctor_tells_all_as_json(station):
    code, out, _ = station("doctor", "demo", "--json")
    document = json.loads(out)
    assert code == 0 and document["passed"] is True
    voltages = [finding["voltage_v"] for finding in document["findings"] if finding["check"] == "voltage"]
    assert voltages == [12.0] * 6


def test_doctor_mends_what_is_named(station, tmp_path: Path):
    servos = [EmulatedServo(id, "AX-18A") for id in (1, 2, 3)]
    with EmulatedBus(servos, baud=1_000_000, clock=VirtualClock()) as bus:
        _, out, _ = station("doctor", write_rig(tmp_path, bus.path), "--fix", "return-delay")
        assert [servo.get("return_delay_time") for servo in servos] == [0, 0, 0]
    assert out.count("'return_delay_time' was 250, it reads 0 now") == 3
    code, _, err = station("doctor", "demo", "--fix", "everything")
    assert code == 1 and "no fix 'everything'" in err and "drive-mode" in err
