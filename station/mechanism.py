"""The true tree of a rig's simulation, and the torque of gravity on its joints."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from station.formats.simulation import SimulationTable, metres
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray
from station.simulate.gravity import gravity_torques


def mechanism(simulation: SimulationTable) -> KinematicTree:
    """The true tree: all bodies' frames coincide with the root's when all joints are at zero."""
    joints = tuple(
        Joint(
            name=joint.name,
            type=joint.type,
            parent=joint.parent,
            child=joint.child,
            axis_parent=_unit(joint.axis),
            point_parent_m=metres(joint.point_mm) if joint.type == "revolute" else None,
            T_parent_child_zero=np.eye(4),
        )
        for joint in simulation.joint
    )
    bodies = simulation.bodies()
    return KinematicTree(root=simulation.root, parts=bodies, rigid_groups=(), trees=(bodies,), joints=joints)


class Weights:
    """The masses of a simulation's bodies."""

    def __init__(self, simulation: SimulationTable) -> None:
        self._tree = mechanism(simulation)
        self._masses_kg = {joint.child: joint.mass_kg or 0.0 for joint in simulation.joint}
        self._centres_m = {joint.child: metres(joint.centre_mm or [0.0] * 3) for joint in simulation.joint}

    def torques(self, q: Mapping[str, float]) -> dict[str, float]:
        """What gravity does to each joint, N m, of a prismatic joint N, for joint states [rad or m] by name."""
        return {
            name: float(torque)
            for name, torque in gravity_torques(self._tree, q, self._masses_kg, self._centres_m).items()
        }


def has_weight(simulation: SimulationTable) -> bool:
    """Whether any body has a mass."""
    return any(joint.mass_kg for joint in simulation.joint)


def _unit(v: list[float]) -> FloatArray:
    return np.array(v, dtype=np.float64) / np.linalg.norm(v)
