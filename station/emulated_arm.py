"""The servos of a rig on an emulated bus, built together as the rig says, and the joints' true states behind them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from drivers.clock import Clock
from drivers.emulator import EmulatedBus, EmulatedServo, Fault, parse_fault
from drivers.emulator.servo import DEFAULT_ACCELERATION_RAD_S2
from drivers.joints import JointConfig, ServoConfig
from station.formats.rig import RigTable
from station.formats.simulation import SimulationTable
from station.logs import FloatArray
from station.mechanism import Weights, has_weight
from station.rig_reading import joint_configs

HAND_RAMP_S = 0.15  # in which a hand comes to its speed
_STILL = 1e-3  # rad or m. At a lever of 1 m the weight's torque changes by a thousandth of itself.


class EmulatedArm(EmulatedBus):
    """The emulated bus of a rig's servos, standing at the park pose, and the joints' true states behind it.

    Args:
        table: the rig; what it says of secondary ids, reversal and sync cables is how the servos are built.
        simulation: how fast they can be, their play, their load and their faults; None: as they come out of the box.
        clock: the time that they live in.
        seed: of everything random; the simulation's own if None.
        faults: in addition to the simulation's.
        link: the path of the device; in a temporary folder if None.

    Raises:
        DriverError: for what the servos can't be, and for faults that they can't have.
    """

    def __init__(
        self,
        table: RigTable,
        simulation: SimulationTable | None,
        clock: Clock,
        *,
        seed: int | None = None,
        faults: Sequence[Fault] = (),
        link: Path | None = None,
    ) -> None:
        self._joints = joint_configs(table)
        weights = Weights(simulation) if simulation is not None and has_weight(simulation) else None
        self._load = None if weights is None else _Load(weights, self._state_of)
        self._servos: dict[int, EmulatedServo] = {}
        for joint, limits in zip(self._joints, table.limits(), strict=True):
            for servo in joint.servos:
                self._servos[servo.id] = self._build(joint, servo, limits.park, table.bus.protocol, simulation)
            _join(joint, self._servos)
        own = () if simulation is None else tuple(map(parse_fault, simulation.faults))
        if seed is None:
            seed = 0 if simulation is None else simulation.seed
        super().__init__(
            list(self._servos.values()),
            baud=table.bus.baud,
            clock=clock,
            faults=(*own, *faults),
            seed=seed,
            link=link,
        )

    def joint_states(self, t_ns: int) -> FloatArray:
        """(J,) true joint states, rad or m, at a time of the clock: the mean of the servos that turn each."""
        return np.array(
            [
                sum(_state(servo, self.shaft_rad(servo.id, t_ns)) for servo in joint.servos) / len(joint.servos)
                for joint in self._joints
            ],
            dtype=np.float64,
        )

    def push(self, joint: str, state: float, speed: float, t_ns: int) -> None:
        """From a time on a hand takes a joint to a state (rad or m) at a speed; servos with torque hold against it."""
        turned = next(each for each in self._joints if each.name == joint)
        for servo in turned.servos:
            if servo.ganging != "sync_cable":  # its leader takes it along
                zero_rad = (servo.zero - servo.table.zero_count) * servo.table.rad_per_count
                rad = _turn(servo) * (servo.sign * servo.ratio * state + zero_rad)
                self._servos[servo.id].push(rad, servo.ratio * speed, servo.ratio * speed / HAND_RAMP_S, t_ns)

    def _build(
        self,
        joint: JointConfig,
        servo: ServoConfig,
        park: float,
        protocol: float,
        simulation: SimulationTable | None,
    ) -> EmulatedServo:
        acceleration, backlash_deg = DEFAULT_ACCELERATION_RAD_S2, 0.0
        if simulation is not None:
            acceleration = float(np.radians(simulation.max_acceleration_deg_s2))
            backlash_deg = simulation.backlash_deg
        zero = servo.table.zero_count
        return EmulatedServo(
            servo.id,
            servo.model,
            initial_count=zero + _turn(servo) * (servo.count(park) - zero),
            max_acceleration_rad_s2=acceleration,
            protocol=protocol,
            eeprom=_built(joint, servo),
            load_nm=None if self._load is None else self._load.on(joint, servo),
            backlash_rad=float(np.radians(backlash_deg)),
        )

    def _state_of(self, t_ns: int) -> dict[str, float]:
        """The joints' states as the servos have them when they are asked by one of them."""
        return {
            joint.name: sum(_state(servo, self._servos[servo.id].shaft_rad(t_ns)) for servo in joint.servos)
            / len(joint.servos)
            for joint in self._joints
        }


class _Load:
    """Gravity's torque on the servos, found once for all of them at each of their times."""

    def __init__(self, weights: Weights, states: Callable[[int], Mapping[str, float]]) -> None:
        self._weights, self._states = weights, states
        self._t_ns: int | None = None
        self._q: Mapping[str, float] = {}
        self._torques: dict[str, float] = {}

    def on(self, joint: JointConfig, servo: ServoConfig) -> Callable[[int], float]:
        """The torque on a servo's shaft, N m, positive anticlockwise; servos of a joint share it evenly."""
        share = _turn(servo) * servo.sign / (servo.ratio * len(joint.servos))

        def load_nm(t_ns: int) -> float:
            if t_ns != self._t_ns:
                self._t_ns = t_ns  # first: the states ask the other servos, and those for their load
                self._weigh(self._states(t_ns))
            return share * self._torques.get(joint.name, 0.0)

        return load_nm

    def _weigh(self, q: Mapping[str, float]) -> None:
        """Find the torques anew, unless the arm has hardly moved since: it takes milliseconds."""
        if not self._q or any(abs(q[name] - self._q[name]) > _STILL for name in q):
            self._q, self._torques = q, self._weights.torques(q)


def _turn(servo: ServoConfig) -> int:
    """-1 where the servo's counts run clockwise."""
    return -1 if servo.reversed else 1


def _state(servo: ServoConfig, shaft_rad: float) -> float:
    """The joint state at a shaft angle."""
    zero_rad = (servo.zero - servo.table.zero_count) * servo.table.rad_per_count
    return servo.sign * (_turn(servo) * shaft_rad - zero_rad) / servo.ratio


def _built(joint: JointConfig, servo: ServoConfig) -> dict[str, int]:
    """The registers that the builder of the arm has set."""
    built: dict[str, int] = {}
    if servo.ganging == "secondary_id":
        built["secondary_id"] = joint.servos[0].id
    wanted = {"reverse": bool(servo.reversed), "sync_cable_follower": servo.ganging == "sync_cable"}
    if any(wanted.values()):
        drive_mode = servo.table.registers["drive_mode"].initial or 0
        for bit, name in servo.table.drive_mode_bits.items():
            drive_mode |= wanted.get(name, False) << bit
        built["drive_mode"] = drive_mode
    return built


def _join(joint: JointConfig, servos: Mapping[int, EmulatedServo]) -> None:
    """Plug in the joint's sync cables: twisted where the servos face each other."""
    leader = joint.servos[0]
    for servo in joint.servos[1:]:
        if servo.ganging == "sync_cable":
            twisted = _turn(servo) * servo.sign != _turn(leader) * leader.sign
            servos[servo.id].follow(servos[leader.id], twisted=twisted)
