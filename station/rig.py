"""From rig.toml to open devices: the real bus and camera, or the emulated bus and the rendered camera.

Whether a rig is real or simulated is decided here, once; all else works on a Rig and can't tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from drivers.addresses import without_secrets
from drivers.arm import Arm
from drivers.camera import Camera
from drivers.camera_sources import open_camera
from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.rendered_camera import RenderedCamera
from drivers.safety import SafetyLimits
from station.emulated_arm import EmulatedArm
from station.errors import InvalidData
from station.formats.rig import EMULATED, RENDERED, RigTable, load_calibration
from station.formats.simulation import SimulatedCamera, SimulationTable
from station.hand_motion import HandMotion, HandMovedObject
from station.perception.markers import MarkerTable
from station.rig_reading import joint_configs, read_rig
from station.stage import Stage
from station.stage_apart import StageApart

# On a virtual clock a slow machine must not make a reply late: waits for one are then real time, and generous.
VIRTUAL_REPLY_TIMEOUT_S = 10.0
# Where replies are kept away on purpose, so generous a wait for each would be a long one.
FAULTY_REPLY_TIMEOUT_S = 0.5
# On the real clock an emulated bus answers from a thread that a busy machine lets wait for as long as any other.
BUSY_REPLY_TIMEOUT_S = 0.5


@dataclass(frozen=True)
class RigFile:
    """A rig as it was read: its table, its text for the session's copy, and the camera's calibration.

    In the text, addresses have no passwords: it is recorded.
    """

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


def load_rig(name_or_path: str) -> RigFile:
    """Read a rig and its camera's calibration; raises InvalidFile."""
    table, text, path = read_rig(name_or_path)
    return RigFile(table, without_secrets(text), str(path), load_calibration(table, path.parent, str(path)))


@contextmanager
def open_rig(
    rig: RigFile,
    *,
    simulate: bool = False,
    realtime: bool = False,
    seed: int | None = None,
    by_hand: HandMotion | None = None,
) -> Iterator[Rig]:
    """Open a rig's devices and close them after.

    Args:
        simulate: use the emulated bus and the rendered camera whatever the rig names; needs a `[simulation]`.
        realtime: run simulated devices on the real clock; else they run on a virtual one, the same on any machine.
        seed: of everything random in the simulation; the rig's own if None.
        by_hand: what a hand does to the emulated arm, or to the simulated object of a rig without an arm.

    The arm of a rig without servos has no joints and no open port.

    Raises:
        InvalidData: a simulation is asked for and not described, or a rendered camera looks at a real arm.
        DriverError: a port or camera that isn't there.
    """
    table, simulation = rig.table, rig.table.simulation
    emulated, rendered = check_simulated(rig, simulate)
    virtual = rendered and not realtime
    clock: Clock = VirtualClock() if virtual else MonotonicClock()
    if simulation is not None and seed is None:
        seed = simulation.seed
    with ExitStack() as stack:
        bus = EmulatedArm(table, simulation, clock, seed=seed) if emulated and simulation is not None else None
        port = table.bus.port if bus is None else stack.enter_context(bus).path
        timeout_s = _reply_timeout_s(simulation, emulated=emulated, virtual=virtual)
        client = DynamixelBus(
            port, baud=table.bus.baud, protocol=table.bus.protocol, clock=clock, reply_timeout_s=timeout_s
        )
        arm = _arm_on(stack.enter_context(client) if table.joint else client, table, clock)
        if simulation is not None and rendered:
            stage = Stage(table, simulation, rig.camera_model, seed or 0)
            moved = bus or HandMovedObject(len(stage.joints), by_hand, clock.now_ns())
            camera: Camera = rendered_camera(table, simulation.camera, stage, moved, clock, realtime=not virtual)
        else:
            camera = real_camera(table, clock)
        if bus is not None and by_hand is not None:
            start_ns = clock.now_ns()
            for joint, state, speed, t_s in by_hand.pushes():
                bus.push(joint, state, speed, start_ns + round(t_s * 1e9))
        stack.callback(camera.close)
        camera.start()
        simulated_seed = seed if emulated or rendered else None
        yield Rig(table, clock, virtual, arm, camera, rig.camera_model, table.marker_table(), simulated_seed)


def check_simulated(rig: RigFile, simulate: bool) -> tuple[bool, bool]:
    """Whether the bus is emulated and the camera rendered; raises InvalidData where that can't be."""
    table = rig.table
    emulated = bool(table.joint) and (simulate or table.bus.port == EMULATED)
    rendered = simulate or table.camera.source == RENDERED
    if (emulated or rendered) and table.simulation is None:
        raise InvalidData(f"{rig.name} has no [simulation]: it can't run without its hardware")
    if rendered and table.joint and not emulated:
        raise InvalidData(
            f'{rig.name}: a rendered camera can\'t see a real arm; set port = "emulated" or a camera source'
        )
    return emulated, rendered


def _arm_on(bus: DynamixelBus, table: RigTable, clock: Clock) -> Arm:
    """A rig's arm on a bus."""
    return Arm(
        bus,
        joint_configs(table),
        clock,
        disagreement_rad=float(np.radians(table.safety.disagreement_deg)),
        limits=safety_limits(table),
    )


def _reply_timeout_s(simulation: SimulationTable | None, *, emulated: bool, virtual: bool) -> float | None:
    """How long, in real time, a reply is waited for; None: as long as real servos need."""
    if virtual:
        return virtual_reply_timeout_s(simulation)
    faulty = simulation is None or simulation.faults
    return BUSY_REPLY_TIMEOUT_S if emulated and not faulty else None


def virtual_reply_timeout_s(simulation: SimulationTable | None) -> float:
    """How long, in real time, a reply of a bus on a virtual clock is waited for."""
    return FAULTY_REPLY_TIMEOUT_S if simulation is not None and simulation.faults else VIRTUAL_REPLY_TIMEOUT_S


def frame_size(table: RigTable) -> tuple[int, int]:
    """(width, height) of the camera's frames."""
    return (table.camera.size_px[0], table.camera.size_px[1])


def real_camera(table: RigTable, clock: Clock) -> Camera:
    """The camera that the rig names, not started yet; raises CameraError for one that can't be."""
    camera = table.camera
    return open_camera(
        camera.source,
        size_px=frame_size(table),
        fps=camera.fps,
        clock=clock,
        stall_s=camera.stall_s,
        controls=camera.controls(),
    )


def safety_limits(table: RigTable) -> SafetyLimits:
    """The rig's thresholds as the arm takes them."""
    safety = table.safety
    return SafetyLimits(
        max_temperature_c=safety.max_temperature_c,
        min_voltage_v=safety.min_voltage_v,
        max_voltage_v=safety.max_voltage_v,
        max_load=safety.max_load,
        stall_load=safety.stall_load,
        stall_s=safety.stall_s,
        watchdog_s=safety.watchdog_s,
    )


class Moved(Protocol):
    """What has joints that move: an emulated arm, or an object in a hand."""

    def joint_states(self, t_ns: int) -> NDArray[np.float64]:
        """(J,) true states at a time of the clock, in the order of the stage."""
        ...


def rendered_camera(
    table: RigTable, camera: SimulatedCamera, stage: Stage, moved: Moved, clock: Clock, *, realtime: bool
) -> RenderedCamera:
    """The camera that sees what moves on its stage; not started yet.

    In real time a program of its own draws, as a real camera takes none of the capture's time.
    """
    apart = StageApart(stage) if realtime else None
    draw = stage.render if apart is None else apart.render
    shares = (np.arange(camera.blur_instants) + 0.5) / camera.blur_instants - 0.5
    # (instants, knots): each knot of the rolling shutter has all instants of the exposure.
    offsets_s = shares[:, None] * camera.exposure_s + stage.knots_s
    offsets_ns = np.round(offsets_s * 1e9).astype(int)

    def render(t_mid_ns: int, index: int) -> NDArray[np.uint8]:
        states = [moved.joint_states(t_mid_ns + offset) for offset in offsets_ns.ravel().tolist()]
        return draw(np.reshape(states, (*offsets_ns.shape, -1)), index)

    return RenderedCamera(
        render,
        size_px=frame_size(table),
        fps=table.camera.fps,
        exposure_s=camera.exposure_s,
        readout_s=stage.readout_s,
        latency_s=camera.latency_s,
        clock=clock,
        realtime=realtime,
        beside=lambda: apart or nullcontext(),
    )
