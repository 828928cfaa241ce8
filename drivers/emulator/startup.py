"""What an emulated servo's registers hold when it is delivered, switched on, or put into another mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.emulator.modes import Frame, Mode, frame_of, mode_of
from drivers.emulator.table import Table
from drivers.errors import DriverError


def configure(table: Table, id: int, protocol: float | None, eeprom: Mapping[str, int]) -> list[str]:
    """Set the registers that the owner configured; their names, which the first power-up is to keep."""
    model = table.model
    for name, value in eeprom.items():
        register = model.register(name)
        if register.area != "EEPROM":
            raise DriverError(f"{model.name}'s register '{name}' isn't in the EEPROM area: it isn't kept")
        register.encode(value)  # refuses what doesn't fit
        table.set(name, value)
    kept = [*eeprom, "id"]
    if protocol is not None:
        if protocol not in model.protocols:
            spoken = " and ".join(f"{known:.1f}" for known in model.protocols)
            raise DriverError(f"servo {id}: {model.name} speaks protocol {spoken}, not {protocol:.1f}")
        if "protocol_type" in table:
            table.set("protocol_type", int(protocol))
            kept.append("protocol_type")
    table.set("id", id)
    return kept


def power_up(table: Table, rad: float, keep: Sequence[str]) -> Frame:
    """Registers to their initial values, but for those to keep; the frame of the counts of a shaft that stands at rad.

    Whole turns are forgotten (e-manual, Present Position (132)).
    """
    table.power_up(keep)
    frame = one_turn(table, rad)
    table.set("goal_position", frame.count(rad))
    if "torque_limit" in table:  # e-manual, Max Torque (14): Torque Limit's value at power-up
        table.set("torque_limit", table.get("max_torque"))
    _reset_goals(table)
    return frame


def one_turn(table: Table, rad: float) -> Frame:
    """The frame in which a shaft angle's count is in the first turn."""
    return frame_of(table, frame_of(table, 0).turns_of(rad))


def enter_mode(table: Table, frame: Frame, rad: float) -> None:
    """e-manual, Operating Mode (11): the profile and the goals' limits are reset.

    Unverified: that the goals of position and velocity are as well.
    """
    for name in (table.model.speed_register, table.model.acceleration_register, "goal_velocity"):
        if name is not None and name in table:
            table.set(name, 0)
    _reset_goals(table)
    table.set("goal_position", frame.count(rad))


def _reset_goals(table: Table) -> None:
    """e-manual, Operating Mode (11): PWM and current goals are reset to their limits.

    Unverified: at power-up as well; in the modes of which they are the goal they are 0 here.
    """
    mode = mode_of(table)
    for goal, limit, own in (("goal_pwm", "pwm_limit", Mode.PWM), ("goal_current", "current_limit", Mode.CURRENT)):
        if goal in table:
            table.set(goal, 0 if mode is own else table.get(limit))
