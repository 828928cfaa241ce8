"""An arm that a person holds in a known pose: torque off, never on, and its servos' counts read some times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np

from calibration.servo_zeros import ReferenceJoint, ReferenceServo
from drivers.arm import Arm
from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.joints import JointConfig, ServoConfig
from drivers.servo_settings import LIMITED_MODE, check_model, mode_name
from station.emulated_arm import EmulatedArm
from station.errors import InvalidData
from station.formats.rig import EMULATED, RigTable
from station.logs import FloatArray
from station.motion import JointLimits
from station.rig import virtual_reply_timeout_s
from station.rig_reading import joint_configs

NS_PER_S = 1_000_000_000
READINGS = 20
BETWEEN_S = 0.05


@dataclass(frozen=True)
class OpenBus:
    """A rig's bus, its arm as far as it may be used with wrong zeros (it isn't connected), and their clock."""

    bus: DynamixelBus
    arm: Arm
    joints: tuple[JointConfig, ...]
    clock: Clock


@contextmanager
def open_bus(table: RigTable, name: str, *, simulate: bool) -> Iterator[OpenBus]:
    """Open the bus of a rig, or an emulated one, until the block ends.

    Raises:
        InvalidData: a simulation is asked for and not described.
        NoPort: the port can't be opened.
    """
    emulated = simulate or table.bus.port == EMULATED
    if emulated and table.simulation is None:
        raise InvalidData(f"{name} has no [simulation]: it can't run without its hardware")
    clock: Clock = VirtualClock() if emulated else MonotonicClock()
    with ExitStack() as stack:
        port, timeout_s = table.bus.port, None
        if emulated:
            port = stack.enter_context(EmulatedArm(table, table.simulation, clock)).path
            timeout_s = virtual_reply_timeout_s(table.simulation)
        bus = DynamixelBus(
            port, baud=table.bus.baud, protocol=table.bus.protocol, clock=clock, reply_timeout_s=timeout_s
        )
        joints = joint_configs(table)
        yield OpenBus(stack.enter_context(bus), Arm(bus, joints, clock), joints, clock)


def reference_states(limits: tuple[JointLimits, ...], pose: Mapping[str, float]) -> FloatArray:
    """(J,) states of the reference pose, rad or m: as given (deg or mm), else zero.

    Raises:
        InvalidData: a joint that isn't there, or can't be where it is to be.
    """
    known = {joint.name: joint for joint in limits}
    for name in pose:
        if name not in known:
            raise InvalidData(f"no joint '{name}'; the rig has {', '.join(known)}")
    states = np.array(
        [(np.radians(1.0) if joint.unit == "rad" else 1e-3) * pose.get(joint.name, 0.0) for joint in limits]
    )
    for joint, state in zip(limits, states.tolist(), strict=True):
        if not joint.lower - 1e-9 <= state <= joint.upper + 1e-9:
            raise InvalidData(
                f"joint '{joint.name}' can't be at {joint.text(state)}: its limits are {joint.text(joint.lower)} to "
                f"{joint.text(joint.upper)}\nsay where it is held: --pose {joint.name}=..."
            )
    return states


def read_counts(opened: OpenBus) -> dict[int, list[int]]:
    """Each servo's count, some times over a second."""
    ids = [servo.id for joint in opened.joints for servo in joint.servos]
    counts: dict[int, list[int]] = {servo_id: [] for servo_id in ids}
    for _ in range(READINGS):
        for servo_id, reading in opened.bus.read_many(ids, "present_position").items():
            counts[servo_id].append(reading.value)
        opened.clock.sleep_until_ns(opened.clock.now_ns() + int(BETWEEN_S * NS_PER_S))
    return counts


def reference_joints(opened: OpenBus, states: FloatArray) -> tuple[ReferenceJoint, ...]:
    """The joints as the calibration takes them, with what their servos say of their modes and limits.

    Raises:
        NoReply, WrongModel: for a servo that isn't there, or another than the rig says.
    """
    for joint in opened.joints:
        for servo in joint.servos:
            check_model(opened.bus, joint, servo)
    return tuple(
        ReferenceJoint(
            joint.name,
            float(state),
            joint.lower,
            joint.upper,
            joint.unit,
            tuple(_reference_servo(opened.bus, servo) for servo in joint.servos),
        )
        for joint, state in zip(opened.joints, states, strict=True)
    )


def _reference_servo(bus: DynamixelBus, servo: ServoConfig) -> ReferenceServo:
    model = servo.table
    limited = mode_name(bus, servo.id, model) == LIMITED_MODE
    first, last = (bus.read(servo.id, name) for name in model.position_limit_registers) if limited else (None, None)
    return ReferenceServo(
        id=servo.id,
        sign=servo.sign,
        ratio=servo.ratio,
        rad_per_count=model.rad_per_count,
        zero=servo.zero,
        first=first,
        last=last,
        turn=None if limited else model.resolution,
        shares_zero=servo.ganging == "secondary_id",
    )
