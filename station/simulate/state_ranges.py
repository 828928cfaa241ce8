"""The ranges that joint states keep to, column by column; eq. (25) of the paper has them as sigma_min and sigma_max."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.errors import InvalidData
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray

# Of turning joints without limits: one turn, and of a ball any rotation [rad].
TURN_RANGE_RAD = (-np.pi, np.pi)
BALL_RANGE_RAD = (0.0, np.pi)
# Below this length [rad] a rotation vector has no direction.
NO_DIRECTION_RAD = 1e-12


@dataclass(frozen=True, eq=False)
class StateRanges:
    """Least and largest state of each column of a tree's joint states.

    Attributes:
        low: (C,) rad or m.
        high: (C,).
        balls: first column of each spherical joint: `low` and `high` of its three are those of the vector's length.
    """

    low: FloatArray
    high: FloatArray
    balls: tuple[int, ...]

    @property
    def span(self) -> FloatArray:
        """(C,)."""
        return self.high - self.low

    def bounded(self, q: FloatArray) -> FloatArray:
        """(..., C) states within the ranges, each the nearest one; BOUND of Algorithm 2."""
        found = np.minimum(np.maximum(q, self.low), self.high)
        for first in self.balls:
            vector = q[..., first : first + 3]
            length = np.sqrt(np.sum(vector**2, axis=-1, keepdims=True))
            lost = length < NO_DIRECTION_RAD
            direction = np.where(lost, np.array([0.0, 0.0, 1.0]), vector / np.where(lost, 1.0, length))
            within = np.minimum(np.maximum(length, self.low[first]), self.high[first])
            found[..., first : first + 3] = within * direction
        return found

    def spread(self, u: FloatArray) -> FloatArray:
        """(..., C) states for numbers u (..., C) from -1 to 1, which stand for the ends of the ranges."""
        found = self.low + self.span * (0.5 + 0.5 * u)
        for first in self.balls:
            found[..., first : first + 3] = u[..., first : first + 3] * self.high[first]
        return self.bounded(found)


def state_ranges(tree: KinematicTree) -> StateRanges:
    """Of each joint its limits, else the range that a fit observed, else a whole turn.

    Raises:
        InvalidData: for a prismatic joint without either, and a ball whose angle would be negative.
    """
    low: list[float] = []
    high: list[float] = []
    balls: list[int] = []
    for joint in tree.movable:
        least, most = _range(joint)
        if joint.kind.states > 1:
            balls.append(len(low))
        low += [least] * joint.kind.states
        high += [most] * joint.kind.states
    return StateRanges(np.array(low), np.array(high), tuple(balls))


def _range(joint: Joint) -> tuple[float, float]:
    ball = joint.kind.states > 1
    if joint.limits is not None:
        found = joint.limits
    elif joint.state_min is not None and joint.state_max is not None:
        found = joint.state_min, joint.state_max
    elif joint.unit == "rad":
        found = BALL_RANGE_RAD if ball else TURN_RANGE_RAD
    else:
        raise InvalidData(
            f"joint '{joint.name}' ({joint.type}) has no limits: how far may it move?\n"
            'give it "limits": {"min": 0.0, "max": 0.3}, in m; in a URDF <limit lower="0" upper="0.3"/>'
        )
    if ball and found[0] < 0:
        raise InvalidData(
            f"joint '{joint.name}': limits from {found[0]:g} to {found[1]:g} rad; a spherical joint's are of the angle "
            "of its rotation vector, 0 or more"
        )
    return found
