"""From registers to motion: an emulated servo sets out for its goal, stops, gives up its torque, follows a leader."""

from __future__ import annotations

from drivers.emulator.body import OFF, Body, Control, Drive
from drivers.emulator.modes import bit, drive_of, profile_of, spin_of
from drivers.emulator.present import Present
from drivers.emulator.table import Table

_MOTION = frozenset(
    {
        "torque_enable", "torque_limit", "goal_position", "goal_velocity", "goal_current", "goal_pwm", "goal_torque",
        "moving_speed", "velocity_limit", "pwm_limit", "position_p_gain", "p_gain", "punch",
        "cw_compliance_margin", "ccw_compliance_margin", "cw_compliance_slope", "ccw_compliance_slope",
    }
)  # fmt: skip


class Steering:
    """Drives a body by a table's registers.

    Attributes:
        halted: by the bus watchdog, until a goal is written.
    """

    def __init__(
        self, table: Table, body: Body, present: Present, max_speed_rad_s: float, max_acceleration_rad_s2: float
    ) -> None:
        self._table, self._body, self._present = table, body, present
        self._max_speed_rad_s, self._max_acceleration_rad_s2 = max_speed_rad_s, max_acceleration_rad_s2
        self._leader: tuple[Body, int] | None = None
        self._following = False
        self.halted = False
        profile = {table.model.speed_register, table.model.acceleration_register}
        self._motion = _MOTION | profile | set(table.model.position_limit_registers)

    def concerns(self, names: set[str]) -> bool:
        """Whether a write to these registers makes a servo with torque set out anew."""
        return not self._motion.isdisjoint(names)

    def steer(self, t_ns: int) -> None:
        """Set out for the goal, from the present angle and speed."""
        if not self._table.get("torque_enable") or self.halted or self._slave():
            return
        drive = drive_of(self._table, self._present.frame)
        if drive.limit <= 0:
            self.release(t_ns)
            return
        self._body.drive(t_ns, drive)
        if drive.control is Control.POSITION:
            self._go(t_ns)
        else:
            self._spin(t_ns, drive)

    def stop(self, t_ns: int) -> None:
        """Stand still, with torque on."""
        self.halted = True
        drive = drive_of(self._table, self._present.frame)
        if drive.control in (Control.DUTY, Control.TORQUE):
            drive = Drive(drive.control, drive.limit, drive.full)
        self._brake(t_ns, drive)

    def release(self, t_ns: int) -> None:
        """No more torque: friction brings it to a stop."""
        self._brake(t_ns, OFF)

    def plug(self, leader: Body, sign: int, t_ns: int) -> None:
        """A sync cable leads to another servo's motor."""
        self._leader = leader, sign
        self.see_to_cable(t_ns)

    def see_to_cable(self, t_ns: int) -> None:
        """Follow, or stop following, as cable and drive mode say."""
        following = self._leader is not None and self._slave()
        if following != self._following:
            self._following = following
            leader, sign = self._leader if self._leader is not None and following else (None, 1)
            self._body.follow(t_ns, leader, sign)

    def _go(self, t_ns: int) -> None:
        goal = self._present.frame.rad(self._table.get("goal_position"))
        way = goal - self._body.profile.at(t_ns)[0]
        speed, acceleration = profile_of(self._table, way, 0.0, self._max_speed_rad_s, self._max_acceleration_rad_s2)
        # A limit of 0 would never arrive: no speed at all is as good as a brake.
        if speed <= 0:
            self._body.profile.brake(t_ns, acceleration)
        else:
            self._present.profile_phases = self._body.profile.move(t_ns, goal, speed, acceleration)

    def _spin(self, t_ns: int, drive: Drive) -> None:
        goal_rad_s = spin_of(self._table, self._present.frame, drive, self._max_speed_rad_s)
        acceleration = self._max_acceleration_rad_s2
        if drive.control is Control.SPEED:
            change = goal_rad_s - self._body.profile.at(t_ns)[1]
            _, acceleration = profile_of(self._table, 0.0, change, self._max_speed_rad_s, acceleration)
        self._body.profile.spin(t_ns, goal_rad_s, acceleration)

    def _brake(self, t_ns: int, drive: Drive) -> None:
        self._body.drive(t_ns, drive)
        self._body.profile.brake(t_ns, self._max_acceleration_rad_s2)

    def _slave(self) -> bool:
        return bit(self._table, "sync_cable_follower")
