"""Motor and shaft of an emulated servo under load: droop, play, obstructions, and a motor of limited torque.

Inertia is left out but for the limit of acceleration: at each time motor, spring of the position control and load are
in balance, and the motor can't turn faster than the line from its no-load speed to its stall torque allows.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

from drivers.emulator.shaft import BEGINNING_NS, HISTORY_NS, Shaft
from drivers.errors import DriverError

STEP_NS = 10_000_000  # under load the state is settled at the multiples of this time; the load is held in between
# Guesses, parts of the stall torque: the manuals tell nothing of friction or inertia.
FRICTION = 0.05
INERTIA = 0.3  # what the greatest acceleration takes
_SPEED_OVER_NS = 1_000_000  # under load, speed is told from the way over this time
_SAME_RAD = 1e-9  # angles nearer than this are the same
_FULL = 1 - 1e-9


@dataclass(frozen=True, slots=True)
class Ramp:
    """What position control puts out by the distance from the goal: nothing up to `dead_rad`, then `punch` and more."""

    dead_rad: float
    punch: float
    per_rad: float

    def output(self, distance_rad: float) -> float:
        """Output at a distance, a part of the stall torque; more than 1 isn't to be had."""
        return 0.0 if distance_rad <= self.dead_rad else self.punch + self.per_rad * (distance_rad - self.dead_rad)

    def distance(self, output: float) -> float:
        """Distance at which it puts this out."""
        return self.dead_rad + max(0.0, output - self.punch) / self.per_rad if output > 0 else 0.0


@dataclass(frozen=True, slots=True)
class Spring:
    """Position control: `clockwise` counts where the shaft stands clockwise of the goal."""

    clockwise: Ramp
    anticlockwise: Ramp

    def output(self, error_rad: float) -> float:
        """Output for goal minus shaft."""
        return self.clockwise.output(error_rad) if error_rad > 0 else -self.anticlockwise.output(-error_rad)

    def error(self, output: float) -> float:
        """Goal minus shaft at this output."""
        return self.clockwise.distance(output) if output > 0 else -self.anticlockwise.distance(-output)


class Control(Enum):
    """What the motor's output serves."""

    TORQUE = "torque"
    DUTY = "duty"
    SPEED = "speed"
    POSITION = "position"
    HAND = "hand"  # no motor: a hand takes the shaft where the profile says


@dataclass(frozen=True, slots=True)
class Drive:
    """How the motor is driven.

    Attributes:
        limit: the most output, a part of the stall torque.
        full: an output of this much is an overload, if it lasts.
        output: of TORQUE and DUTY.
        spring: of POSITION.
    """

    control: Control
    limit: float = 0.0
    full: float = 1.0
    output: float = 0.0
    spring: Spring | None = None


OFF = Drive(Control.TORQUE)
HAND = Drive(Control.HAND)


@dataclass(frozen=True, slots=True)
class Lead:
    """A body whose motor turns this one: shaft = sign * its shaft + offset_rad."""

    body: Body
    sign: int
    offset_rad: float


@dataclass(frozen=True, slots=True)
class _Knot:
    """The state at a time, and what holds from then on.

    Attributes:
        rigid: motor and shaft are where the profile says: no load, no play, nothing in the way.
        load: torque on the shaft from outside, a part of the stall torque.
        lagging: the motor fell behind the profile since the knot before.
        resting: nothing has moved since the knot before, and nothing will until something else happens.
    """

    t_ns: int
    motor_rad: float
    shaft_rad: float
    drive: Drive = OFF
    rigid: bool = True
    load: float = 0.0
    lagging: bool = False
    resting: bool = False
    lower_rad: float = -math.inf
    upper_rad: float = math.inf
    lead: Lead | None = None


class Body:
    """The true shaft angle over the last HISTORY_NS; `profile` is where control wants it.

    Args:
        rad: where it stands at first.
        max_speed_rad_s, stall_nm: no-load speed and stall torque of the motor.
        max_acceleration_rad_s2: of the profile, for the output that inertia takes.
        backlash_rad: play between motor and shaft.
        load_nm: torque on the shaft from outside at a time, positive anticlockwise. It is asked once for each multiple
            of STEP_NS, in order, and may ask any servo for its angle at that time.
    """

    def __init__(
        self,
        rad: float,
        *,
        max_speed_rad_s: float,
        stall_nm: float,
        max_acceleration_rad_s2: float,
        backlash_rad: float,
        load_nm: Callable[[int], float] | None,
    ) -> None:
        self.profile = Shaft(rad)
        self._max_speed_rad_s, self._stall_nm = max_speed_rad_s, stall_nm
        self._max_acceleration_rad_s2 = max_acceleration_rad_s2
        self._backlash_rad, self._load_nm = backlash_rad, load_nm
        self._knots = [_Knot(BEGINNING_NS, rad, rad)]
        self._times = [BEGINNING_NS]

    @property
    def rigid(self) -> bool:
        """Whether the shaft is where the profile says, so that nothing needs to be settled."""
        return self._knots[-1].rigid

    @property
    def resting(self) -> bool:
        """Whether it needn't be settled until something happens to it."""
        return self._knots[-1].resting

    def at(self, t_ns: int) -> tuple[float, float]:
        """Angle (rad) and speed (rad/s); raises DriverError for a time before the history."""
        knot = self._knot(t_ns)
        if knot.rigid:
            return self.profile.at(t_ns)
        if knot.lead is not None:
            rad, rad_s = knot.lead.body.at(t_ns)
            return knot.lead.sign * rad + knot.lead.offset_rad, knot.lead.sign * rad_s
        rad = self._state(knot, t_ns)[1]
        before_ns = t_ns - _SPEED_OVER_NS
        return rad, (rad - self._rad(max(before_ns, self._times[0]))) / (_SPEED_OVER_NS * 1e-9)

    def moving(self, t_ns: int) -> bool:
        """Whether control is still on its way."""
        lead = self._knot(t_ns).lead
        return self.profile.moving(t_ns) if lead is None else lead.body.moving(t_ns)

    def output(self, t_ns: int) -> float:
        """What the motor gives at a time, a part of the stall torque, positive anticlockwise."""
        knot = self._knot(t_ns)
        if knot.lead is not None:
            return knot.lead.sign * knot.lead.body.output(t_ns)
        drive = knot.drive
        if drive.control in (Control.TORQUE, Control.HAND):
            return drive.output
        if drive.control is Control.DUTY:  # a direct-current motor: the speed takes its part of the voltage
            return drive.output - self.at(t_ns)[1] / self._max_speed_rad_s
        goal, rad_s = self.profile.at(t_ns)
        effort = FRICTION * ((rad_s > 0) - (rad_s < 0))
        effort += INERTIA * self.profile.acceleration(t_ns) / self._max_acceleration_rad_s2
        if knot.rigid:
            return effort
        if drive.spring is not None:
            effort += drive.spring.output(goal - self._state(knot, t_ns)[0])
        else:
            effort += math.copysign(drive.limit, rad_s) if knot.lagging else -knot.load
        return _clip(effort, -drive.limit, drive.limit)

    def strain(self, t_ns: int) -> float:
        """Size of the output from a time on, as it heats; friction counts from the start of a motion."""
        knot = self._knot(t_ns)
        if not knot.rigid or knot.drive.control in (Control.TORQUE, Control.HAND):
            return abs(self.output(t_ns))
        inertia = abs(self.profile.acceleration(t_ns)) / self._max_acceleration_rad_s2
        return INERTIA * inertia + FRICTION * self.profile.moving(t_ns)

    def saturated(self, t_ns: int) -> bool:
        """Whether the motor gave all that it has just before a time, and still didn't get where it was told."""
        knot = self._knot(t_ns - 1)
        if knot.lead is not None:
            return knot.lead.body.saturated(t_ns)
        drive = knot.drive
        if knot.rigid or drive.limit <= 0 or drive.limit < drive.full * _FULL:
            return False
        if drive.spring is not None:
            error = self.profile.at(knot.t_ns)[0] - knot.motor_rad
            return abs(drive.spring.output(error)) >= drive.limit * _FULL
        if drive.control is Control.SPEED:
            return knot.lagging
        return abs(drive.output) >= drive.limit * _FULL and self._pinned(knot)

    def settle(self, t_ns: int) -> None:
        """Fix the state at a time, and ask for the load from then on."""
        last = self._knots[-1]
        if last.lead is not None:
            return
        loose = self._load_nm is not None or self._backlash_rad > 0 or not self._open(last)
        if last.rigid and not loose:
            return
        t_ns = max(t_ns, last.t_ns)
        self._add(self._settled(last, t_ns))
        if self._load_nm is not None:  # the knot is there already: the load may ask where this shaft is
            self._add(replace(self._knots[-1], load=self._load_nm(t_ns) / self._stall_nm))
        if not loose:
            self._rejoin(t_ns)

    def drive(self, t_ns: int, drive: Drive) -> None:
        """From `t_ns` on, drive the motor so; the profile goes on from where the motor is."""
        self.settle(t_ns)
        last = self._knots[-1]
        if not last.rigid and last.lead is None:
            goal = self.profile.at(last.t_ns)[0]
            held = 0.0
            if last.drive.spring is not None and drive.spring is not None:
                held = last.drive.spring.error(_clip(-last.load, -last.drive.limit, last.drive.limit))
            gap = last.motor_rad + held - goal
            if abs(gap) > _SAME_RAD:
                self.profile.shift(last.t_ns, gap)
        if drive != last.drive:
            self._add(replace(last, t_ns=max(t_ns, last.t_ns), drive=drive, resting=False, **self._here(last, t_ns)))

    def obstruct(self, t_ns: int, lower_rad: float, upper_rad: float) -> None:
        """From `t_ns` on the shaft can't leave this range; a bound that it is past already is where it stands."""
        if self._knots[-1].lead is not None:  # it stands where its leader does
            return
        motor, shaft = self._state(self._knots[-1], t_ns)
        lower, upper = min(lower_rad, shaft), max(upper_rad, shaft)
        loose = replace(self._knots[-1], rigid=False, resting=False, lower_rad=lower, upper_rad=upper)
        self._add(replace(loose, t_ns=max(t_ns, loose.t_ns), motor_rad=motor, shaft_rad=shaft))
        self.settle(t_ns)

    def follow(self, t_ns: int, leader: Body | None, sign: int) -> None:
        """From `t_ns` on, turn as another body does, or, with None, on its own again."""
        last = self._knots[-1]
        t_ns = max(t_ns, last.t_ns)
        shaft = self._rad(t_ns)
        if leader is None:
            self.profile.shift(t_ns, shaft - self.profile.at(t_ns)[0])
            self._add(_Knot(t_ns, shaft, shaft))
            self.settle(t_ns)
        else:
            lead = Lead(leader, sign, shaft - sign * leader.at(t_ns)[0])
            self._add(_Knot(t_ns, shaft, shaft, rigid=False, lead=lead))

    def forget(self, t_ns: int) -> None:
        """Give up what is longer than HISTORY_NS before a time."""
        first = bisect.bisect_right(self._times, t_ns - HISTORY_NS) - 1
        if first > 0:
            del self._knots[:first], self._times[:first]

    def _here(self, knot: _Knot, t_ns: int) -> dict[str, float]:
        motor, shaft = self._state(knot, max(t_ns, knot.t_ns))
        return {"motor_rad": motor, "shaft_rad": shaft}

    def _add(self, knot: _Knot) -> None:
        if knot.t_ns == self._times[-1]:
            self._knots[-1] = knot
        else:
            self._knots.append(knot)
            self._times.append(knot.t_ns)

    def _knot(self, t_ns: int) -> _Knot:
        if t_ns >= self._times[-1]:
            return self._knots[-1]
        if t_ns < self._times[0]:
            raise DriverError(f"the shaft's angle is known for the last {HISTORY_NS * 1e-9:g} s only")
        return self._knots[bisect.bisect_right(self._times, t_ns) - 1]

    def _rad(self, t_ns: int) -> float:
        knot = self._knot(t_ns)
        if knot.lead is not None:
            return knot.lead.sign * knot.lead.body.at(t_ns)[0] + knot.lead.offset_rad
        return self._state(knot, t_ns)[1]

    def _open(self, knot: _Knot) -> bool:
        return knot.lower_rad == -math.inf and knot.upper_rad == math.inf

    def _pinned(self, knot: _Knot) -> bool:
        half = self._backlash_rad / 2
        return not knot.lower_rad - half < knot.motor_rad < knot.upper_rad + half

    def _settled(self, knot: _Knot, t_ns: int) -> _Knot:
        motor, shaft = self._state(knot, t_ns)
        lagging = knot.lagging
        if t_ns > knot.t_ns and not knot.rigid:
            way = self.profile.at(t_ns)[0] - self.profile.at(knot.t_ns)[0]
            lagging = abs(way - (motor - knot.motor_rad)) > _SAME_RAD
        still = t_ns > knot.t_ns and (motor, shaft) == (knot.motor_rad, knot.shaft_rad)
        return replace(
            knot,
            t_ns=t_ns,
            motor_rad=motor,
            shaft_rad=shaft,
            rigid=False,
            lagging=lagging,
            resting=still and self._load_nm is None and not self.profile.moving(t_ns),
        )

    def _rejoin(self, t_ns: int) -> None:
        """Without load, play and obstruction, be rigid again as soon as the motor is where the profile says."""
        last = self._knots[-1]
        gap = last.motor_rad - self.profile.at(t_ns)[0]
        if last.drive.spring is None and gap:
            self.profile.shift(t_ns, gap)
        elif abs(gap) > _SAME_RAD:
            return
        self._add(replace(last, rigid=True, load=0.0, lagging=False))

    def _state(self, knot: _Knot, t_ns: int) -> tuple[float, float]:
        """Motor and shaft at a time, from the state at the knot before."""
        if knot.rigid:
            rad = self.profile.at(t_ns)[0]
            return rad, rad
        if t_ns == knot.t_ns:
            return knot.motor_rad, knot.shaft_rad
        dt = (t_ns - knot.t_ns) * 1e-9
        half = self._backlash_rad / 2
        way = self._way(knot, t_ns, dt)
        motor = _clip(knot.motor_rad + way, knot.lower_rad - half, knot.upper_rad + half)
        if knot.load == 0:
            shaft = _clip(knot.shaft_rad, motor - half, motor + half)
        else:  # the load holds it against one side of the play, and takes it there no faster than the motor turns
            reach = abs(motor - knot.motor_rad) + self._max_speed_rad_s * dt
            side = motor + math.copysign(half, knot.load)
            shaft = knot.shaft_rad + _clip(side - knot.shaft_rad, -reach, reach)
        return motor, _clip(shaft, knot.lower_rad, knot.upper_rad)

    def _way(self, knot: _Knot, t_ns: int, dt: float) -> float:
        """How far the motor would turn since the knot if nothing were in the way."""
        drive, load = knot.drive, knot.load
        if drive.control is Control.HAND:
            return self.profile.at(t_ns)[0] - self.profile.at(knot.t_ns)[0]
        if drive.control is Control.TORQUE:
            net = drive.output + load
            return math.copysign(max(0.0, abs(net) - FRICTION), net) * self._max_speed_rad_s * dt
        if drive.control is Control.DUTY:
            way = self.profile.at(t_ns)[0] - self.profile.at(knot.t_ns)[0]
            return way + load * self._max_speed_rad_s * dt
        if drive.spring is not None:
            held = drive.spring.error(_clip(-load, -drive.limit, drive.limit))
            way = self.profile.at(t_ns)[0] - held - knot.motor_rad
        else:
            way = self.profile.at(t_ns)[0] - self.profile.at(knot.t_ns)[0]
        # a direct-current motor: speed / no-load speed = output + load / stall torque
        slowest, fastest = (load - drive.limit), (load + drive.limit)
        return _clip(way, slowest * self._max_speed_rad_s * dt, fastest * self._max_speed_rad_s * dt)


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
