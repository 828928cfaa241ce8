"""What every method of learning returns."""

from __future__ import annotations

from dataclasses import dataclass

from station.fit.image.image_fit import ImageFit
from station.kinematics.tree import KinematicTree
from station.logs import JointLog


@dataclass(frozen=True, eq=False)
class Fit:
    """A learned tree, and its joints' states at the log's times; NaN where a joint wasn't seen or was an outlier.

    Attributes:
        tree: as learned.
        states: of its joints.
        image: the corners against the tree, if it was refined on them.
    """

    tree: KinematicTree
    states: JointLog
    image: ImageFit | None = None
