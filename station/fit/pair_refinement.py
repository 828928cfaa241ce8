"""Least squares from a start: Gauss-Newton steps with Levenberg and Marquardt's damping, states projected out.

Frames are weighted by the probability that they are inliers; the noise's scales and the shares of outliers and of wrong
orientations are updated with each step. What becomes of a pair doesn't depend on those that are fitted beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.entrywise import entries_last
from station.fit.pair_data import PairData
from station.fit.pair_likelihood import Likelihood, likelihood, log_open, shares
from station.fit.pair_model import JointFit, Model, stepped_frames
from station.fit.pair_residuals import Linear, errors, linearised, residual_of_poses, state_steps
from station.fit.whitening import Projected, Whitening
from station.kinematics.joints import JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

LM_ITERATIONS = 30
# A pair is settled when a step promises to change its -2 log likelihood by less than this; 1 would be a standard
# deviation.
COST_TOLERANCE = 1e-2
DAMPING_START, DAMPING_FALL, DAMPING_RISE, DAMPING_MIN, DAMPING_MAX = 1e-3, 0.2, 8.0, 1e-9, 1e8
# A frame that a step makes dearer by more, in -2 log likelihood, is tried with such a share of its state's step.
DEARER, SHORTER = 0.1, 0.5


@dataclass(frozen=True, eq=False)
class Progress:
    """Models on their way.

    Attributes:
        model: P of them.
        damping: (P,) of the next step.
        cost: (P,) -2 log likelihood.
        promise: (P,) by how much the last step promised to lower it.
        log_open: (P,) logarithm of the share of the states' range that a frame leaves open.
    """

    model: Model
    damping: FloatArray
    cost: FloatArray
    promise: FloatArray
    log_open: FloatArray

    def take(self, rows: IntArray) -> Progress:
        """Some of the pairs."""
        return Progress(self.model.take(rows), *(array[rows] for array in self._arrays))

    def with_rows(self, rows: IntArray, some: Progress) -> Progress:
        """With others for some of the pairs."""
        arrays = [array.copy() for array in self._arrays]
        for array, changed in zip(arrays, some._arrays, strict=True):
            array[rows] = changed
        return Progress(self.model.with_rows(rows, some.model), *arrays)

    @property
    def _arrays(self) -> tuple[FloatArray, ...]:
        return self.damping, self.cost, self.promise, self.log_open


def begin(model: Model) -> Progress:
    """Before the first step."""
    P = len(model.q)
    return Progress(model, np.full(P, DAMPING_START), np.full(P, np.inf), np.full(P, np.inf), np.zeros(P))


def improve(
    joint: JointType, data: PairData, progress: Progress, *, iterations: int, tolerance: FloatArray
) -> Progress:
    """Maximise the likelihood of parameters, states, noise scales and shares.

    Args:
        joint: the type.
        data: of the pairs.
        progress: where they are.
        iterations: at most.
        tolerance: (P,) a pair is settled when its step promises to lower its -2 log likelihood by no more than this.
    """
    for _ in range(iterations):  # each step starts where the last one ended
        left = np.flatnonzero(progress.promise > tolerance)
        if not left.size:
            break
        if len(left) == len(tolerance):
            progress = _improved(joint, data, progress)
        else:
            progress = progress.with_rows(left, _improved(joint, data.take(left), progress.take(left)))
    return progress


def _improved(joint: JointType, data: PairData, progress: Progress) -> Progress:
    """One damped Gauss-Newton step, where it is better, and new noise scales and shares."""
    model = progress.model
    whitening = data.noise.whitening(model.scales)
    at = errors(joint, model.frames, model.q, data.R, data.t)
    residual = whitening(at.d, at.e)
    now = likelihood(data, model, whitening, residual, progress.log_open)
    trusted = whitening.trusting(now.oriented)
    residual[3:] *= np.sqrt(now.oriented)
    linear = linearised(joint, model, at, trusted, residual)
    step, gain = _damped_step(linear, residual, now.inlier, progress.damping)
    moved = replace(model, frames=stepped_frames(joint, model.frames, step))
    moved, cost = _judged(joint, data, moved, linear.state_step(step), whitening, trusted, now.costs, progress.log_open)
    better = cost <= now.cost
    fitted, change = _with_noise(data, moved.where(better, model), now, linear, residual, trusted)
    damping = _damping(progress.damping, better)
    room = log_open(joint, data, linear.state_scale, now.inlier)
    return Progress(fitted, damping, np.fmin(now.cost, cost), gain + change, room)


def _damping(damping: FloatArray, better: BoolArray) -> FloatArray:
    """(P,) the next step's: more after one that made nothing better, from where it matters."""
    more = np.maximum(damping * DAMPING_RISE, DAMPING_START)
    return np.clip(np.where(better, damping * DAMPING_FALL, more), DAMPING_MIN, DAMPING_MAX)


def _damped_step(
    linear: Linear, residual: FloatArray, weights: FloatArray, damping: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Step (P, n), its columns scaled to unit length, so that one damping suits metres and radians; and by how much it
    and the states' own promise to lower chi squared (P,).
    """
    H, g = linear.normal_equations(residual, weights)
    scale = np.sqrt(np.diagonal(H, axis1=-2, axis2=-1))
    scale = np.where(scale > 0, scale, 1.0)
    scaled = H / (scale[:, :, None] * scale[:, None, :]) + damping[:, None, None] * np.eye(H.shape[-1])
    step = -np.linalg.solve(scaled, (g / scale)[..., None])[..., 0] / scale
    along = np.einsum("rspt,rpt->spt", linear.states, residual)
    own = np.einsum("spt,spt,pt->p", along, along, weights)
    return step, own - np.sum(g * step, axis=-1)


def _judged(
    joint: JointType,
    data: PairData,
    model: Model,
    step: FloatArray,
    whitening: Whitening,
    trusted: Whitening,
    before: FloatArray,
    room: FloatArray,
) -> tuple[Model, FloatArray]:
    """The model with its states moved by `step` (P, T, s), and its cost (P,).

    A frame that is dearer than `before`, by its -2 log likelihood (P, T), went too far: its state goes half the way.
    A long step in a curved valley is a good one once the states follow its parameters: where a pair as a whole is
    dearer still, they do in frames in which that is better.
    """
    moved = replace(model, q=joint.moved(model.q, step))
    at = errors(joint, moved.frames, moved.q, data.R, data.t)
    cost = likelihood(data, moved, whitening, whitening(at.d, at.e), room).costs
    if not joint.states:
        return moved, cost.sum(axis=-1)
    rows, frames = np.nonzero(cost > before + DEARER)
    if rows.size:
        q = joint.moved(model.q[rows, frames], SHORTER * step[rows, frames])
        its_cost = _costs_of_frames(joint, data, moved, q, rows, frames, room)
        better = its_cost < cost[rows, frames]
        moved.q[rows[better], frames[better]] = q[better]
        cost[rows[better], frames[better]] = its_cost[better]
    worse = np.flatnonzero(cost.sum(axis=-1) > before.sum(axis=-1))
    if worse.size:
        q, followed = _followed(joint, data.take(worse), moved.take(worse), trusted.take(worse), room[worse])
        better = followed < cost[worse]
        moved.q[worse], cost[worse] = np.where(better[..., None], q, moved.q[worse]), np.fmin(followed, cost[worse])
    return moved, cost.sum(axis=-1)


def _followed(
    joint: JointType, data: PairData, model: Model, trusted: Whitening, room: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States (P, T, s) that follow a model's parameters, and -2 log likelihood of the frames (P, T) in them."""
    whitening = data.noise.whitening(model.scales)
    at = errors(joint, model.frames, model.q, data.R, data.t)
    q = joint.moved(model.q, state_steps(joint, model.frames, at, trusted, whitening(at.d, at.e)))
    at = errors(joint, model.frames, q, data.R, data.t)
    return q, likelihood(data, model, whitening, whitening(at.d, at.e), room).costs


def _costs_of_frames(
    joint: JointType, data: PairData, model: Model, q: FloatArray, rows: IntArray, frames: IntArray, room: FloatArray
) -> FloatArray:
    """(N,) -2 log likelihood of some frames of some pairs in other states (N, s)."""
    some, of_pair = data.frames(rows, frames), replace(model, q=model.q[:, :0]).take(rows)
    whitening = some.noise.whitening(of_pair.scales)
    at = errors(joint, of_pair.frames, q[:, None], some.R, some.t)
    return likelihood(some, of_pair, whitening, whitening(at.d, at.e), room[rows]).costs[:, 0]


def _with_noise(
    data: PairData, model: Model, now: Likelihood, linear: Linear, residual: FloatArray, trusted: Whitening
) -> tuple[Model, FloatArray]:
    """The model with new scales and shares, and by how much these lower -2 log likelihood (P,), about."""
    measured = 3.0 * data.seen + 3.0 * data.oriented * now.oriented
    projected = Projected(residual, linear.states, now.inlier, measured, linear.by_parameters.shape[1])
    scales = data.noise.updated_scales(model.scales, trusted, projected)
    outliers, flips = shares(data, now)
    frames = now.inlier.sum(axis=-1)
    change = 0.5 * np.sum(now.inlier * measured, axis=-1) * np.max(np.log(scales / model.scales) ** 2, axis=-1)
    for share, before in ((outliers, model.outlier_share), (flips, model.flip_share)):
        change += frames * (share - before) ** 2 / (before * (1 - before))
    return replace(model, scales=scales, outlier_share=outliers, flip_share=flips), change


def inliers(joint: JointType, data: PairData, progress: Progress) -> FloatArray:
    """(P, T) probability that frames are inliers."""
    model, whitening = progress.model, data.noise.whitening(progress.model.scales)
    at = errors(joint, model.frames, model.q, data.R, data.t)
    return likelihood(data, model, whitening, whitening(at.d, at.e), progress.log_open).inlier


def finished(joint: JointType, data: PairData, progress: Progress) -> JointFit:
    """All that is known of the fit where it has come to."""
    model = progress.model
    whitening = data.noise.whitening(model.scales)
    at = errors(joint, model.frames, model.q, data.R, data.t)
    residual = whitening(at.d, at.e)
    now = likelihood(data, model, whitening, residual, progress.log_open)
    residual[3:] *= np.sqrt(now.oriented)
    linear = linearised(joint, model, at, whitening.trusting(now.oriented), residual)
    information, _ = linear.normal_equations(residual, now.inlier)
    chi2 = np.sum(residual**2, axis=0)
    left = residual_of_poses(at, data)
    left[..., 3:] *= now.oriented[..., None]
    return JointFit(
        joint=joint,
        model=model,
        inlier=now.inlier,
        chi2=chi2,
        log_density=(now.log_inside + 0.5 * chi2) * data.seen,
        state_information=linear.state_information * data.seen[..., None, None],
        residual=left,
        information=information,
        coupling=np.ascontiguousarray(entries_last(linear.coupling, 2)),
    )
