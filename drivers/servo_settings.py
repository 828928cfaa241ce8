"""Whether a servo is set up so that the arm can use it: found before anything is written."""

from __future__ import annotations

from collections.abc import Iterator

from drivers.dynamixel import DynamixelBus
from drivers.errors import ArmFault, NoReply, ServoFault, WrongModel
from drivers.joints import JointConfig, ServoConfig
from drivers.safety import ServoRange
from drivers.servo_models import ServoModel

ALL_STATUS = 2  # Status Return Level: every instruction is answered
# Operating modes in which goals are positions; the servo's own limits hold in the first alone.
LIMITED_MODE = "position"
POSITION_MODES = (LIMITED_MODE, "extended_position", "current_based_position")


def check_model(bus: DynamixelBus, joint: JointConfig, servo: ServoConfig) -> None:
    """Raise NoReply for a servo that isn't there, WrongModel for another than configured."""
    want = servo.table
    have = bus.ping(servo.id)
    if have != want.model_number:
        raise WrongModel(
            f"servo {servo.id} ({joint.name}) on {bus.where} answers with model number {have}; "
            f"{want.name} is {want.model_number}: check 'model' and 'id' in rig.toml",
            servo_id=servo.id, joint=joint.name, have=have, want=want.model_number,
        )  # fmt: skip


def check_settings(bus: DynamixelBus, joint: JointConfig, servo: ServoConfig) -> ServoRange:
    """See that a servo answers, takes positions, follows whom it should and reaches the joint's limits.

    Returns:
        The limits of temperature and voltage that it keeps itself.

    Raises:
        NoReply: it answers pings, but no reads.
        ServoFault: for settings under which the driver can't work.
        ArmFault: the joint's limits are wider than the servo's.
    """
    model = servo.table
    _check_status_level(bus, joint, servo)
    for complaint in (*_mode(bus, servo, model), *following(bus, joint, servo, model)):
        text = f"servo {servo.id} ({joint.name}) on {bus.where} {complaint}"
        raise ServoFault(text, servo_id=servo.id, joint=joint.name)
    _check_limits(bus, joint, servo, model)
    temperature, low, high = (
        model.registers[name].physical(bus.read(servo.id, name))
        for name in ("temperature_limit", "min_voltage_limit", "max_voltage_limit")
    )
    return ServoRange(max_temperature_c=temperature, min_voltage_v=low, max_voltage_v=high)


def mode_name(bus: DynamixelBus, servo_id: int, model: ServoModel) -> str:
    """Name of a servo's operating mode; of protocol 1.0 firmware "wheel" or "position", as its limits make it."""
    if model.operating_mode_register is None:
        limits = [bus.read(servo_id, name) for name in model.position_limit_registers]
        return "position" if any(limits) else "wheel"
    value = bus.read(servo_id, model.operating_mode_register)
    return next((name for name, code in model.operating_modes.items() if code == value), f"unknown ({value})")


def _check_status_level(bus: DynamixelBus, joint: JointConfig, servo: ServoConfig) -> None:
    who = f"servo {servo.id} ({joint.name}) on {bus.where}"
    try:
        level = bus.read(servo.id, "status_return_level")
    except NoReply as error:
        text = f"{who} answers pings, but no reads; its status return level may be 0, it must be {ALL_STATUS}"
        raise NoReply(text, servo_id=servo.id, joint=joint.name) from error
    if level != ALL_STATUS:
        text = f"{who} answers reads, but no writes: its status return level is {level}, set it to {ALL_STATUS}"
        raise ServoFault(text, servo_id=servo.id, joint=joint.name)


def _mode(bus: DynamixelBus, servo: ServoConfig, model: ServoModel) -> Iterator[str]:
    mode = mode_name(bus, servo.id, model)
    if mode not in POSITION_MODES:
        yield f"is in {mode} mode; set it to position control (operating mode, or its position limits)"
    if "drive_mode" not in model.registers:
        return
    drive = bus.read(servo.id, "drive_mode")
    bits = {name: bool(drive >> bit & 1) for bit, name in model.drive_mode_bits.items()}
    if bits.get("time_based_profile"):
        yield "has a time-based profile; clear bit 2 of its drive mode"
    if servo.reversed is not None and bits["reverse"] != servo.reversed:
        want, have = ("on", "off") if servo.reversed else ("off", "on")
        yield f"has the reverse bit of its drive mode {have}; the rig wants it {want} ('reversed' in rig.toml)"


def following(bus: DynamixelBus, joint: JointConfig, servo: ServoConfig, model: ServoModel) -> Iterator[str]:
    """What is wrong with whom a servo follows, as the rest of a sentence about it."""
    leader = joint.servos[0].id
    if servo.ganging == "secondary_id" and (have := bus.read(servo.id, "secondary_id")) != leader:
        yield f"has secondary id {have}; to follow servo {leader} it must be {leader}"
    if "secondary_id" in model.registers and servo.ganging != "secondary_id":
        other = bus.read(servo.id, "secondary_id")
        if other in {each.id for each in joint.servos if each.id != servo.id}:
            yield f"takes the goals of servo {other} by its secondary id; say ganging = secondary_id, or switch it off"
    if servo.ganging == "sync_cable":
        bit = next(bit for bit, name in model.drive_mode_bits.items() if name == "sync_cable_follower")
        if not bus.read(servo.id, "drive_mode") >> bit & 1:
            yield f"isn't set to follow by its sync cable; set bit {bit} of its drive mode"


def _check_limits(bus: DynamixelBus, joint: JointConfig, servo: ServoConfig, model: ServoModel) -> None:
    """A goal outside the servo's own limits would be refused, and a sync write wouldn't tell."""
    if not servo.takes_goals or mode_name(bus, servo.id, model) != LIMITED_MODE:
        return
    low, high = (bus.read(servo.id, name) for name in model.position_limit_registers)
    ends = joint.counts(servo)
    if ends[0] < low or ends[1] > high:
        raise ArmFault(
            f"servo {servo.id} ({joint.name}) on {bus.where} goes from count {low} to {high}, the joint's limits are "
            f"{ends[0]} to {ends[1]}; narrow the joint's limits in rig.toml, or widen the servo's own",
            joint=joint.name,
        )
