"""A root of which it is told that it stands still, whatever its poses look like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.fit.bodies import Bodies
from station.fit.structure import components
from station.fit.tree_start import REFERENCE
from station.kinematics import se3
from station.kinematics.joints.base import BALANCE_M
from station.logs import FloatArray

IntArray = NDArray[np.intp]


def with_standing(parts: Bodies, pairs: IntArray, T_a_b: FloatArray, root: str | None) -> tuple[IntArray, FloatArray]:
    """Pairs (P, 2) of parts that are rigid to each other, and their poses (P, 4, 4), with the root and the reference.

    Args:
        parts: with the reference as the first.
        pairs: a forest.
        T_a_b: pose of each pair's second in its first.
        root: part that stands still; the one that moves least if None.
    """
    still = _least_moving(parts) if root is None else parts.names.index(root)
    body = components(len(parts.names), pairs)
    if body[still] == body[REFERENCE]:
        return pairs, T_a_b
    where = _middle(parts.T_ref_body[parts.oriented[:, still], still])
    return np.append(pairs, [[REFERENCE, still]], axis=0), np.append(T_a_b, where[None], axis=0)


def _least_moving(parts: Bodies) -> int:
    """The part whose poses are the least far from their middle, at the median."""
    far = np.full(len(parts.names), np.inf)
    for k in range(1, len(parts.names)):  # each is seen in frames of its own
        poses = parts.T_ref_body[parts.oriented[:, k], k]
        if len(poses):
            off = se3.inverse(_middle(poses)) @ poses
            far[k] = np.median(np.linalg.norm(off[:, :3, 3], axis=-1) + BALANCE_M * se3.angle(off[:, :3, :3]))
    return int(np.argmin(far))


def _middle(poses: FloatArray) -> FloatArray:
    """(4, 4) median place and mean rotation of poses (N, 4, 4), however far they are spread."""
    return se3.pose(se3.project_to_so3(poses[:, :3, :3].mean(axis=0)), np.median(poses[:, :3, 3], axis=0))
