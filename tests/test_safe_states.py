"""Faults in mid-motion: the state in which the arm is left, asserted on the emulated servos' own registers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.arm import Arm
from drivers.camera import Camera
from drivers.clock import VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.errors import BusLost, DriverError, SafetyStop, ServoFault
from station.capture.service import Capture
from station.commands import planning
from station.emulated_arm import EmulatedArm
from station.formats.rig import parse_rig
from station.rig import Rig, load_rig, safety_limits
from station.rig_reading import joint_configs
from tests.test_capture import NoFrames

# Protocol 1.0 with two servos on the joint, and 2.0: the joint that moves, and a temperature (degC) too high for
# the station, but not yet for the servo.
RIGS = {"demo": ("shoulder", 73), "openmanipulator_x": ("joint2", 78)}
ON_BOTH = pytest.mark.parametrize("name", RIGS)
FAULT_AT_S = 3.0
MOTION = """
schema = "motion/1"
name = "there"
mode = "{mode}"
[[step]]
move = {{ {joint} = 40 }}
speed_deg_s = 5
"""
STOPS = {
    "temperature:{id}@3={hot}": (SafetyStop, "is at 7. degC"),
    "obstruct:{ids}@3=0": (SafetyStop, "is stalled"),
    "alert:{id}@3=overload": (ServoFault, "reports overload"),
    "temperature:{id}@3=95": (ServoFault, "reports overheating"),
    "voltage@3=4": (DriverError, "V; wants|reports input_voltage"),
}


@dataclass
class Events:
    """Takes what a capture records, in place of a file."""

    events: list[str] = field(default_factory=list)
    t_s: list[float] = field(default_factory=list)
    state: str = ""
    counts: dict[str, int] = field(default_factory=dict)

    def log_command(self, t_ns: int, q: np.ndarray) -> None: ...

    def log_reading(self, *stamps_and_states: object) -> None: ...

    def log_servos(self, t_ns: int, states: object) -> None: ...

    def checkpoint(self, leg: int, legs: int, counts: object, motion: object = None) -> None: ...

    def log_event(self, t_ns: int, level: str, text: str) -> None:
        self.events.append(f"{level} {text}")
        self.t_s.append(t_ns * 1e-9)

    def at_s(self, part: str) -> float:
        """When the event that holds this text happened."""
        return next(t for t, event in zip(self.t_s, self.events, strict=True) if part in event)

    def close(self, state: str, counts: dict[str, int]) -> None:
        self.state, self.counts = state, counts


@dataclass
class Lab:
    """A rig of which the test keeps the emulated end."""

    rig: Rig
    emulated: EmulatedArm
    writer: Events
    files: tuple[str, str]
    joint: str

    def capture(self) -> None:
        """Run the motion; raises what ends it."""
        Capture(self.rig, planning.plan(*self.files), cast(Any, self.writer)).run()

    def each(self, register: str) -> list[int]:
        """A register of all servos."""
        return [self.emulated.register(servo.id, register) for joint in self.rig.table.joint for servo in joint.servo]

    def joint_deg(self) -> float:
        """Where the joint that moves really is."""
        names = [joint.name for joint in self.rig.table.joint]
        return float(np.degrees(self.emulated.joint_states(self.rig.clock.now_ns())[names.index(self.joint)]))

    def pass_s(self, seconds: float) -> None:
        self.rig.clock.sleep_until_ns(self.rig.clock.now_ns() + int(seconds * 1e9))


@contextmanager
def lab(
    folder: Path,
    name: str,
    fault: str,
    *,
    at_exit: str = "park-then-release",
    more: str = "",
    mode: str = "step",
    weight: str = "",
    reply_timeout_s: float = 10.0,
) -> Iterator[Lab]:
    source, (joint, hot) = load_rig(name), RIGS[name]
    ids = next([servo.id for servo in each.servo] for each in source.table.joint if each.name == joint)
    fault = fault.format(id=ids[0], ids=",".join(map(str, ids)), hot=hot)
    text = source.text.replace('at_exit = "park-then-release"', f'at_exit = "{at_exit}"\n{more}')
    text = text.replace("[simulation]\n", f'[simulation]\nfaults = ["{fault}"]\n')
    text = text.replace('child = "gripper"\n', f'child = "gripper"\n{weight}')
    rig_path, motion_path = folder / "rig.toml", folder / "motion.toml"
    rig_path.write_text(text, encoding="utf-8")
    motion_path.write_text(MOTION.format(joint=joint, mode=mode), encoding="utf-8")
    table, clock = parse_rig(text, str(rig_path)), VirtualClock()
    with (
        EmulatedArm(table, table.simulation, clock) as emulated,
        DynamixelBus(
            emulated.path,
            baud=table.bus.baud,
            protocol=table.bus.protocol,
            clock=clock,
            reply_timeout_s=reply_timeout_s,
        ) as bus,
    ):
        arm = Arm(bus, joint_configs(table), clock, limits=safety_limits(table))
        rig = Rig(table, clock, True, arm, cast(Camera, None), source.camera_model, table.marker_table(), 0)
        rig = replace(rig, camera=cast(Camera, NoFrames(rig)))
        yield Lab(rig, emulated, Events(), (str(rig_path), str(motion_path)), joint)


@ON_BOTH
@pytest.mark.parametrize("fault", STOPS)
@pytest.mark.parametrize("at_exit", ["park-then-release", "hold", "release"])
def test_a_fault_in_mid_motion_ends_in_the_declared_state(tmp_path: Path, name: str, fault: str, at_exit: str) -> None:
    kind, said = STOPS[fault]
    with lab(tmp_path, name, fault, at_exit=at_exit) as bench:
        with pytest.raises(kind, match=said):
            bench.capture()
        assert bench.writer.state == "interrupted"
        left_deg = bench.joint_deg()
        if at_exit == "hold":
            shut_down = kind is not SafetyStop and name != "demo"  # X servos: the torque of the one that failed is off
            assert sum(bench.each("torque_enable")) >= len(bench.each("torque_enable")) - (
                shut_down or "voltage" in fault
            )
            assert 5.0 < left_deg < 35.0  # it neither ran on nor went back
        else:
            assert not any(bench.each("torque_enable"))
        parks = at_exit == "park-then-release" and "{hot}" in fault
        assert (abs(left_deg) < 2.5) == parks
        bench.pass_s(3.0)
        assert bench.joint_deg() == pytest.approx(left_deg, abs=3.0)
        if name != "demo":
            assert not any(bench.each("bus_watchdog"))  # nobody needs to go on talking


def test_a_servo_that_shut_down_is_released_and_not_parked(tmp_path: Path) -> None:
    """An arm with a limp joint would be dragged along: no command follows the alarm."""
    with lab(tmp_path, "openmanipulator_x", "alert:{id}@3=overload") as bench:
        with pytest.raises(ServoFault) as caught:
            bench.capture()
        assert (caught.value.flags, caught.value.joint) == (("overload",), "joint2")
        assert "ERROR leaving the arm" in " ".join(bench.writer.events)


@ON_BOTH
def test_a_bus_that_comes_back_is_waited_for_and_the_motion_goes_on(tmp_path: Path, name: str) -> None:
    with lab(tmp_path, name, "unplug@3+2", more="reconnect_s = 20") as bench:
        fastest: list[float] = []
        while_away = bench.joint_deg

        def speed_deg_s() -> float:
            before = while_away()
            bench.pass_s(0.05)
            return (while_away() - before) / 0.05

        approach = bench.rig.arm.command

        def command(q: np.ndarray) -> int:
            sent = approach(q)
            bench.rig.arm.read()  # it has arrived when this is answered
            if bench.writer.events and "waiting 20 s for it" in bench.writer.events[-1]:
                bench.pass_s(0.3)
                fastest.append(speed_deg_s())
            return sent

        bench.rig.arm.command = command  # type: ignore[method-assign]
        bench.capture()
        writer = bench.writer
        assert writer.state == "complete"
        assert not any(bench.each("torque_enable"))
        # The motion of 8 s took as much longer as the bus was away, and until the arm was back where it was to be.
        gone_s = writer.at_s("the bus is back") - writer.at_s("waiting 20 s for it")
        assert gone_s > 2.0
        assert writer.at_s("motion done") - writer.at_s("starts: 8.0 s") == pytest.approx(8.0 + gone_s, abs=0.3)
        # On its way there it was no faster than the step, 5 deg/s; servos' speeds come in steps.
        assert name == "demo" or max(fastest) < 6.0


def test_a_stream_goes_on_at_its_own_speeds_when_the_bus_is_back(tmp_path: Path) -> None:
    with lab(tmp_path, "openmanipulator_x", "unplug@3+1", more="reconnect_s = 20", mode="stream") as bench:
        speeds: list[list[int]] = []
        read = bench.rig.arm.read

        def reading() -> object:
            if not bench.writer.events or "bus is back" not in " ".join(bench.writer.events):
                return read()
            speeds.append(bench.each("profile_velocity"))
            return read()

        before: list[int] = []
        command = bench.rig.arm.command

        def commanding(q: np.ndarray) -> int:
            if any("starts" in event for event in bench.writer.events) and not before:
                read()
                before.extend(bench.each("profile_velocity"))
            return command(q)

        bench.rig.arm.read = reading  # type: ignore[method-assign]
        bench.rig.arm.command = commanding  # type: ignore[method-assign]
        bench.capture()
        assert speeds[5] == before  # not those of the approach


def test_an_arm_that_fails_stays_where_it_is_before_it_is_parked(tmp_path: Path) -> None:
    """A slow adapter takes seconds to set the speeds for parking: the arm doesn't run on meanwhile."""
    with lab(tmp_path, "demo", "temperature:{id}@3={hot}") as bench:
        failed_deg: list[float] = []
        set_speeds = bench.rig.arm.set_speeds

        def slow(speeds: np.ndarray) -> None:
            if any("degC" in event for event in bench.writer.events):
                failed_deg.append(bench.joint_deg())
                bench.pass_s(3.0)
                failed_deg.append(bench.joint_deg())
            set_speeds(speeds)

        bench.rig.arm.set_speeds = slow  # type: ignore[method-assign]
        with pytest.raises(SafetyStop):
            bench.capture()
        assert failed_deg[1] == pytest.approx(failed_deg[0], abs=0.5)  # 15 deg at the speed of the step


@ON_BOTH
@pytest.mark.parametrize("more", ["", "reconnect_s = 2"], ids=["not waited for", "not back in time"])
def test_a_bus_that_stays_away_ends_the_capture(tmp_path: Path, name: str, more: str) -> None:
    with lab(tmp_path, name, "unplug@3", more=more) as bench:
        with pytest.raises(BusLost, match="is gone"):
            bench.capture()
        assert bench.writer.state == "interrupted"
        bench.pass_s(10.0)
        if name != "demo":  # the watchdog of X servos stops them; an AX goes on to its last goal
            assert bench.joint_deg() < 40 - 5


def test_a_silence_in_which_the_watchdog_stopped_the_arm_is_said(tmp_path: Path) -> None:
    with lab(tmp_path, "openmanipulator_x", "noise@100") as bench:
        arm = bench.rig.arm
        arm.connect()
        arm.torque_on()
        bench.pass_s(0.9)
        arm.read()
        bench.pass_s(1.2)
        with pytest.raises(DriverError, match=r"for 1\.2 s: servos 11 \(joint1\), .* stopped by their bus watchdog"):
            arm.read()
        arm.torque_on()  # and it can be used again
        arm.command(np.zeros(len(arm.names)))
        arm.torque_off()


def test_an_arm_that_sags_under_its_load_is_used_and_it_is_said(tmp_path: Path) -> None:
    """0.45 kg 278 mm in front of the axis: some 1.2 N m of the 4.1 N m that the servo has, and no integral gain."""
    weight = "mass_kg = 0.45\ncentre_mm = [290, 0, 205]\n"
    with lab(tmp_path, "openmanipulator_x", "noise@100", weight=weight) as bench:
        bench.capture()
        writer = bench.writer
        assert writer.state == "complete"
        (said,) = {event for event in writer.events if "sags under its load" in event}
        assert "WARN joint2 is" in said
