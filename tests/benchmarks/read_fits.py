"""Fits through the learner's public entry, and what they say in its public form against the truth."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path

import numpy as np

from station.errors import StationError
from station.fit.learner import Fit, learn
from station.fit.options import FitOptions
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, PoseLog

DEFAULT_TYPES = FitOptions().joint_types
ALL_TYPES = tuple(name for name in ("rigid", "prismatic", "revolute", "screw", "spherical") if name in JOINT_TYPES)


def attempt(log: PoseLog, options: FitOptions | None = None) -> tuple[Fit | None, str]:
    """A fit, or None and the name of the error: one that crashes is a wrong answer, and the table goes on."""
    try:
        return learn(log, options), ""
    except StationError as error:
        return None, type(error).__name__
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        print(f"{Path(last.filename).name}:{last.lineno}: {type(error).__name__}: {error}", file=sys.stderr)
        return None, type(error).__name__


def candidates(kind: str) -> tuple[str, ...]:
    """The default joint types where they hold this one, else all that there are."""
    return DEFAULT_TYPES if kind in DEFAULT_TYPES else ALL_TYPES


def found_type(tree: KinematicTree) -> str:
    """Type of the only joint; "rigid" for one body, "free" for two that nothing connects."""
    if len(tree.joints) == 1:
        return tree.joints[0].type
    return "rigid" if len(tree.bodies) == 1 else "free" if not tree.joints else "several"


def axis_error_rad(axis: FloatArray, truth: FloatArray) -> float:
    """Angle between two lines along unit vectors (3,)."""
    return float(np.arctan2(np.linalg.norm(np.cross(axis, truth)), abs(axis @ truth)))


def point_error_m(point: FloatArray, truth: FloatArray, axis: FloatArray | None) -> float:
    """Distance of a point to the true axis, or to the true point where there is no axis."""
    off = point - truth
    return float(np.linalg.norm(off if axis is None else off - axis * (off @ axis)))


def states_of(fit: Fit, joint: Joint) -> tuple[FloatArray, FloatArray]:
    """States and deviations (T, s) of a joint: columns that are named for it, alone or with more after its name."""
    names = fit.states.joints
    columns = [i for i, name in enumerate(names) if name == joint.name] or [
        i for i, name in enumerate(names) if name.startswith(f"{joint.name}_")
    ]
    std = np.full_like(fit.states.q, np.nan) if fit.states.std is None else fit.states.std
    return fit.states.q[:, columns], std[:, columns]
