"""From rig.toml to open devices: the real bus and camera, or the emulated bus and the rendered camera.

Whether a rig is real or simulated is decided here, once; all else works on a Rig and can't tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from drivers.arm import Arm, JointConfig, ServoConfig
from drivers.camera import Camera
from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulated_bus import EmulatedBus
from drivers.emulated_servo import EmulatedServo
from drivers.rendered_camera import RenderedCamera
from drivers.servo_models import load_model
from drivers.webcam import Webcam
from station.errors import InvalidData
from station.formats.rig import (
    EMULATED,
    RENDERED,
    RigTable,
    load_calibration,
    parse_rig,
)
from station.formats.simulation import SimulatedCamera, SimulationTable
from station.formats.text import read_text
from station.logs import FloatArray
from station.perception.markers import MarkerTable
from station.stage import Stage

# On a virtual clock a slow machine must not make a reply late: waits for one are then real time, and generous.
VIRTUAL_REPLY_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class RigFile:
    """A rig as it was read: its table, its text for the session's copy, and the camera's calibration."""

    table: RigTable
    text: str
    name: str
    camera_model: CameraModel


@dataclass(frozen=True)
class Rig:
    """Open devices, one clock, and what is known of them."""

    table: RigTable
    clock: Clock
    virtual: bool
    arm: Arm
    camera: Camera
    camera_model: CameraModel
    markers: MarkerTable
    seed: int | None


def packaged(kind: str, name_or_path: str) -> Path:
    """Path of a packaged rig or motion (`kind` "rigs" or "motions") of that name, else of the file itself."""
    inside = Path(str(resources.files("station") / kind / f"{name_or_path}.toml"))
    return inside if inside.is_file() else Path(name_or_path)


def packaged_names(kind: str) -> list[str]:
    """Names of the rigs or motions that come with the package."""
    return sorted(path.stem for path in Path(str(resources.files("station") / kind)).glob("*.toml"))


def read_rig(name_or_path: str) -> tuple[RigTable, str, Path]:
    """A rig's table, text and file, its calibration not looked at; raises InvalidFile."""
    path = packaged("rigs", name_or_path)
    text = read_text(path, "rig", f"packaged ones are {', '.join(packaged_names('rigs'))}")
    return parse_rig(text, str(path)), text, path


def load_rig(name_or_path: str) -> RigFile:
    """Read a rig and its camera's calibration; raises InvalidFile."""
    table, text, path = read_rig(name_or_path)
    return RigFile(table, text, str(path), load_calibration(table, path.parent, str(path)))


@contextmanager
def open_rig(rig: RigFile, *, simulate: bool = False, realtime: bool = False, seed: int | None = None) -> Iterator[Rig]:
    """Open a rig's devices and close them after.

    Args:
        simulate: use the emulated bus and the rendered camera whatever the rig names; needs a `[simulation]`.
        realtime: run simulated devices on the real clock; else they run on a virtual one, the same on any machine.
        seed: of everything random in the simulation; the rig's own if None.

    Raises:
        InvalidData: a simulation is asked for and not described, or a rendered camera looks at a real arm.
        DriverError: a port or camera that isn't there.
    """
    table = rig.table
    emulated = simulate or table.bus.port == EMULATED
    rendered = simulate or table.camera.source == RENDERED
    simulation = table.simulation
    if (emulated or rendered) and simulation is None:
        raise InvalidData(f"{rig.name} has no [simulation]: it can't run without its hardware")
    if rendered and not emulated:
        raise InvalidData(
            f'{rig.name}: a rendered camera can\'t see a real arm; set port = "emulated" or a camera source'
        )
    virtual = emulated and rendered and not realtime
    clock: Clock = VirtualClock() if virtual else MonotonicClock()
    if simulation is not None and seed is None:
        seed = simulation.seed
    with ExitStack() as stack:
        bus = EmulatedArm(table, simulation, clock) if emulated and simulation is not None else None
        port = table.bus.port if bus is None else stack.enter_context(bus).path
        timeout_s = VIRTUAL_REPLY_TIMEOUT_S if virtual else None
        client = DynamixelBus(
            port, baud=table.bus.baud, protocol=table.bus.protocol, clock=clock, reply_timeout_s=timeout_s
        )
        disagreement_rad = float(np.radians(table.safety.disagreement_deg))
        arm = Arm(stack.enter_context(client), joint_configs(table), clock, disagreement_rad=disagreement_rad)
        if bus is not None and simulation is not None and rendered:
            stage = Stage(table, simulation, rig.camera_model, seed or 0)
            camera: Camera = rendered_camera(table, simulation.camera, stage, bus, clock, realtime=not virtual)
        else:
            camera = Webcam(table.camera.source, frame_size(table), table.camera.fps, clock)
        stack.callback(camera.close)
        camera.start()
        simulated_seed = seed if emulated or rendered else None
        yield Rig(table, clock, virtual, arm, camera, rig.camera_model, table.marker_table(), simulated_seed)


def frame_size(table: RigTable) -> tuple[int, int]:
    """(width, height) of the camera's frames."""
    return (table.camera.size_px[0], table.camera.size_px[1])


def joint_configs(table: RigTable) -> tuple[JointConfig, ...]:
    """The joints as the arm takes them."""
    return tuple(
        JointConfig(
            name=joint.name,
            servos=tuple(ServoConfig(servo.id, servo.model, servo.zero, servo.sign) for servo in joint.servo),
            lower_rad=limits.lower,
            upper_rad=limits.upper,
            max_speed_rad_s=limits.max_speed,
        )
        for joint, limits in zip(table.joint, table.limits(), strict=True)
    )


class EmulatedArm(EmulatedBus):
    """The emulated bus of a rig's servos, standing at the park pose, and the joints' true angles behind it."""

    def __init__(self, table: RigTable, simulation: SimulationTable, clock: Clock) -> None:
        acceleration = float(np.radians(simulation.max_acceleration_deg_s2))
        servos: list[EmulatedServo] = []
        self._turns: list[list[tuple[int, int, float]]] = []  # of each joint: servo id, sign, shaft angle at zero
        for joint in table.joint:
            turns: list[tuple[int, int, float]] = []
            for servo in joint.servo:
                model = load_model(servo.model)
                zero = model.zero_count if servo.zero is None else servo.zero
                park = round(zero + servo.sign * np.radians(joint.park_deg) / model.rad_per_count)
                servos.append(
                    EmulatedServo(servo.id, servo.model, initial_count=park, max_acceleration_rad_s2=acceleration)
                )
                turns.append((servo.id, servo.sign, (zero - model.zero_count) * model.rad_per_count))
            self._turns.append(turns)
        super().__init__(servos, protocol=table.bus.protocol, baud=table.bus.baud, clock=clock)

    def joint_rad(self, t_ns: int) -> FloatArray:
        """(J,) true joint angles at a time of the clock: the mean of the servos that turn each."""
        return np.array(
            [
                sum(sign * (self.shaft_rad(servo, t_ns) - zero) for servo, sign, zero in turns) / len(turns)
                for turns in self._turns
            ],
            dtype=np.float64,
        )


def rendered_camera(
    table: RigTable, camera: SimulatedCamera, stage: Stage, bus: EmulatedArm, clock: Clock, *, realtime: bool
) -> RenderedCamera:
    """The camera that sees the emulated arm on its stage; not started yet."""
    shares = (np.arange(camera.blur_instants) + 0.5) / camera.blur_instants - 0.5
    offsets_ns = np.round(shares * camera.exposure_s * 1e9).astype(int).tolist()

    def render(t_mid_ns: int, index: int) -> NDArray[np.uint8]:
        return stage.render(np.stack([bus.joint_rad(t_mid_ns + offset) for offset in offsets_ns]), index)

    return RenderedCamera(
        render,
        size_px=frame_size(table),
        fps=table.camera.fps,
        exposure_s=camera.exposure_s,
        latency_s=camera.latency_s,
        clock=clock,
        realtime=realtime,
    )
