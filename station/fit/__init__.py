"""The learner: from a PoseLog to a kinematic tree and its joint states. `station.fit(log)` calls `fit` below."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from station.callable_module import CallableModule

if TYPE_CHECKING:
    from station.fit.image.views import Views
    from station.fit.result import Fit
    from station.logs import PoseLog

__all__ = ["fit"]


def fit(
    log: PoseLog,
    views: Views | None = None,
    *,
    method: str = "station",
    criterion: str = "evidence",
    joint_types: Sequence[str] = ("rigid", "prismatic", "revolute"),
    root: str | None = None,
    include_reference: bool = False,
    root_static: bool | None = None,
    refine: str | None = None,
    camera_numbers: Sequence[str] = ("edge_shift_px",),
) -> Fit:
    """Discover which parts of a log are one body, which joints connect the bodies, and the joints' states over time.

    Args:
        log: poses of K parts at T times; NaN where a part was not seen.
        views: the markers' corners that the poses are from, if there are any; `station.tracking.views_of` makes them.
        method: how to fit: "station", or "paper" for the paper's, step by step.
        criterion: how joint types are compared: "evidence", "bic", "aic", "aicc" or "paper-aic".
        joint_types: the candidates between two bodies: "rigid", "prismatic", "revolute", "screw", "spherical"; and
            "free", to have the score of no joint at all among theirs.
        root: part whose body becomes the tree's root; None takes the one that moves least.
        include_reference: whether the frame that the poses are in is a part itself, a static one. It always is where
            the log has but one part: a door in front of a camera is a hinge.
        root_static: whether the root stands still before the reference frame; None finds that out.
        refine: what the whole tree is refined on: "image", the corners in `views`; "pose"; or "none", which leaves the
            joints as pairs of parts told them. None is "image" where there are views, else "pose".
        camera_numbers: of the camera, those that are estimated from the corners: "edge_shift_px", "focal", "readout_s".

    Returns:
        The tree, with `warnings` in plain sentences, and its joints' states [rad or m] with their standard deviations
        at the log's times; NaN where a joint was not seen or the frame is an outlier. With views also the corners
        against the tree, as `image`.

    Raises:
        InvalidData: a StationError: options that don't exist, a covariance that is none, parts that were never seen
            together often enough, views of other frames or parts, none where the tree is to be refined on them.
    """
    _check_kinds(log, joint_types)
    # Imported here so that `import station.fit` is light.
    from station.fit.learner import learn
    from station.fit.options import FitOptions

    options = FitOptions(
        method=method,
        criterion=criterion,
        joint_types=tuple(joint_types),
        root=root,
        include_reference=include_reference,
        root_static=root_static,
        refine=refine,
        camera_numbers=tuple(camera_numbers),
    )
    return learn(log, options, views)


def _check_kinds(log: object, joint_types: object) -> None:
    """Raise InvalidData for what would end confusingly: a path for a log, one text for names."""
    from station.errors import InvalidData
    from station.logs import PoseLog

    if not isinstance(log, PoseLog):
        raise InvalidData(
            f"fit wants a PoseLog; have a {type(log).__name__}\n"
            "make one from arrays with station.PoseLog, or read a file with station.read_pose_log"
        )
    if isinstance(joint_types, str):
        raise InvalidData(f"joint_types is the text '{joint_types}'; want a sequence of names: ('{joint_types}',)")


sys.modules[__name__].__class__ = CallableModule
