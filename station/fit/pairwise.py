"""Fit joint types to the relative poses of many pairs of parts at once, with the states eliminated and outliers told
apart.

A closed-form start (`pair_starts`), then least squares (`pair_refinement`) of the likelihood of inliers and outliers
(`pair_likelihood`). Everything is batched over pairs and frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from station.fit.pair_model import (
    OUTLIER_SHARE_START,
    ROTATION_VOLUME,
    JointFit,
    Model,
    PairTracks,
    parameter_covariance,
    residual_jacobian,
    residuals,
    small_inverse,
    stepped_frames,
)
from station.fit.pair_refinement import COST_TOLERANCE, LM_ITERATIONS, Progress, begin, finished, improve
from station.fit.pair_starts import start_models
from station.kinematics.joints import JOINT_TYPES, JointType

__all__ = [
    "COST_TOLERANCE",
    "LM_ITERATIONS",
    "OUTLIER_SHARE_START",
    "ROTATION_VOLUME",
    "JointFit",
    "Model",
    "PairTracks",
    "fit_joint",
    "fit_types",
    "parameter_covariance",
    "residual_jacobian",
    "residuals",
    "small_inverse",
    "stepped_frames",
]

# Frames with orientation that a fit to poses needs; with fewer a pair is fitted to positions.
LEAST_ORIENTED = 10
# Steps that every type is given; after them, those that have fallen behind the best one settle for less.
FIRST_ITERATIONS = 2
# Tolerance as a share of how far a type is behind: it won't catch up by a thousandth of that.
BEHIND_TOLERANCE = 1e-3


def fit_joint(
    joint: JointType,
    tracks: PairTracks,
    *,
    by_pose: bool,
    iterations: int = LM_ITERATIONS,
    tolerance: float = COST_TOLERANCE,
) -> JointFit:
    """Fit one joint type to all pairs, closed form then least squares; `by_pose` if orientations were measured."""
    start = begin(start_models(joint, tracks, by_pose=by_pose))
    enough = np.full(len(tracks.seen), tolerance)
    progress = improve(joint, tracks.data, start, iterations=iterations, tolerance=enough)
    return finished(joint, tracks.data, progress.model)


def fit_types(
    tracks: PairTracks,
    joint_types: Sequence[str],
    *,
    iterations: int = LM_ITERATIONS,
    tolerance: float = COST_TOLERANCE,
) -> dict[str, JointFit]:
    """Every type fitted to all pairs; pairs without orientations by their positions."""
    by_pose = tracks.oriented.sum(axis=-1) >= LEAST_ORIENTED
    rows = [np.flatnonzero(by_pose == kind) for kind in (True, False)]
    fits = [
        _fit_alike(tracks.take(some), joint_types, iterations, tolerance, by_pose=kind)
        for kind, some in zip((True, False), rows, strict=True)
        if some.size
    ]
    order = np.argsort(np.concatenate(rows))
    return {name: JointFit.all_of([fit[name] for fit in fits]).take(order) for name in joint_types}


def _fit_alike(
    tracks: PairTracks, joint_types: Sequence[str], iterations: int, tolerance: float, *, by_pose: bool
) -> dict[str, JointFit]:
    """Fits of pairs that all have orientations, or none."""
    first = min(FIRST_ITERATIONS, iterations)
    enough = np.full(len(tracks.seen), tolerance)
    begun: dict[str, Progress] = {}
    for name in joint_types:
        start = begin(start_models(JOINT_TYPES[name], tracks, by_pose=by_pose))
        begun[name] = improve(JOINT_TYPES[name], tracks.data, start, iterations=first, tolerance=enough)
    best = np.min(np.stack([progress.cost for progress in begun.values()]), axis=0)
    fits: dict[str, JointFit] = {}
    for name, progress in begun.items():
        joint, limit = JOINT_TYPES[name], np.maximum(tolerance, BEHIND_TOLERANCE * (progress.cost - best))
        progress = improve(joint, tracks.data, progress, iterations=iterations - first, tolerance=limit)
        fits[name] = finished(joint, tracks.data, progress.model)
    return fits
