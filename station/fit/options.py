"""What can be asked of the fit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FitOptions:
    """How to learn a tree.

    Attributes:
        method: "station".
        criterion: how joint types are compared; see `selection`.
        joint_types: the candidates.
        root: part whose body becomes the root; None lets the fit choose.
        include_reference: whether the log's reference frame is a part; it always is when there is but one other.
    """

    method: str = "station"
    criterion: str = "evidence"
    joint_types: tuple[str, ...] = ("rigid", "prismatic", "revolute")
    root: str | None = None
    include_reference: bool = False
