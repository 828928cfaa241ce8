"""Captures by hand: the arm is never energised, Ctrl-C is the normal end, and objects need no servos."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.arm import Arm
from drivers.camera import Camera
from drivers.clock import VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.errors import SafetyStop
from station.capture.by_hand import HandCapture, take_in_hand
from station.commands import capturing
from station.emulated_arm import EmulatedArm
from station.errors import InvalidData
from station.formats.rig import parse_rig
from station.hand_motion import hand_motion
from station.recording import Recording
from station.rig import Rig, load_rig
from station.rig_reading import joint_configs, packaged, packaged_names, read_rig
from station.session import read_status
from tests.test_capture import NoFrames
from tests.test_safe_states import Events

DOOR = """schema = "rig/1"
name = "door"
[camera]
source = "rendered"
size_px = [640, 480]
fps = 30
[camera.calibration]
size_px = [640, 480]
matrix = [[610.0, 0.0, 322.0], [0.0, 609.0, 243.0], [0.0, 0.0, 1.0]]
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
[markers]
dictionary = "DICT_4X4_50"
marker = [{ id = 0, part = "frame", size_mm = 50.0 }, { id = 1, part = "door", size_mm = 50.0 }]
[simulation]
root = "frame"
[simulation.camera]
position_mm = [150, -700, 400]
look_at_mm = [150, 0, 200]
[[simulation.joint]]
name = "hinge"
parent = "frame"
child = "door"
axis = [0, 0, 1]
point_mm = [0, 0, 0]
[[simulation.plate]]
id = 0
body = "frame"
position_mm = [-120, -20, 200]
normal = [-0.3, -1, 0.3]
[[simulation.plate]]
id = 1
body = "door"
position_mm = [200, -20, 200]
normal = [0.4, -1, 0.2]
"""


def agree(text: str) -> None: ...


@contextmanager
def limp_rig(
    name: str, monkeypatch: pytest.MonkeyPatch, fault: str = "noise@100"
) -> Iterator[tuple[Rig, EmulatedArm, list[tuple[str, int]]]]:
    """A rig without frames, its emulated end, and all that is written to its servos."""
    source, clock = load_rig(name), VirtualClock()
    text = source.text.replace("[simulation]\n", f'[simulation]\nfaults = ["{fault}"]\n')
    table = parse_rig(text, name)
    written: list[tuple[str, int]] = []
    with (
        EmulatedArm(table, table.simulation, clock) as emulated,
        DynamixelBus(
            emulated.path, baud=table.bus.baud, protocol=table.bus.protocol, clock=clock, reply_timeout_s=10.0
        ) as bus,
    ):
        sync_write, write = bus.sync_write, bus.write

        def noted_sync(register: str, values: Any) -> int:
            written.extend((register, value) for value in values.values())
            return sync_write(register, values)

        def noted(servo_id: Any, register: str, value: Any) -> None:
            written.append((register, value))
            write(servo_id, register, value)

        monkeypatch.setattr(bus, "sync_write", noted_sync)
        monkeypatch.setattr(bus, "write", noted)
        arm = Arm(bus, joint_configs(table), clock)
        rig = Rig(table, clock, True, arm, cast(Camera, None), source.camera_model, table.marker_table(), 0)
        yield replace(rig, camera=cast(Camera, NoFrames(rig))), emulated, written


def record(rig: Rig, duration_s: float | None, progress: Callable[[float, float], None] | None = None) -> Events:
    writer = Events()
    HandCapture(rig, cast(Any, writer), duration_s=duration_s, progress=progress).run()
    return writer


@pytest.mark.parametrize("name", ["demo", "openmanipulator_x", "vx300s"])
def test_an_arm_in_a_hand_is_never_energised_and_is_read_as_it_is_moved(name: str, monkeypatch: pytest.MonkeyPatch):
    with limp_rig(name, monkeypatch) as (rig, emulated, written):
        first = rig.table.joint[0].name
        emulated.push(first, 0.4, 1.0, rig.clock.now_ns() + 500_000_000)
        take_in_hand(rig, agree)
        writer = record(rig, 3.0)
        assert writer.state == "complete"
        assert rig.arm.read().q[0] == pytest.approx(0.4, abs=0.01)
        torque = [emulated.register(servo.id, "torque_enable") for joint in rig.table.joint for servo in joint.servo]
    assert not any(torque)
    assert {register for register, _ in written} <= {"torque_enable", "bus_watchdog"}
    assert not any(value for _, value in written)


def test_an_arm_that_holds_is_let_go_only_when_the_person_agrees(monkeypatch: pytest.MonkeyPatch):
    def refuse(text: str) -> None:
        assert "torque is on (base_pan, shoulder, elbow, wrist)" in text and "DROPS" in text
        raise InvalidData("stopped")

    with limp_rig("demo", monkeypatch) as (rig, emulated, written):
        rig.arm.connect()
        rig.arm.torque_on()
        written.clear()
        with pytest.raises(InvalidData, match="stopped"):
            take_in_hand(rig, refuse)
        assert emulated.register(2, "torque_enable") == 1 and not written
        take_in_hand(rig, agree)
        assert emulated.register(2, "torque_enable") == 0


def test_a_pair_that_is_moved_fast_and_read_slowly_does_not_disagree(monkeypatch: pytest.MonkeyPatch):
    """At 80 deg/s a reply that takes 100 ms lets the second servo of a pair be read 8 deg further on."""
    with limp_rig("demo", monkeypatch, "delay:2@0.5+100=0.1") as (rig, emulated, _):
        take_in_hand(rig, agree)
        emulated.push("shoulder", 1.0, np.radians(80), rig.clock.now_ns() + 700_000_000)
        assert record(rig, 3.0).state == "complete"


def test_an_interrupt_is_the_normal_end(monkeypatch: pytest.MonkeyPatch):
    def stop(done_s: float, total_s: float) -> None:
        if done_s > 1.0:
            raise KeyboardInterrupt

    with limp_rig("demo", monkeypatch) as (rig, _, _written):
        take_in_hand(rig, agree)
        writer = record(rig, None, stop)
    assert writer.state == "complete" and "INFO stopped" in writer.events


def test_a_fault_and_a_termination_end_it_as_interrupted(monkeypatch: pytest.MonkeyPatch):
    with limp_rig("demo", monkeypatch, "temperature:2@1=73") as (rig, emulated, _written):
        writer = Events()
        take_in_hand(rig, agree)
        with pytest.raises(SafetyStop, match="degC"):
            HandCapture(rig, cast(Any, writer), duration_s=5.0).run()
        assert writer.state == "interrupted" and emulated.register(2, "torque_enable") == 0

        def terminate(done_s: float, total_s: float) -> None:
            raise SystemExit(143)

        with pytest.raises(SystemExit):
            HandCapture(rig, cast(Any, writer), duration_s=5.0, progress=terminate).run()
        assert writer.state == "interrupted"


def test_the_demo_moved_by_hand_gives_its_tree_without_commands(station, tmp_path: Path):
    out = tmp_path / "hand"
    code, printed, err = station("capture", "demo", "--hand", "--simulate", "--out", out, "--duration-s", "8", "--json")
    assert code == 0, err
    counts = json.loads(printed)
    assert counts["commands"] == 0 and counts["frames"] == 240 and counts["readings"] == 400
    recording = Recording.load(out)
    assert not len(recording.commanded.t_s) and recording.description.motion is None
    code, printed, err = station("fit", out, "--json")
    assert code == 0, err
    joints = json.loads(printed)["joints"]
    assert {(j["name"], j["type"]) for j in joints} == {
        (name, "revolute") for name in ("base_pan", "shoulder", "elbow", "wrist")
    }
    code, printed, err = station("report", out)
    assert code == 0, err
    assert "Detected against read-back (there are no commands)" in printed
    compared = json.loads((out / "report" / "comparison.json").read_text())["joints"]
    assert all(joint["commanded"] is None and joint["measured"]["rmse_deg"] < 0.1 for joint in compared)
    assert len(compared) == 4 and "by hand" in (out / "report" / "report.html").read_text()


def test_a_door_without_servos_is_recorded_fitted_and_reported(station, tmp_path: Path):
    rig, out = tmp_path / "door.toml", tmp_path / "door"
    rig.write_text(DOOR, encoding="utf-8")
    code, printed, err = station("capture", rig, "--hand", "--out", out, "--json")
    assert code == 0, err
    assert json.loads(printed)["readings"] == 0 and read_status(out).state == "complete"
    code, printed, err = station("fit", out, "--json")
    assert code == 0, err
    (hinge,) = json.loads(printed)["joints"]
    assert hinge["type"] == "revolute" and {hinge["parent"], hinge["child"]} == {"frame", "door"}
    assert station("report", out)[0] == 0
    code, _, err = station("compare", out)
    assert code == 1 and "neither commands nor read-back" in err
    code, _, err = station("doctor", rig)
    assert code == 0, err


def test_a_rig_without_an_arm_is_refused_where_one_is_needed(station, tmp_path: Path):
    rig, out = tmp_path / "door.toml", tmp_path / "out"
    rig.write_text(DOOR, encoding="utf-8")
    for arguments in (
        ("capture", rig, "demo", "--out", out),
        ("run", rig, "demo", "--out", out),
        ("plan", rig, "demo"),
        ("emulate", rig),
        ("calibrate", "servos", rig, "--yes"),
        ("calibrate", "latency", rig, "--out", out),
    ):
        code, _, err = station(*arguments)
        assert code == 1 and "there is no arm to command" in err and "--hand" in err, (arguments, err)
        assert not out.exists()
    half = tmp_path / "half.toml"
    half.write_text(DOOR.replace("[camera]\n", '[bus]\nport = "/dev/x"\nprotocol = 1.0\n[camera]\n', 1))
    code, _, err = station("capture", half, "--hand", "--out", out)
    assert code == 1 and "has [bus] and no [[joint]]" in err


def test_usage_of_capture_by_hand(station, tmp_path: Path):
    out = tmp_path / "out"
    for arguments, said in (
        (("capture", "demo", "--out", out), "want a motion, or --hand"),
        (("capture", "demo", "demo", "--hand", "--out", out), "not both"),
        (("capture", "demo", "demo", "--duration-s", "3", "--out", out), "--duration-s goes with --hand"),
        (("capture", "demo", "--hand", "--duration-s", "-1", "--out", out), "--duration-s"),
    ):
        code, _, err = station(*arguments)
        assert code == 2 and said in err and not out.exists(), (arguments, err)


@pytest.mark.parametrize("name", packaged_names("rigs"))
def test_a_made_hand_moves_every_joint_within_its_limits_and_ends_where_it_began(name: str):
    limits = read_rig(packaged("rigs", name).as_posix())[0].limits()
    motion = hand_motion(limits, 30.0)
    assert motion.duration_s >= 30.0
    times = np.linspace(0, motion.duration_s + 1, 500)
    states = np.array([motion.states(t) for t in times])
    for j, joint in enumerate(limits):
        assert states[:, j].min() >= joint.lower - 1e-9 and states[:, j].max() <= joint.upper + 1e-9
        assert np.ptp(states[:, j]) > 0
    assert np.allclose(states[-1], [joint.park for joint in limits])
    assert hand_motion(limits, None).rounds == 1


def test_capture_by_hand_leaves_nothing_where_it_may_not_let_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(text: str) -> None:
        raise InvalidData("stopped")

    monkeypatch.setattr(Arm, "holding", lambda self: ("elbow",))
    with pytest.raises(InvalidData, match="stopped"):
        capturing.capture_by_hand("demo", tmp_path / "out", ask=refuse, duration_s=1.0)
    assert not (tmp_path / "out").exists()
