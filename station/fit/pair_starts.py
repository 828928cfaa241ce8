"""Starts of a fit: closed forms of a joint type, reweighted against outliers, and the likeliest of its readings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.pair_likelihood import likelihood
from station.fit.pair_model import OUTLIER_SHARE_START, Model, PairTracks
from station.fit.pair_residuals import errors
from station.kinematics import se3
from station.kinematics.joints import JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Degrees of freedom of the Student weights that protect the closed-form start: heavy tails, yet settled in a few
# rounds.
STUDENT_FREEDOMS = 3.0
START_ROUNDS = 1
# Share of the inliers with a wrong orientation: where it starts.
FLIP_SHARE_START = 0.01


@dataclass(frozen=True, eq=False)
class Start:
    """A model to start from, its -2 log likelihood (P,), and weights (P, T) for the next closed form."""

    model: Model
    cost: FloatArray
    weights: FloatArray


def best_states(
    joint: JointType, frames: JointFrames, T_a_b: FloatArray, oriented: BoolArray, weights: FloatArray
) -> FloatArray:
    """(P, T, s) closed-form states of poses, where these are oriented (P, T), else of positions; weights (P, T)."""
    M = se3.inverse(frames.T_parent_axis)[:, None] @ T_a_b
    zero, form = frames.T_axis_child[:, None], frames.form[:, None]
    q = joint.axis_state(M, zero, form) if oriented.any() else np.zeros((*M.shape[:2], joint.states))
    if not oriented.all():
        by_position = joint.axis_state_of_position(M[..., :3, 3], zero[..., :3, 3], form)
        q = np.where(oriented[..., None], q, by_position)
    return joint.over_time(q, M[..., :3, 3], frames.T_axis_child[..., :3, 3], frames.form, weights)


def start_models(joint: JointType, tracks: PairTracks, *, by_pose: bool, weights: FloatArray | None = None) -> Model:
    """Closed-form start, reweighted a few rounds against outliers; each pair's likeliest of the type's readings.

    The weights (P, T) to begin with are those of the frames seen unless they are given.
    """
    weights = tracks.seen.astype(np.float64) if weights is None else weights
    best = _start(joint, tracks, weights, by_pose=by_pose)
    for _ in range(START_ROUNDS):  # each round's weights come from the last
        best = likelier(_start(joint, tracks, best.weights, by_pose=by_pose), best)
    return best.model


def _start(joint: JointType, tracks: PairTracks, weights: FloatArray, *, by_pose: bool) -> Start:
    """The likeliest reading of weighted frames (P, T)."""
    weights = weights * tracks.oriented if by_pose else weights
    readings = closed_form(joint, tracks.T_a_b, weights, by_pose=by_pose)
    return reduce(likelier, (judged(joint, tracks, frames, weights, by_pose=by_pose) for frames in readings))


def closed_form(joint: JointType, T_a_b: FloatArray, weights: FloatArray, *, by_pose: bool) -> tuple[JointFrames, ...]:
    """The type's readings of poses (..., T, 4, 4) with weights (..., T), or of positions alone.

    Raises:
        InvalidData: for a type that offers none.
    """
    found = joint.starts(T_a_b, weights) if by_pose else joint.position_starts(T_a_b[..., :3, 3], weights)
    if not found:
        raise InvalidData(f"joint type {joint.name} offers no start for a fit")
    return found


def judged(joint: JointType, tracks: PairTracks, frames: JointFrames, weights: FloatArray, *, by_pose: bool) -> Start:
    """Joints (P, ...) with their best states, noise by its median, and how they explain the frames."""
    data = tracks.data
    q = best_states(joint, frames, tracks.T_a_b, tracks.oriented & by_pose, weights)
    at = errors(joint, frames, q, data.R, data.t)
    scales = data.noise.robust_scales(at.d, at.e, data.seen, data.oriented)
    share = np.full(len(q), OUTLIER_SHARE_START)
    model = Model(frames, q, scales, share, np.full(len(q), FLIP_SHARE_START))
    whitening = data.noise.whitening(scales)
    residual = whitening(at.d, at.e)
    chi2 = np.sum(residual**2, axis=0)
    student = (STUDENT_FREEDOMS + tracks.dimensions) / (STUDENT_FREEDOMS + chi2)
    cost = likelihood(data, model, whitening, residual, np.zeros(len(q))).cost
    return Start(model, cost, student * tracks.seen)


def likelier(one: Start, other: Start) -> Start:
    """The likelier of two starts for each pair."""
    better = one.cost < other.cost
    return Start(
        one.model.where(better, other.model),
        np.where(better, one.cost, other.cost),
        np.where(better[:, None], one.weights, other.weights),
    )
