"""When to stop: temperature, voltage, load and stalls of an arm's joints, watched from reading to reading."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.errors import SafetyStop
from drivers.joints import JointConfig

# degC below the limit at which a servo switches itself off.
TEMPERATURE_MARGIN_C = 5.0
# A joint that has come this far in the time given to it isn't stalled; one that is this near has arrived.
STALL_TRAVEL = {"rad": math.radians(2.0), "m": 0.002}
# s. Supplies sag and loads peak as motors start: what passes sooner is no fault.
PERSISTENCE_S = 0.25
_NS = 1e-9


@dataclass(frozen=True, slots=True)
class ServoState:
    """What a servo says of itself.

    Attributes:
        speed_rad_s: of its shaft, positive anticlockwise.
        load: torque or current as a share of the most that the model has, with its sign.
    """

    count: int
    speed_rad_s: float
    load: float
    voltage_v: float
    temperature_c: float


@dataclass(frozen=True, slots=True)
class ServoRange:
    """The limits of temperature and voltage that a servo keeps itself."""

    max_temperature_c: float
    min_voltage_v: float
    max_voltage_v: float


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Thresholds of an arm; None takes the servo's own limit, of the temperature 5 degC less.

    Attributes:
        max_load: share of the most that the model has; None for no limit.
        stall_load: a joint that doesn't come nearer to its goal for `stall_s` while its load is above this share has
            stalled; `stall_s` = 0 switches that off.
        watchdog_s: servos that have a bus watchdog stop when they hear nothing for so long; 0 switches it off.
    """

    max_temperature_c: float | None = None
    min_voltage_v: float | None = None
    max_voltage_v: float | None = None
    max_load: float | None = None
    stall_load: float = 0.5
    stall_s: float = 1.0
    watchdog_s: float = 0.0


class _Since:
    """How long something has been so."""

    def __init__(self) -> None:
        self._start_ns: dict[tuple[int, str], int] = {}

    def seconds(self, key: tuple[int, str], t_ns: int, so: bool) -> float:
        if not so:
            self._start_ns.pop(key, None)
            return 0.0
        return (t_ns - self._start_ns.setdefault(key, t_ns)) * _NS

    def forget(self, key: tuple[int, str]) -> None:
        self._start_ns.pop(key, None)


class Watch:
    """Watches the joints of one arm.

    A temperature or voltage is told once, so that an arm which is being parked because of it can be parked. A load or
    a stall is told again whenever it has lasted again.

    Args:
        own: limits that each servo keeps itself, by id.
    """

    def __init__(self, joints: Sequence[JointConfig], limits: SafetyLimits, own: Mapping[int, ServoRange]) -> None:
        self._joints, self._limits, self._own = tuple(joints), limits, own
        self._since = _Since()
        self._told: set[tuple[int, str]] = set()
        self._from: dict[str, tuple[int, float]] = {}  # of each joint: since when it has been near which state

    def check(
        self, t_ns: int, states: Mapping[int, ServoState], q: Sequence[float], goals: Sequence[float] | None
    ) -> None:
        """Look at one reading.

        Args:
            states: of all servos, by id.
            q: (J,) states of the joints.
            goals: (J,) where they are commanded to; None where torque is off.

        Raises:
            SafetyStop: the first limit that isn't kept.
        """
        for j, joint in enumerate(self._joints):
            for servo in joint.servos:
                self._check_servo(t_ns, joint, servo.id, states[servo.id])
            if goals is not None:
                load = max(abs(states[servo.id].load) for servo in joint.servos)
                self._check_stall(t_ns, joint, q[j], goals[j], load)

    def _check_servo(self, t_ns: int, joint: JointConfig, servo_id: int, state: ServoState) -> None:
        limits, own = self._limits, self._own[servo_id]
        hottest = limits.max_temperature_c
        if hottest is None:
            hottest = own.max_temperature_c - TEMPERATURE_MARGIN_C
        if state.temperature_c > hottest:
            text = f"is at {state.temperature_c:.0f} degC; the limit is {hottest:.0f} degC: let it cool, move it less"
            self._tell_once(joint, servo_id, "temperature", text)
        low = own.min_voltage_v if limits.min_voltage_v is None else limits.min_voltage_v
        high = own.max_voltage_v if limits.max_voltage_v is None else limits.max_voltage_v
        bad = not low <= state.voltage_v <= high
        if self._since.seconds((servo_id, "voltage"), t_ns, bad) >= PERSISTENCE_S:
            text = f"gets {state.voltage_v:.1f} V; wants {low:.1f} to {high:.1f} V: check the supply and its cable"
            self._tell_once(joint, servo_id, "voltage", text)
        most = limits.max_load
        if most is not None:
            key = (servo_id, "load")
            if self._since.seconds(key, t_ns, abs(state.load) > most) >= PERSISTENCE_S:
                self._since.forget(key)
                text = f"bears {100 * abs(state.load):.0f} % of its greatest load; the limit is {100 * most:.0f} %"
                raise self._stop(joint, servo_id, "load", text)

    def _check_stall(self, t_ns: int, joint: JointConfig, q: float, goal: float, load: float) -> None:
        near = STALL_TRAVEL[joint.unit]
        if self._limits.stall_s <= 0:
            return
        since_ns, start = self._from.get(joint.name, (t_ns, q))
        if abs(goal - q) <= near or load < self._limits.stall_load or abs(q - start) > near:
            since_ns, start = t_ns, q
        self._from[joint.name] = since_ns, start
        if (t_ns - since_ns) * _NS >= self._limits.stall_s:
            del self._from[joint.name]
            raise SafetyStop(
                f"joint '{joint.name}' is stalled at {joint.text(q)}, {joint.text(goal - q)} from its goal, under "
                f"{100 * load:.0f} % of its greatest load; look what it runs against, or raise stall_load in the rig",
                joint=joint.name,
                what="stall",
            )

    def _tell_once(self, joint: JointConfig, servo_id: int, what: str, text: str) -> None:
        if (servo_id, what) not in self._told:
            self._told.add((servo_id, what))
            raise self._stop(joint, servo_id, what, text)

    def _stop(self, joint: JointConfig, servo_id: int, what: str, text: str) -> SafetyStop:
        return SafetyStop(f"servo {servo_id} ({joint.name}) {text}", joint=joint.name, what=what)
