"""Pairs of parts that are known to be rigid to each other, from what was found before."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from station.fit.structure import components
from station.kinematics import se3
from station.logs import FloatArray

IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class RigidPairs:
    """Pairs (P, 2) of parts and the pose (P, 4, 4) of each one's second in its first."""

    pairs: IntArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.intp))
    T_a_b: FloatArray = field(default_factory=lambda: se3.identity(0))

    def __len__(self) -> int:
        return len(self.pairs)

    def plus(self, other: RigidPairs, parts: int) -> RigidPairs:
        """These, and those of the others that tell something new of `parts` parts: a forest, if these are one."""
        found = self
        for pair, T in zip(other.pairs, other.T_a_b, strict=True):  # whether one is new depends on those before it
            body = components(parts, found.pairs)
            if body[pair[0]] != body[pair[1]]:
                found = RigidPairs(np.append(found.pairs, pair[None], axis=0), np.append(found.T_a_b, T[None], axis=0))
        return found
