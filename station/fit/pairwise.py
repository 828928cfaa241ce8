"""Fit joint types to the relative poses of many pairs of parts at once, with the states eliminated and outliers told
apart.

A closed-form start (`pair_starts`), or one by sample consensus (`consensus`) where outliers are many; then least
squares (`pair_refinement`) of the likelihood of inliers and outliers (`pair_likelihood`). All of it is batched over
pairs and frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.consensus import consensus_models
from station.fit.known_joints import KnownJoints
from station.fit.noise import INLIER_ABOVE
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
from station.fit.pair_refinement import COST_TOLERANCE, LM_ITERATIONS, Progress, begin, finished, improve, inliers
from station.fit.pair_starts import judged, start_models
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

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
# Steps that every type is given, and where it starts from a known joint; after them, those that have fallen behind the
# best one settle for less.
FIRST_ITERATIONS, FIRST_FROM_KNOWN = 2, 1
# Tolerance as a share of how far a type is behind: it won't catch up by a thousandth of that.
BEHIND_TOLERANCE = 0.03
# So it is for the best one, by how far it is ahead, up to this.
AHEAD_TOLERANCE = 3.0
# Share of outliers among poses, and among positions, from which on starts are sought by sample consensus as well:
# rotations tell axes even with 40 %. A few frames are no share.
MANY_POSES, MANY_POSITIONS, MANY_FRAMES = 0.15, 0.03, 4.0
# So are they where frames are hardly likelier than outliers: -2 log likelihood below theirs, for each number measured.
LEAST_SHARPNESS = 1.0


def fit_joint(
    joint: JointType,
    tracks: PairTracks,
    *,
    by_pose: bool,
    iterations: int = LM_ITERATIONS,
    tolerance: float = COST_TOLERANCE,
) -> JointFit:
    """Fit one joint type to all pairs; `by_pose` if orientations were measured."""
    return _Work(tracks, by_pose, iterations, tolerance, None).fits({joint.name: joint})[joint.name]


def fit_types(
    tracks: PairTracks,
    joint_types: Sequence[str],
    *,
    iterations: int = LM_ITERATIONS,
    tolerance: float = COST_TOLERANCE,
    known: KnownJoints | None = None,
) -> dict[str, JointFit]:
    """Every type fitted to all pairs, from where it is known to be; pairs without orientations by their positions."""
    by_pose = told_by_pose(tracks)
    begun = np.zeros(len(by_pose), dtype=bool) if known is None else known.known & (known.by_pose == by_pose)
    rows = [np.flatnonzero((by_pose == kind) & (begun == there)) for kind in (True, False) for there in (True, False)]
    joints = {name: JOINT_TYPES[name] for name in joint_types}
    fits: list[dict[str, JointFit]] = []
    for some in rows:
        if some.size:
            from_there = known.take(some).frames if known is not None and begun[some[0]] else None
            taken = tracks if some.size == len(by_pose) else tracks.take(some)
            fits.append(_Work(taken, bool(by_pose[some[0]]), iterations, tolerance, from_there).fits(joints))
    order = np.argsort(np.concatenate(rows))
    return {name: JointFit.all_of([fit[name] for fit in fits]).take(order) for name in joint_types}


def told_by_pose(tracks: PairTracks) -> BoolArray:
    """(P,) whether pairs are fitted to poses, or to positions alone."""
    return tracks.oriented.sum(axis=-1) >= LEAST_ORIENTED


@dataclass(frozen=True, eq=False)
class _Work:
    """Pairs that all have orientations, or none, how well they are to be fitted, and joints to start at, or none."""

    tracks: PairTracks
    by_pose: bool
    iterations: int
    tolerance: float
    known: Mapping[str, JointFrames] | None

    def fits(self, joints: Mapping[str, JointType]) -> dict[str, JointFit]:
        """Fits of several types."""
        begun = {name: self._improved(joint, self.tracks, self._start(joint)) for name, joint in joints.items()}
        if self.known is None:
            begun = self._begun_again(joints, begun)
        for name, joint in joints.items():  # all others have come as far as they do, in whatever order types are given
            for simpler in (included for included in joint.includes if included in begun):
                begun[name] = self._from_included(joint, begun[name], begun[simpler])
        return {
            name: self._finished(joints[name], progress, limit)
            for (name, progress), limit in zip(begun.items(), self._limits(begun), strict=True)
        }

    def _limits(self, begun: Mapping[str, Progress]) -> FloatArray:
        """(types, P) tolerances by how far types are behind the best one, or the best one is ahead of the others."""
        cost = np.stack([progress.cost for progress in begun.values()])
        behind = cost - np.min(cost, axis=0)
        limits: FloatArray = np.maximum(self.tolerance, BEHIND_TOLERANCE * behind)
        if len(cost) > 1:
            ahead = BEHIND_TOLERANCE * np.sort(behind, axis=0)[1]
            most = max(AHEAD_TOLERANCE, self.tolerance)
            of_best: FloatArray = np.clip(ahead, self.tolerance, most)
            limits = np.where(behind > 0, limits, of_best)
        return limits

    def _begun_again(self, joints: Mapping[str, JointType], begun: Mapping[str, Progress]) -> dict[str, Progress]:
        """With other starts where there are outliers."""
        many, some = self._with_outliers(begun)
        again: dict[str, Progress] = {}
        for name, joint in joints.items():
            again[name] = self._retried(joint, begun[name], many, self._from_samples)
            if joint.states:
                again[name] = self._retried(joint, again[name], some, self._from_the_rest)
        return again

    def _start(self, joint: JointType) -> Model:
        if self.known is not None:
            usable = self.tracks.oriented if self.by_pose else self.tracks.seen
            weights = usable.astype(np.float64)
            return judged(joint, self.tracks, self.known[joint.name], weights, by_pose=self.by_pose).model
        return start_models(joint, self.tracks, by_pose=self.by_pose)

    def _improved(self, joint: JointType, tracks: PairTracks, model: Model) -> Progress:
        enough = np.full(len(model.q), self.tolerance)
        return improve(joint, tracks.data, begin(model), iterations=self._first, tolerance=enough)

    @property
    def _first(self) -> int:
        """Steps that every type is given."""
        return min(FIRST_ITERATIONS if self.known is None else FIRST_FROM_KNOWN, self.iterations)

    def _with_outliers(self, begun: Mapping[str, Progress]) -> tuple[IntArray, IntArray]:
        """Pairs of which even the likeliest type leaves many outliers or explains little, and others with some."""
        cost = np.stack([progress.cost for progress in begun.values()])
        share = np.stack([progress.model.outlier_share for progress in begun.values()])
        least = np.min(cost, axis=0)
        share = np.min(np.where(cost == least, share, 1.0), axis=0)
        some = share * self.tracks.seen.sum(axis=-1) > MANY_FRAMES
        many = some & (share > (MANY_POSES if self.by_pose else MANY_POSITIONS))
        nothing = -2 * self.tracks.log_outlier_density.sum(axis=-1)
        many |= nothing - least < LEAST_SHARPNESS * self.tracks.dimensions.sum(axis=-1)
        return np.flatnonzero(many), np.flatnonzero(some & ~many)

    def _retried(
        self,
        joint: JointType,
        begun: Progress,
        rows: IntArray,
        start: Callable[[JointType, PairTracks, Progress], Model],
    ) -> Progress:
        """With what some pairs come to from another start, where that is better."""
        if not rows.size:
            return begun
        tracks = self.tracks.take(rows)
        found = self._improved(joint, tracks, start(joint, tracks, begun.take(rows)))
        better = np.flatnonzero(found.cost < begun.cost[rows])
        return begun.with_rows(rows[better], found.take(better))

    def _from_samples(self, joint: JointType, tracks: PairTracks, begun: Progress) -> Model:
        explained = inliers(joint, tracks.data, begun) > INLIER_ABOVE
        return consensus_models(joint, tracks, explained, by_pose=self.by_pose)

    def _from_the_rest(self, joint: JointType, tracks: PairTracks, begun: Progress) -> Model:
        """From frames that are outliers so far, with as much weight as all others: few may have moved of many."""
        inlier = inliers(joint, tracks.data, begun)
        outlier = tracks.seen - inlier
        ratio = inlier.sum(axis=-1) / np.maximum(outlier.sum(axis=-1), 1.0)
        return start_models(joint, tracks, by_pose=self.by_pose, weights=inlier + outlier * ratio[:, None])

    def _from_included(self, joint: JointType, begun: Progress, simpler: Progress) -> Progress:
        """With what pairs come to from a type that this one includes, where that fits better: it never should."""
        rows = np.flatnonzero(simpler.cost < begun.cost)

        def start(joint: JointType, tracks: PairTracks, begun: Progress) -> Model:
            model = simpler.model.take(rows)
            form = np.zeros((len(rows), joint.form_freedoms))
            return replace(model, frames=replace(model.frames, form=form))

        return self._retried(joint, begun, rows, start)

    def _finished(self, joint: JointType, progress: Progress, limit: FloatArray) -> JointFit:
        rest = self.iterations - FIRST_ITERATIONS
        return finished(
            joint, self.tracks.data, improve(joint, self.tracks.data, progress, iterations=rest, tolerance=limit)
        )
