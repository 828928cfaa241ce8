"""A lab bench: the emulated arm and a network camera are here, the capture is a program of its own.

The arm outlives the capture, whatever becomes of that, and its servos' registers are looked at where they are.
"""

from __future__ import annotations

import functools
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import MonotonicClock
from station.emulated_arm import EmulatedArm
from station.formats.rig import RigTable
from station.rig import load_rig
from station.stage import Stage
from tests.drivers.ip_camera import HEAD, IpCamera, part
from tests.trials.programs import Program, capture_arguments, program

FPS = 30
# Protocol 1.0 and 2.0, and the joint that the motion moves.
JOINTS = {"demo": "shoulder", "openmanipulator_x": "joint2"}
# A goal far enough away that the arm is still under way when something befalls it.
GOAL_DEG, SPEED_DEG_S = 40.0, 8.0
MOTION = """
schema = "motion/1"
name = "there"
[[step]]
move = {{ {joint} = {goal} }}
speed_deg_s = {speed}
hold_s = 20
"""
# A step of 0.3 deg a count on AX servos, a joint that sags, the way it goes on while a program starts to act, deg.
NEAR_DEG = 3.0


@functools.cache
def pictures(rig: str) -> tuple[bytes, ...]:
    """Some JPEGs of the rig's markers, no two the same."""
    source = load_rig(rig)
    assert source.table.simulation is not None
    stage = Stage(source.table, source.table.simulation, source.camera_model, 0)
    q = np.zeros((1, len(stage.knots_s), len(stage.joints)))
    return tuple(cv2.imencode(".jpg", stage.render(q, k))[1].tobytes() for k in range(4))


@dataclass
class Bench:
    """An arm and a camera that a capture can use.

    Attributes:
        rig: the rig.toml that names both.
        gone: set, the camera ends its stream; it answers nobody any more.
    """

    folder: Path
    table: RigTable
    emulated: EmulatedArm
    camera: IpCamera
    rig: Path
    joint: str
    gone: threading.Event

    def each(self, register: str) -> list[int]:
        """A register of all servos."""
        return [self.emulated.register(servo.id, register) for joint in self.table.joint for servo in joint.servo]

    def joint_deg(self) -> float:
        """Where the joint that moves really is."""
        names = [joint.name for joint in self.table.joint]
        return float(np.degrees(self.emulated.joint_states(time.monotonic_ns())[names.index(self.joint)]))

    def rests(self) -> bool:
        """Whether the joint is where it was a moment ago."""
        before = self.joint_deg()
        time.sleep(0.3)
        return abs(self.joint_deg() - before) < 0.1

    @contextmanager
    def capture(self, *more: str, session: Path | None = None, breaks: str = "") -> Iterator[Program]:
        """`station capture` of the motion, once the joint is well under way."""
        motion = motion_of(self.joint)
        arguments = capture_arguments(self.folder, *more, rig=str(self.rig), motion=motion, session=session)
        with program(self.folder, *arguments, session=session, breaks=breaks) as running:
            if not breaks:
                running.wait_for(lambda: self.joint_deg() > 4.0, "motion")
            yield running


def motion_of(joint: str) -> str:
    """The motion.toml that takes a joint to its goal and has it wait there."""
    return MOTION.format(joint=joint, goal=GOAL_DEG, speed=SPEED_DEG_S)


def _streams(rig: str, gone: threading.Event):
    """What the camera does with a connection: picture after picture, until it is told to be gone."""

    def script(connection: socket.socket, leave: threading.Event) -> None:
        if gone.is_set():
            return
        connection.sendall(HEAD)
        sent = 0
        while not gone.is_set() and not leave.wait(1 / FPS):
            connection.sendall(part(pictures(rig)[sent % 4]))
            sent += 1

    return script


@contextmanager
def bench(folder: Path, rig: str, *, at_exit: str = "park-then-release", safety: str = "") -> Iterator[Bench]:
    """The packaged rig's arm, emulated on the real clock, and a camera on the network that sees its markers."""
    source, gone = load_rig(rig), threading.Event()
    pictures(rig)
    with ExitStack() as stack:
        camera = stack.enter_context(IpCamera(_streams(rig, gone)))
        emulated = EmulatedArm(source.table, None, MonotonicClock(), link=folder / "ttyARM")
        stack.enter_context(emulated)
        text = source.text.replace('port = "emulated"', f'port = "{emulated.path}"')
        text = text.replace('source = "rendered"', f'source = "{camera.address}"')
        text = text.replace('at_exit = "park-then-release"', f'at_exit = "{at_exit}"\n{safety}')
        path = folder / "rig.toml"
        path.write_text(text, encoding="utf-8")
        yield Bench(folder, source.table, emulated, camera, path, JOINTS[rig], gone)
