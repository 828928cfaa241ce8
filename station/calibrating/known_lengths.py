"""Lengths of a fitted mechanism that are known: travels of prismatic joints, distances of joints' axes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from calibration.scale import Axis, KnownLength, axis_distance
from station.compare import Comparison
from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree

Pair = tuple[str, str]
"""Names of two joints."""


def prismatic_travels(comparison: Comparison) -> Iterator[KnownLength]:
    """The gain of each prismatic joint against its read-back: its servo's turns and lead are known."""
    for joint in comparison.joints:
        against = joint.against_measured
        if joint.unit == "m" and against is not None and against.gain_std is not None:
            yield KnownLength(f"travel of {joint.joint} against its read-back", against.gain, against.gain_std)


def axis_distances(tree: KinematicTree, known_m: Mapping[Pair, float]) -> Iterator[KnownLength]:
    """Distances of axes of two joints of one body, over what they are known to be.

    Raises:
        InvalidData: a joint that isn't in the tree, isn't revolute, or shares no body with the other.
    """
    for (first, second), want_m in known_m.items():
        if not want_m > 0:
            raise InvalidData(f"distance of {first} and {second} is {1e3 * want_m:g} mm; want more than 0")
        a, b = _revolute(tree, first), _revolute(tree, second)
        shared = {a.parent, a.child} & {b.parent, b.child}
        if first == second or not shared:
            raise InvalidData(f"{first} and {second} aren't joints of one body; name two that follow each other")
        body = shared.pop()
        found_m, std_m = axis_distance(_axis(a, body), _axis(b, body))
        what = f"{first} to {second}: {1e3 * found_m:.2f} mm fitted, {1e3 * want_m:g} mm known"
        yield KnownLength(what, found_m / want_m, std_m / want_m)


def _revolute(tree: KinematicTree, name: str) -> Joint:
    for joint in tree.joints:
        if joint.name == name:
            if joint.type == "revolute" and joint.axis_std_rad is not None and joint.point_std_m is not None:
                return joint
            raise InvalidData(f"joint '{name}' is {joint.type}; want revolute ones, with standard deviations")
    raise InvalidData(f"no joint '{name}' was fitted; have {', '.join(joint.name for joint in tree.joints) or 'none'}")


def _axis(joint: Joint, body: str) -> Axis:
    """The joint's axis in the coordinates of one of its bodies: in both it is the same whatever the state."""
    direction, point_m = joint.axis_parent, joint.point_parent_m
    if direction is None or point_m is None:
        raise InvalidData(f"joint '{joint.name}' has no axis")
    if body != joint.parent:
        T_child_parent = se3.inverse(joint.T_parent_child_zero)
        direction, point_m = (
            T_child_parent[:3, :3] @ direction,
            T_child_parent[:3, :3] @ point_m + T_child_parent[:3, 3],
        )
    return Axis(
        np.asarray(direction), np.asarray(point_m), float(joint.axis_std_rad or 0.0), float(joint.point_std_m or 0.0)
    )
