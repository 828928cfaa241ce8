"""`station calibrate servos` on an emulated bus whose servos stand otherwise than the rig says, through the SDK."""

from __future__ import annotations

import io
import json
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import MonotonicClock
from drivers.dynamixel import DynamixelBus
from station.calibrating import reference_pose
from station.calibrating.reference_pose import reference_states
from station.emulated_arm import EmulatedArm
from station.errors import StationError
from station.formats.rig import parse_rig
from station.formats.toml_edit import set_numbers
from station.motion import JointLimits
from station.rig_reading import packaged

TRUE_ZEROS = {
    "demo": [[530], [500, 525], [540, 488], [512]],
    "openmanipulator_x": [[2000], [2100], [2048], [1990], [2150]],
    "vx300s": [[2040], [2060, 2060], [2030, 2030], [2048], [2100], [2050], [2048]],
}


@pytest.fixture(autouse=True)
def patient_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine with other work to do a reply of the emulator may take longer than one of a servo."""

    def bus(port: str, **settings: Any) -> DynamixelBus:
        return DynamixelBus(port, **{**settings, "reply_timeout_s": 10.0})

    monkeypatch.setattr(reference_pose, "DynamixelBus", bus)


@contextmanager
def built(folder: Path, name: str) -> Iterator[tuple[Path, EmulatedArm]]:
    """A rig as its owner knows it, at the port of an arm whose horns sit where TRUE_ZEROS says."""
    text = packaged("rigs", name).read_text("utf-8")
    zeros = {
        ("joint", j, "servo", s, "zero"): zero for j, row in enumerate(TRUE_ZEROS[name]) for s, zero in enumerate(row)
    }
    true = parse_rig(set_numbers(text, zeros, name), name)
    with EmulatedArm(true, None, MonotonicClock()) as arm:
        path = folder / "rig.toml"
        path.write_text(text.replace('port = "emulated"', f'port = "{arm.path}"'), encoding="utf-8")
        yield path, arm


@pytest.mark.parametrize("name", TRUE_ZEROS)
def test_the_zeros_of_an_arm_are_found_at_its_park_pose(station, tmp_path: Path, name: str):
    with built(tmp_path, name) as (rig, arm):
        pose = [
            f"--pose={joint.name}={np.degrees(joint.park) if joint.unit == 'rad' else 1e3 * joint.park}"
            for joint in parse_rig(rig.read_text(), name).limits()
        ]
        code, out, err = station("calibrate", "servos", rig, "--yes", "--json", *pose)
        torque = [arm.register(servo.id, "torque_enable") for joint in arm._joints for servo in joint.servos]
    assert code == 0, err
    found = json.loads(out)["servos"]
    want = [zero for row in TRUE_ZEROS[name] for zero in row]
    # The shaft stands at the count nearest the pose; a count of rounding.
    assert [each["zero"] for each in found] == pytest.approx(want, abs=1)
    assert all(each["std"] < np.radians(0.15) for each in found)
    assert not any(torque)


def test_the_zeros_are_written_between_the_comments_and_the_next_time_nothing_moves(station, tmp_path: Path):
    with built(tmp_path, "demo") as (rig, _):
        before = rig.read_text()
        code, _, err = station("calibrate", "servos", rig, "--yes", "--write")
        assert code == 0, err
        after = rig.read_text()
        code, out, err = station("calibrate", "servos", rig, "--yes", "--json")
    assert code == 0 and all(each["moved"] == 0 for each in json.loads(out)["servos"])
    zeros = [[servo["zero"] for servo in joint["servo"]] for joint in tomllib.loads(after)["joint"]]
    assert zeros == TRUE_ZEROS["demo"]
    assert [line for line in after.splitlines() if not line.startswith("zero")] == before.splitlines()
    assert (tmp_path / "rig.toml.old").read_text() == before


def test_torque_that_is_on_is_switched_off_only_after_it_was_said(station, tmp_path: Path):
    with built(tmp_path, "demo") as (rig, arm):
        arm._servos[2].set("torque_enable", 1)
        code, _, err = station("calibrate", "servos", rig)
        assert code == 1 and "torque is on (shoulder)" in err and "the arm DROPS" in err
        assert arm.register(2, "torque_enable") == 1
        code, _, err = station("calibrate", "servos", rig, "--yes")
        assert code == 0, err
        assert "torque is on (shoulder)" in err and arm.register(2, "torque_enable") == 0


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_person_is_asked_and_may_say_no(station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with built(tmp_path, "demo") as (rig, _):
        monkeypatch.setattr(sys, "stdin", Terminal("n\n"))
        code, _, err = station("calibrate", "servos", rig, "--write")
        assert code == 1 and "stopped; nothing was changed" in err and not (tmp_path / "rig.toml.old").exists()
        monkeypatch.setattr(sys, "stdin", Terminal("\n"))
        code, out, err = station("calibrate", "servos", rig)
        assert code == 0 and "reference pose: base_pan 0.0 deg" in err and "zero = 525" in err and "525" in out


def test_zeros_that_leave_limits_out_of_reach_are_told_and_not_written(station, tmp_path: Path):
    with built(tmp_path, "demo") as (rig, _):
        before = rig.read_text()
        code, _, err = station("calibrate", "servos", rig, "--yes", "--write", "--pose", "base_pan=-95")
    assert code == 1 and "servo 1 (base_pan) would have to go from count 513 to 1195" in err
    assert rig.read_text() == before


def test_bad_input_to_the_zeros_is_one_clear_error(station, tmp_path: Path):
    gone = tmp_path / "gone.toml"
    gone.write_text(packaged("rigs", "demo").read_text().replace('port = "emulated"', 'port = "/dev/ttyNOWHERE"'))
    cases = [
        (("demo", "--yes", "--pose", "knee=1"), "no joint 'knee'"),
        (("demo", "--yes", "--pose", "elbow=90"), "can't be at 90.0 deg"),
        (("demo", "--yes", "--pose", "elbow"), "want a joint and where it is held"),
        (("demo",), "nobody can be asked here"),
        (("demo", "--yes", "--write"), "comes with the package"),
        ((gone, "--yes"), "/dev/ttyNOWHERE"),
        (("nowhere", "--yes"), "packaged ones are"),
    ]
    for arguments, said in cases:
        code, _, err = station("calibrate", "servos", *arguments)
        assert code == 1 and said in err and len(err.splitlines()) <= 5 and "Traceback" not in err, (arguments, err)


def test_a_joint_that_cannot_be_at_zero_must_be_given():
    finger = JointLimits("finger", 0.005, 0.019, 1.0, park=0.01, unit="m")
    with pytest.raises(StationError, match=r"can't be at 0\.0 mm.*\n.*--pose finger="):
        reference_states((finger,), {})
    assert reference_states((finger,), {"finger": 10.0}) == pytest.approx([0.01])
