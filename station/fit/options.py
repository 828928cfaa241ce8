"""What can be asked of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from station.errors import InvalidData
from station.fit.image.camera_numbers import NUMBERS
from station.fit.selection import FREE, check_criterion
from station.kinematics.joints import JOINT_TYPES

METHODS = ("station", "paper")
# What the whole tree is refined on: the corners, the poses, or nothing, which leaves the pairs' joints.
REFINEMENTS = ("image", "pose", "none")


@dataclass(frozen=True)
class FitOptions:
    """How to learn a tree.

    Attributes:
        method: "station", or "paper" for the paper's, step by step.
        criterion: how joint types are compared; see `criteria`.
        joint_types: the candidates; "free", the hypothesis that nothing joins two parts, may be one of them.
        root: part whose body becomes the root; None lets the fit choose.
        include_reference: whether the log's reference frame is a part; it always is when there is but one other.
        root_static: whether the root stands still before the reference frame; None finds that out.
        refine: what the whole tree is refined on, one of `REFINEMENTS`; None is "image" where corners are known, else
            "pose".
        camera_numbers: of `CameraNumbers`, those that are estimated where the tree is refined on corners.
    """

    method: str = "station"
    criterion: str = "evidence"
    joint_types: tuple[str, ...] = ("rigid", "prismatic", "revolute")
    root: str | None = None
    include_reference: bool = False
    root_static: bool | None = None
    refine: str | None = None
    camera_numbers: tuple[str, ...] = ("edge_shift_px",)

    @property
    def free(self) -> bool:
        """Whether "free" is a candidate."""
        return FREE in self.joint_types

    @property
    def joints(self) -> tuple[str, ...]:
        """The candidates that are joint types."""
        return tuple(name for name in self.joint_types if name != FREE)


def check_options(options: FitOptions, names: Sequence[str]) -> None:
    """Raise InvalidData for what doesn't exist, with the choices; `names` are those of the parts."""
    if options.method not in METHODS:
        raise InvalidData(f"method '{options.method}' is unknown; choose one of {', '.join(METHODS)}")
    _check_refinement(options)
    check_criterion(options.criterion)
    _check_joint_types(options)
    if options.root is not None and options.root not in names:
        raise InvalidData(f"no part '{options.root}' for a root; have {', '.join(names)}")


def _check_refinement(options: FitOptions) -> None:
    if options.refine not in (*REFINEMENTS, None):
        raise InvalidData(f"can't refine on '{options.refine}'; choose one of {', '.join(REFINEMENTS)}")
    unknown = [name for name in options.camera_numbers if name not in NUMBERS]
    if unknown:
        raise InvalidData(f"the camera has no number '{unknown[0]}'; choose of {', '.join(NUMBERS)}")
    if options.method != "paper":
        return
    if options.refine in ("image", "pose"):
        raise InvalidData(
            f"method 'paper' can't refine on '{options.refine}': it joins pairs of poses, and has no corners; "
            "want 'none', or method 'station'"
        )
    if options.root_static is not None:
        raise InvalidData("method 'paper' can't be told whether the root stands still; want method 'station'")


def _check_joint_types(options: FitOptions) -> None:
    have = ", ".join(options.joint_types) or "none"
    want = f"want one or more of {', '.join((*JOINT_TYPES, FREE))}"
    unknown = [name for name in options.joint_types if name not in (*JOINT_TYPES, FREE)]
    if unknown:
        raise InvalidData(f"joint type '{unknown[0]}' is unknown; {want}")
    twice = sorted({name for name in options.joint_types if options.joint_types.count(name) > 1})
    if twice:
        raise InvalidData(f"joint type '{twice[0]}' is there twice in {have}; {want}")
    if not options.joints:
        raise InvalidData(f"joint types: {have}; {want}")
