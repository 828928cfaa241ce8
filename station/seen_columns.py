"""In which order joint states are told that a camera sees while a rig is captured: the arm's joints first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.formats.rig import RigTable
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray


@dataclass(frozen=True, eq=False)
class SeenColumns:
    """States by name, with their units: all joints of the arm, then those of the tree that the arm doesn't have.

    Attributes:
        place: (C,) where each is among the tree's columns; -1 for a joint that the tree doesn't have.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    place: NDArray[np.intp]

    def ordered(self, of_tree: FloatArray) -> FloatArray:
        """(C,) values of the tree's columns; NaN for a joint that the tree doesn't have."""
        return np.append(of_tree, np.nan)[self.place]


def seen_columns(rig: RigTable, tree: KinematicTree) -> SeenColumns:
    """The states that are seen of a rig by a tree: joints are the same where their names are."""
    arm = {joint.name: joint.limits().unit for joint in rig.joint}
    others = tuple(column for column in tree.columns if column not in arm)
    names = (*arm, *others)
    units = (*arm.values(), *(tree.units[column] for column in others))
    place = [tree.columns.index(name) if name in tree.columns else -1 for name in names]
    return SeenColumns(names, units, np.array(place, dtype=np.intp))
