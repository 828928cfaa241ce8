"""Which of a part's two candidate poses is the true one: by its own corners, over time, or by a prediction.

All three give probabilities. A choice that nothing decides has one near a half; it is ambiguous, and said to be so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.kinematics import se3
from station.logs import FloatArray, PoseLog
from station.perception.hypotheses import PoseHypotheses
from station.perception.observations import SOLUTIONS, IntArray

CAMERA_FRAME = "camera"

# A choice less probable than this is ambiguous.
SURE = 0.95
# From one sighting to the next a part turns like others of its own; smaller typical steps than this are taken as this.
SMALLEST_STEP_RAD = np.deg2rad(0.1)
# Degrees of freedom of the t distribution of steps: a part may jump, but turning to and fro costs more than noise.
STEP_DOF = 3.0
AXES = 3


@dataclass(frozen=True, eq=False)
class Choice:
    """Candidates chosen for K parts in F frames.

    Attributes:
        chosen: (F, K) 0 or 1, 0 where nothing was seen.
        probability: (F, K) of the chosen candidate; NaN where nothing was seen.
    """

    chosen: IntArray
    probability: FloatArray

    @property
    def ambiguous(self) -> NDArray[np.bool_]:
        """(F, K) the other candidate may well be the true one; False where nothing was seen."""
        return self.probability < SURE


def _choice(hypotheses: PoseHypotheses, log_odds: FloatArray) -> Choice:
    """The choice by unnormalised log probabilities (F, K, 2)."""
    seen = hypotheses.seen
    known = np.where(seen[..., None], log_odds, 0.0)
    log_probability = known - np.logaddexp.reduce(known, axis=-1, keepdims=True)
    chosen = np.argmax(log_probability, axis=-1)
    return Choice(chosen, np.where(seen, np.exp(log_probability.max(axis=-1)), np.nan))


def choose_by_corners(hypotheses: PoseHypotheses) -> Choice:
    """The candidates that their own frames' corners prefer."""
    return _choice(hypotheses, hypotheses.log_likelihood)


def choose_over_time(hypotheses: PoseHypotheses) -> Choice:
    """The candidates that the corners and the rotations' continuity prefer, given the whole log.

    Each part is a chain of two states. The corners' likelihood decides where it can, the step from sighting to sighting
    where it can't; forward-backward gives each sighting's probabilities.
    """
    rows = _sightings(hypotheses.seen)
    parts = np.arange(len(hypotheses.parts))
    emission = np.where(rows[..., None] >= 0, hypotheses.log_likelihood[rows, parts], 0.0)
    log_step = _log_steps(hypotheses, rows)
    forward, backward = np.array(emission), np.zeros(emission.shape)
    for n in range(1, len(rows)):  # over time, all parts at once: each sighting needs the one before
        forward[n] += np.logaddexp.reduce(forward[n - 1][:, :, None] + log_step[n - 1], axis=1)
    for n in range(len(rows) - 2, -1, -1):  # and back
        backward[n] = np.logaddexp.reduce(log_step[n] + (emission[n + 1] + backward[n + 1])[:, None, :], axis=2)
    log_odds = np.zeros(hypotheses.chi2.shape)
    n, k = np.nonzero(rows >= 0)
    log_odds[rows[n, k], k] = (forward + backward)[n, k]
    return _choice(hypotheses, log_odds)


def _sightings(seen: NDArray[np.bool_]) -> IntArray:
    """(n, K) frames in which each part was seen, in the order of time; -1 beyond its last."""
    counts = seen.sum(axis=0)
    rows = np.full((counts.max(initial=0), seen.shape[1]), -1)
    frame, part = np.nonzero(seen)
    rows[(np.cumsum(seen, axis=0) - 1)[frame, part], part] = frame
    return rows


def _log_steps(hypotheses: PoseHypotheses, rows: IntArray) -> FloatArray:
    """(n - 1, K, 2, 2) log densities of the turn from candidate i of a sighting to candidate j of the next."""
    parts = np.arange(len(hypotheses.parts))
    both = (rows[:-1] >= 0) & (rows[1:] >= 0)
    R = hypotheses.T_cam_part[..., :3, :3][rows, parts]
    C = hypotheses.covariance[..., 3:, 3:][rows, parts]
    turn = se3.log_so3(np.swapaxes(R[:-1, :, :, None], -1, -2) @ R[1:, :, None])
    noise = C[:-1, :, :, None] + C[1:, :, None]
    step_rad = _typical_steps(turn, noise, np.diff(hypotheses.t_s[rows], axis=0), both)
    spread = noise + (step_rad**2)[..., None, None, None, None] * np.eye(AXES)
    log_density = student_log_density(turn, spread)
    # Where a candidate is missing its own likelihood is zero.
    return np.where(both[..., None, None] & np.isfinite(log_density), log_density, 0.0)


def student_log_density(error: FloatArray, spread: FloatArray) -> FloatArray:
    """Log density (...), up to a constant, of errors (..., 3) with spreads (..., 3, 3), of STEP_DOF; NaN for NaN."""
    known = np.all(np.isfinite(spread), axis=(-2, -1)) & np.all(np.isfinite(error), axis=-1)
    spread = np.where(known[..., None, None], spread, np.eye(AXES))
    squared = np.sum(error * np.linalg.solve(spread, error[..., None])[..., 0], axis=-1)
    log_density = -0.5 * (STEP_DOF + AXES) * np.log1p(squared / STEP_DOF) - 0.5 * np.linalg.slogdet(spread)[1]
    return np.where(known, log_density, np.nan)


def _typical_steps(turn: FloatArray, noise: FloatArray, dt_s: FloatArray, both: NDArray[np.bool_]) -> FloatArray:
    """(n - 1, K) rad that each part turns by, an axis: the median of its smallest steps, less noise, over its time."""
    squared = np.where(both[..., None, None], np.nan_to_num(np.sum(turn**2, axis=-1), nan=np.inf), np.inf)
    flat = squared.reshape(*both.shape, SOLUTIONS**2)
    least = np.argmin(flat, axis=-1)[..., None]
    expected = np.take_along_axis(np.trace(noise, axis1=-2, axis2=-1).reshape(flat.shape), least, axis=-1)[..., 0]
    beyond = np.take_along_axis(flat, least, axis=-1)[..., 0] - expected
    steps = np.full(both.shape, SMALLEST_STEP_RAD)
    for k in np.flatnonzero(both.any(axis=0)):  # a few parts; each has its own typical step
        rows = both[:, k]
        typical = np.sqrt(max(float(np.median(beyond[rows, k])), 0.0) / AXES)
        scaled = np.maximum(typical, SMALLEST_STEP_RAD) * dt_s[:, k] / np.median(dt_s[rows, k])
        steps[:, k] = np.where(rows, np.clip(scaled, SMALLEST_STEP_RAD, np.pi), SMALLEST_STEP_RAD)
    return steps


def choose_by_prediction(
    hypotheses: PoseHypotheses, before: Choice, R_predicted: FloatArray, spread: FloatArray
) -> Choice:
    """Ambiguous choices made anew, by where something else says that the parts are turned to; the others stay.

    Args:
        hypotheses: the candidates.
        before: the choice so far.
        R_predicted: rotations (F, K, 3, 3) in the camera, or (F, K, 2, 3, 3), one to compare each candidate with; NaN
            where there is no prediction: the choice stays there.
        spread: (F, K, 3, 3) or (F, K, 2, 3, 3) covariances of them, of the right perturbation [rad].
    """
    if R_predicted.ndim == 4:
        R_predicted, spread = R_predicted[:, :, None], spread[:, :, None]
    error = se3.log_so3(np.swapaxes(R_predicted, -1, -2) @ hypotheses.T_cam_part[..., :3, :3])
    closeness = student_log_density(error, spread + hypotheses.covariance[..., 3:, 3:])
    known = np.isfinite(closeness[..., 0])
    log_odds = hypotheses.log_likelihood + np.where(np.isnan(closeness), -np.inf, closeness)
    anew = _choice(hypotheses, np.where(known[..., None], log_odds, 0.0))
    change = before.ambiguous & known
    return Choice(np.where(change, anew.chosen, before.chosen), np.where(change, anew.probability, before.probability))


def chosen_poses(hypotheses: PoseHypotheses, choice: Choice) -> PoseLog:
    """The chosen candidates as a log; where a choice is not certain its covariance has the other candidate added."""
    at = (*np.indices(choice.chosen.shape), choice.chosen)
    other = (*np.indices(choice.chosen.shape), 1 - choice.chosen)
    T, covariance = hypotheses.T_cam_part[at], hypotheses.covariance[at]
    apart = np.nan_to_num(se3.log(se3.inverse(T) @ hypotheses.T_cam_part[other]))
    left = np.nan_to_num(1 - choice.probability)[..., None, None]
    covariance = covariance + left * (apart[..., :, None] * apart[..., None, :])
    return PoseLog(hypotheses.t_s, CAMERA_FRAME, hypotheses.parts, T, covariance)
