"""Starts by sample consensus, for tracks with so many outliers that weights alone don't find the rest.

Joints are made from a few frames each by the type's own closed form (Torr and Zisserman's MLESAC, 2000). How likely one
makes all frames is told by a mixture of inliers, Gaussian with deviations of position and orientation of its own, and
outliers anywhere, fitted to each by expectation and maximisation. The best one's inliers make a better joint, a few
times over. Samples are the same for each pair and each run.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from station.fit.entrywise import entries_first
from station.fit.pair_likelihood import TURN, either
from station.fit.pair_model import ROTATION_VOLUME, Model, PairTracks
from station.fit.pair_residuals import errors
from station.fit.pair_starts import FLIP_SHARE_START, best_states, closed_form
from station.kinematics.joints import JointFrames, JointType
from station.kinematics.joints.base import BALANCE_M
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

SEED = 20
# Positions tell less, so that more of their samples are misled by noise; and they are quicker to judge.
POSE_SAMPLES, POSITION_SAMPLES = 48, 128
LARGEST_SAMPLE = 4
# Frames that judge the hypotheses.
JUDGES = 64
# Frames of all hypotheses that are judged at once.
JUDGED_AT_ONCE = 50_000
# Shares of the frames that may be inliers, to start the mixtures from; and rounds of each.
INLIER_SHARES = (0.25, 0.5, 0.8)
MIXTURE_ROUNDS = 4
# Joints made anew from the inliers.
LOCAL_ROUNDS = 3
# A joint made of a few frames is not so exact that the others are within the noise about it: samples are judged by
# deviations so many times as large as those of the one with the least.
LOOSE = 3.0
# Median of the sum of three squared errors of unit variance.
MEDIAN_SQUARE = 2.366
# No share of outliers is nearer to 0 and 1 than this.
LEAST_SHARE = 1e-3
# Variance below which errors are rounding [m^2, rad^2].
LEAST_VARIANCE = 1e-12


def consensus_models(joint: JointType, tracks: PairTracks, explained: BoolArray, *, by_pose: bool) -> Model:
    """Models of P pairs to start from; half of the samples look beyond the frames (P, T) that are explained so far."""
    usable = tracks.oriented if by_pose else tracks.seen
    P, T = usable.shape
    at_once = max(JUDGED_AT_ONCE // (_count(by_pose=by_pose) * min(JUDGES, T)), 1)
    pieces = [np.arange(first, min(first + at_once, P)) for first in range(0, P, at_once)]  # memory asks for pieces
    frames = _joined([_hypothesis(joint, tracks.take(i), usable[i], explained[i], by_pose=by_pose) for i in pieces])
    case = _Case(joint, tracks.T_a_b, usable, tracks.scene_m3, by_pose)
    best = case.judged(frames)
    for _ in range(LOCAL_ROUNDS):  # each round's inliers come from the last
        readings = closed_form(joint, tracks.T_a_b, case.weights(best), by_pose=by_pose)
        best = _likeliest([best, *map(case.judged, readings)])
    return _model(case, tracks, best)


@dataclass(frozen=True, eq=False)
class _Judged:
    """Joints (B, ...) and mixtures of inliers and outliers about them.

    Attributes:
        frames: (B, ...).
        squares: k arrays (B, N) of the errors of position, and of orientation if that counts.
        variance: (B, k) of the inliers.
        outlier_share: (B,).
        cost: (B,) -2 log likelihood.
        inlier: (B, N) probability.
    """

    frames: JointFrames
    squares: tuple[FloatArray, ...]
    variance: FloatArray
    outlier_share: FloatArray
    cost: FloatArray
    inlier: FloatArray

    def take(self, rows: IntArray) -> _Judged:
        """Some of the joints."""
        squares = tuple(square[rows] for square in self.squares)
        arrays = (self.variance, self.outlier_share, self.cost, self.inlier)
        return _Judged(self.frames.take(rows), squares, *(array[rows] for array in arrays))

    def followed_by(self, other: _Judged) -> _Judged:
        """These joints, then others."""
        pairs = (
            (self.variance, other.variance),
            (self.outlier_share, other.outlier_share),
            (self.cost, other.cost),
            (self.inlier, other.inlier),
        )
        squares = tuple(np.concatenate(pair) for pair in zip(self.squares, other.squares, strict=True))
        return _Judged(_joined([self.frames, other.frames]), squares, *(np.concatenate(pair) for pair in pairs))


def _likeliest(some: Iterable[_Judged]) -> _Judged:
    """Of each joint the reading with the lowest cost."""

    def lower(a: _Judged, b: _Judged) -> _Judged:
        B = len(a.cost)
        return a.followed_by(b).take(np.where(a.cost <= b.cost, 0, B) + np.arange(B))

    return reduce(lower, some)


def _joined(frames: Sequence[JointFrames]) -> JointFrames:
    return JointFrames(
        np.concatenate([f.T_parent_axis for f in frames]),
        np.concatenate([f.T_axis_child for f in frames]),
        np.concatenate([f.form for f in frames]),
    )


def _hypothesis(
    joint: JointType, tracks: PairTracks, usable: BoolArray, explained: BoolArray, *, by_pose: bool
) -> JointFrames:
    """Joints (P, ...) made of a few frames each that make many of their pair's frames likely."""
    picked = _samples(usable, explained, (_count(by_pose=by_pose), sample_size(joint, by_pose=by_pose)))
    (P, H, _), rows = picked.shape, np.arange(len(picked))
    readings = closed_form(joint, tracks.T_a_b[rows[:, None, None], picked], np.ones(picked.shape), by_pose=by_pose)
    spread = _spread(usable, min(JUDGES, usable.shape[1]))
    judging = np.repeat(tracks.T_a_b[rows[:, None], spread], H, axis=0)
    scene_m3 = np.repeat(tracks.scene_m3, H)
    case = _Case(joint, judging, np.ones(judging.shape[:2], dtype=bool), scene_m3, by_pose)
    tight = reduce(_Judged.followed_by, (case.judged(_flattened(frames)) for frames in readings))
    of_pair = np.tile(np.repeat(rows, H), len(readings))
    variance = np.full((P, tight.variance.shape[-1]), np.inf)
    by_cost = np.argsort(-tight.cost, kind="stable")
    variance[of_pair[by_cost]] = tight.variance[by_cost]  # of several the last one stays, the likeliest
    cost = case.repeated(len(readings)).cost_at(tight, LOOSE**2 * variance[of_pair])
    by_cost, best = np.argsort(-cost, kind="stable"), np.zeros(P, dtype=np.intp)
    best[of_pair[by_cost]] = by_cost
    return tight.frames.take(best)


def _flattened(frames: JointFrames) -> JointFrames:
    """Frames (P, H, ...) as (P H, ...)."""
    T_parent_axis, T_axis_child = (T.reshape(-1, 4, 4) for T in (frames.T_parent_axis, frames.T_axis_child))
    return JointFrames(T_parent_axis, T_axis_child, frames.form.reshape(len(T_parent_axis), -1))


def sample_size(joint: JointType, *, by_pose: bool) -> int:
    """Frames that tell a joint, and one more where that leaves enough samples without an outlier."""
    if by_pose:
        return 3 if joint.states else 1
    return min(-(-joint.position_parameters // (3 - joint.position_states)) + 1, LARGEST_SAMPLE)


def _count(*, by_pose: bool) -> int:
    return POSE_SAMPLES if by_pose else POSITION_SAMPLES


def _samples(usable: BoolArray, explained: BoolArray, shape: tuple[int, int]) -> IntArray:
    """(P, *shape) rows of usable frames (P, T) in order of time, drawn anyhow.

    In every other sample all frames but one are none of the explained ones, as long as there are such: a few frames
    that moved among many at rest would hardly be drawn otherwise.
    """
    drawn = np.random.default_rng(SEED).uniform(size=shape)
    others = usable & ~explained
    others = np.where(others.sum(axis=-1, keepdims=True) >= shape[1], others, usable)
    found = _drawn(usable, drawn)
    found[:, ::2, 1:] = _drawn(others, drawn[::2, 1:])
    return np.sort(found, axis=-1)


def _drawn(usable: BoolArray, drawn: FloatArray) -> IntArray:
    """(P, H, n) rows of usable frames (P, T), by numbers (H, n) from 0 to 1."""
    order, count = np.argsort(~usable, axis=-1, kind="stable"), usable.sum(axis=-1)
    position = (drawn * count[:, None, None]).astype(np.intp)
    return np.take_along_axis(order, position.reshape(len(order), -1), axis=-1).reshape(position.shape)


def _spread(usable: BoolArray, size: int) -> IntArray:
    """(P, size) rows spread over the usable frames (P, T); where there are fewer, some twice."""
    order, count = np.argsort(~usable, axis=-1, kind="stable"), usable.sum(axis=-1)
    return np.take_along_axis(order, np.arange(size) * count[:, None] // size, axis=-1)


@dataclass(frozen=True, eq=False)
class _Case:
    """Frames (B, N, 4, 4) that judge joints of a type, of which some are usable (B, N), in scenes (B,)."""

    joint: JointType
    T_a_b: FloatArray
    usable: BoolArray
    scene_m3: FloatArray
    by_pose: bool

    def repeated(self, times: int) -> _Case:
        """The frames so many times over."""
        T_a_b, usable = np.tile(self.T_a_b, (times, 1, 1, 1)), np.tile(self.usable, (times, 1))
        return _Case(self.joint, T_a_b, usable, np.tile(self.scene_m3, times), self.by_pose)

    def judged(self, frames: JointFrames) -> _Judged:
        """Joints (B, ...) with the likeliest mixtures about them."""
        q = best_states(self.joint, frames, self.T_a_b, self.usable & self.by_pose, self.usable.astype(np.float64))
        at = errors(self.joint, frames, q, *entries_first(self.T_a_b))
        squares = tuple(np.sum(x**2, axis=0) for x in ((at.d, at.e) if self.by_pose else (at.d,)))
        return _likeliest(self._mixture(frames, squares, share) for share in INLIER_SHARES)

    def _mixture(self, frames: JointFrames, squares: tuple[FloatArray, ...], share: float) -> _Judged:
        """Expectation and maximisation from the best so many of the errors' squares."""
        variance = self._settled(_quantiles(squares, self.usable, 0.5 * share) / MEDIAN_SQUARE)
        outliers, cost = np.full(len(variance), 1 - share), np.zeros(len(variance))
        found = _Judged(frames, squares, variance, outliers, cost, self.usable.astype(np.float64))
        for _ in range(MIXTURE_ROUNDS):  # each round's weights come from the last
            cost, inlier = self._expected(found, found.variance, found.outlier_share)
            weight = inlier.sum(axis=-1)
            sums = np.stack([np.einsum("bn,bn->b", square, inlier) for square in squares], axis=-1)
            mean = sums / (3 * np.maximum(weight, 1.0))[:, None]
            found = _Judged(frames, squares, self._settled(mean), self._share(weight), cost, inlier)
        return found

    def weights(self, some: _Judged) -> FloatArray:
        """(B, N) weights for another joint: the inliers', or those of all frames where too few are inliers to make
        one.
        """
        enough = some.inlier.sum(axis=-1) >= sample_size(self.joint, by_pose=self.by_pose)
        return np.where(enough[:, None], some.inlier, self.usable)

    def cost_at(self, some: _Judged, variance: FloatArray) -> FloatArray:
        """(B,) -2 log likelihood with given variances (B, k) and the likeliest share of outliers."""
        outliers, cost = some.outlier_share, some.cost
        for _ in range(MIXTURE_ROUNDS):  # each round's weights come from the last
            cost, inlier = self._expected(some, variance, outliers)
            outliers = self._share(inlier.sum(axis=-1))
        return cost

    def _share(self, weight: FloatArray) -> FloatArray:
        """(B,) share of outliers if the inliers weigh so much."""
        return np.clip(1 - weight / np.maximum(self.usable.sum(axis=-1), 1), LEAST_SHARE, 1 - LEAST_SHARE)

    def _expected(self, some: _Judged, variance: FloatArray, outliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """-2 log likelihood (B,) and the inliers' probability (B, N)."""
        arm_m = np.linalg.norm(some.frames.T_axis_child[:, :3, 3], axis=-1)
        log_outside = -np.log(self.scene_m3) - self.by_pose * np.log(ROTATION_VOLUME)
        information = -0.5 / variance
        inside = sum(square * information[:, i, None] for i, square in enumerate(some.squares))
        inside += (np.log1p(-outliers) + self._log_open(variance, arm_m))[:, None]
        inside -= 1.5 * np.sum(np.log(TURN * variance), axis=-1)[:, None]
        total, inlier = either(inside, (np.log(outliers) + log_outside)[:, None])
        return -2 * np.sum(total * self.usable, axis=-1), inlier * self.usable

    def _settled(self, variance: FloatArray) -> FloatArray:
        """(B, k) variances without zeros: orientations that states explain whole tell nothing."""
        variance = np.maximum(variance, LEAST_VARIANCE)
        if variance.shape[-1] > 1:
            told = variance[:, 1] > LEAST_VARIANCE
            variance[:, 1] = np.where(told, variance[:, 1], variance[:, 0] / BALANCE_M**2)
        return variance

    def _log_open(self, variance: FloatArray, arm_m: FloatArray) -> FloatArray:
        """(B,) logarithm of the share of the states' range that a frame leaves open; see `pair_likelihood`."""
        states = self.joint.states if self.by_pose else self.joint.position_states
        std, whole = np.sqrt(variance[:, 0]), self.scene_m3 ** (1 / 3)
        if self.joint.unit == "rad":
            std, whole = np.sqrt(variance[:, 1]) if self.by_pose else std / np.maximum(arm_m, std), TURN
        return states * np.log(np.minimum(np.sqrt(TURN) * std / whole, 1.0))


def _quantiles(squares: Sequence[FloatArray], usable: BoolArray, share: float) -> FloatArray:
    """(B, k) quantiles over the usable frames of k squares (B, N)."""
    middle = (share * np.maximum(usable.sum(axis=-1) - 1, 0) + 0.5).astype(np.intp)[:, None]
    ordered = [np.sort(np.where(usable, square, np.inf), axis=-1) for square in squares]
    found = np.concatenate([np.take_along_axis(one, middle, axis=-1) for one in ordered], axis=-1)
    return np.where(np.isfinite(found), found, 1.0)


def _model(case: _Case, tracks: PairTracks, best: _Judged) -> Model:
    data, weights = tracks.data, case.weights(best)
    q = best_states(case.joint, best.frames, tracks.T_a_b, tracks.oriented & case.by_pose, weights)
    at = errors(case.joint, best.frames, q, data.R, data.t)
    scales = data.noise.mean_scales(at.d, at.e, weights, data.oriented)
    return Model(best.frames, q, scales, best.outlier_share, np.full(len(q), FLIP_SHARE_START))
