"""What an emulated servo's registers tell its motor: mode, goal, limits, stiffness, and the frame of its counts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from functools import cache

from drivers.emulator.body import FRICTION, OFF, Control, Drive, Ramp, Spring
from drivers.emulator.shaft import limits_for_duration
from drivers.emulator.table import Table
from drivers.servo_models import ServoModel

_TURN_RAD = 2 * math.pi
HOMING_LIMIT = 1024  # e-manual, Homing Offset (20): in position mode, one over this is ignored
# Position P gains of the registers per unit of output and count: X-series manual, Position P Gain (84): gain / 128;
# MX manual, P Gain (28): gain / 8. Unverified: that the outputs are in units of PWM and of load, and XL-320 as MX.
_X_GAIN, _MX_GAIN = 128, 8
_FULL_PWM, _FULL_LOAD = 885, 1023


class Mode(Enum):
    """What a servo controls; the X series' names."""

    CURRENT = "current"
    VELOCITY = "velocity"
    POSITION = "position"
    EXTENDED_POSITION = "extended_position"
    CURRENT_BASED_POSITION = "current_based_position"
    PWM = "pwm"

    @property
    def positions(self) -> bool:
        """Whether it goes to a goal position."""
        return self in (Mode.POSITION, Mode.EXTENDED_POSITION, Mode.CURRENT_BASED_POSITION)


@dataclass(frozen=True, slots=True)
class Frame:
    """Where a servo's counts are on its shaft.

    A reversed servo's counts run clockwise, mirrored at the zero count. Unverified: where the manual has the mirror.

    Attributes:
        sign: -1 if reversed.
        offset: counts that are added to all positions.
        turns: whole turns that the servo forgot.
        divider: counts of the table in one count of the servo.
    """

    model: ServoModel
    sign: int
    offset: int
    turns: int
    divider: int

    def count(self, rad: float) -> int:
        """The position count of a shaft angle."""
        return self.model.count(self.sign * rad - self.turns * _TURN_RAD) // self.divider + self.offset

    def rad(self, count: int) -> float:
        """The shaft angle of a position count."""
        turned = self.model.rad((count - self.offset) * self.divider) + self.turns * _TURN_RAD
        return -turned if self.sign < 0 else turned

    def turns_of(self, rad: float) -> int:
        """Whole turns to forget so that a shaft angle's count is in the first one."""
        if potentiometer(self.model):
            return round(self.sign * rad / _TURN_RAD)
        return self.model.count(self.sign * rad) // self.model.resolution


def potentiometer(model: ServoModel) -> bool:
    """Whether its sensor covers 300 deg and no more: AX and XL-320."""
    return model.resolution == 1024


def bit(table: Table, name: str) -> bool:
    """Whether a bit of Drive Mode is set, by its name in the model's `drive_mode_bits`."""
    if "drive_mode" not in table:
        return False
    return bool(table.get("drive_mode") & _drive_mode_masks(table.model).get(name, 0))


def mode_of(table: Table) -> Mode:
    """The mode that the registers set."""
    model = table.model
    if model.operating_mode_register is not None:
        return _modes(model).get(table.get(model.operating_mode_register), Mode.POSITION)
    if "torque_control_mode_enable" in table and table.get("torque_control_mode_enable"):
        return Mode.CURRENT
    low, high = (table.get(name) for name in model.position_limit_registers)
    if low == high == 0:  # AX manual, Moving Speed (32): in wheel mode a unit is 0.1 % of the output; MX: a speed
        return Mode.PWM if potentiometer(model) else Mode.VELOCITY
    multi_turn = "multi_turn_offset" in table and low == high == model.resolution - 1
    return Mode.EXTENDED_POSITION if multi_turn else Mode.POSITION


@cache
def _modes(model: ServoModel) -> dict[int, Mode]:
    modes = {code: Mode(name) for name, code in model.operating_modes.items()}
    if potentiometer(model):  # XL-320 manual, Moving Speed (32): in wheel mode a unit is 0.1 % of the output
        return {code: Mode.PWM if mode is Mode.VELOCITY else mode for code, mode in modes.items()}
    return modes


@cache
def _drive_mode_masks(model: ServoModel) -> dict[str, int]:
    return {name: 1 << at for at, name in model.drive_mode_bits.items()}


def frame_of(table: Table, turns: int) -> Frame:
    """The frame of the servo's counts."""
    mode, offset, divider = mode_of(table), 0, 1
    reverse = bit(table, "reverse")
    if "homing_offset" in table:
        offset = table.get("homing_offset")
        if mode is Mode.POSITION and abs(offset) > HOMING_LIMIT:
            offset = 0
    elif "multi_turn_offset" in table:
        if mode is Mode.EXTENDED_POSITION:  # MX manual, Multi Turn Offset (20), Resolution Divider (22): this mode only
            offset, divider = table.get("multi_turn_offset"), max(1, table.get("resolution_divider"))
        reverse = reverse and mode.positions  # MX-106 manual, Drive Mode (10): not in wheel mode
    return Frame(table.model, -1 if reverse else 1, offset, turns, divider)


def spring_of(table: Table) -> Spring | None:
    """How position control answers to a distance from the goal; None if it doesn't. Integral gain isn't emulated."""
    per_count = table.model.rad_per_count
    if "cw_compliance_slope" in table:
        return Spring(_compliance(table, "cw"), _compliance(table, "ccw"))
    if "position_p_gain" in table:
        per_rad = table.get("position_p_gain") / _X_GAIN / _FULL_PWM / per_count
    else:
        per_rad = table.get("p_gain") / _MX_GAIN / _FULL_LOAD / per_count
    ramp = Ramp(0.0, 0.0, per_rad)
    return Spring(ramp, ramp) if per_rad > 0 else None


def _compliance(table: Table, side: str) -> Ramp:
    """AX manual, Compliance Slope (28): of the register's value its highest bit counts, at least 2.

    Unverified: that full output is that many counts beyond the margin (the manual's figure has no numbers), and which
    side is which.
    """
    per_count = table.model.rad_per_count
    slope = max(2, 1 << max(0, table.get(f"{side}_compliance_slope").bit_length() - 1))
    punch = min(table.get("punch"), _FULL_LOAD) / _FULL_LOAD
    # never flat: Punch at its maximum would leave nothing for the slope
    return Ramp(table.get(f"{side}_compliance_margin") * per_count, punch, max(1 - punch, 1e-3) / (slope * per_count))


def drive_of(table: Table, frame: Frame) -> Drive:
    """How the motor is driven while torque is on."""
    mode = mode_of(table)
    limit = _output_limit(table, mode)
    if limit <= 0:
        return OFF
    match mode:
        case Mode.PWM:
            return Drive(Control.DUTY, limit, limit, output=_duty(table, frame, limit))
        case Mode.CURRENT:
            return Drive(Control.TORQUE, limit, limit, output=_torque(table, frame, limit))
        case Mode.VELOCITY:
            return Drive(Control.SPEED, limit, limit)
        case _:
            spring, full = spring_of(table), limit
            if mode is Mode.CURRENT_BASED_POSITION:  # pressing with Goal Current is no overload
                limit = min(limit, abs(_amount(table, "goal_current")) / table.model.stall_a)
            if spring is None or limit <= 0:
                return OFF
            return Drive(Control.POSITION, limit, full, spring=spring)


def spin_of(table: Table, frame: Frame, drive: Drive, max_speed_rad_s: float) -> float:
    """The speed that it is to turn at with no load, in the modes without goal position; rad/s of the shaft."""
    if drive.control is Control.DUTY:
        return drive.output * max_speed_rad_s
    if drive.control is Control.TORQUE:
        return math.copysign(max(0.0, abs(drive.output) - FRICTION), drive.output) * max_speed_rad_s
    name = "goal_velocity" if "goal_velocity" in table else table.model.speed_register
    speed, most = frame.sign * _amount(table, name), _speed_cap(table, max_speed_rad_s)
    return min(max(speed, -most), most)


def profile_of(
    table: Table, distance_rad: float, change_rad_s: float, max_speed_rad_s: float, max_acceleration_rad_s2: float
) -> tuple[float, float]:
    """Limits of speed and acceleration of a motion over a distance, or of a change of speed."""
    speed, acceleration, model = _speed_cap(table, max_speed_rad_s), max_acceleration_rad_s2, table.model
    limit = table.get(model.speed_register)
    ramp = 0 if model.acceleration_register is None else table.get(model.acceleration_register)
    if bit(table, "time_based_profile"):  # X-series manual, Profile Velocity (112): both in ms
        if not mode_of(table).positions:
            return speed, min(acceleration, abs(change_rad_s) * 1000 / ramp) if ramp and change_rad_s else acceleration
        return limits_for_duration(distance_rad, limit * 1e-3, ramp * 1e-3, speed, acceleration)
    if limit:
        speed = min(speed, abs(limit) * model.speed_unit_rad_s)
    unit = model.acceleration_unit_rad_s2
    if ramp and unit:
        acceleration = min(acceleration, ramp * unit)
    return speed, acceleration


def _speed_cap(table: Table, max_speed_rad_s: float) -> float:
    speed = max_speed_rad_s
    if "velocity_limit" in table:
        speed = min(speed, table.get("velocity_limit") * table.model.speed_unit_rad_s)
    return speed


def _output_limit(table: Table, mode: Mode) -> float:
    """The most output, a part of the stall torque."""
    if "torque_limit" in table:
        return min(1.0, table.get("torque_limit") / _FULL_LOAD)
    limit = table.get("pwm_limit")
    if mode is not Mode.PWM:  # X-series manual, Position PID Gain (80, 82, 84), step 5: Goal PWM limits the output
        limit = min(limit, abs(table.get("goal_pwm")))
    return min(1.0, limit / _FULL_PWM)


def _duty(table: Table, frame: Frame, limit: float) -> float:
    if "goal_pwm" in table:
        duty = frame.sign * table.get("goal_pwm") / _FULL_PWM
    else:
        duty = table.get(table.model.speed_register) / _FULL_LOAD
    return min(max(duty, -limit), limit)


def _torque(table: Table, frame: Frame, limit: float) -> float:
    name = "goal_current" if "goal_current" in table else "goal_torque"
    return min(max(frame.sign * _amount(table, name) / table.model.stall_a, -limit), limit)


def _amount(table: Table, name: str) -> float:
    return table.registers[name].physical(table.get(name))
