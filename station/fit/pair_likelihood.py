"""How likely frames are: inliers, inliers with a wrong orientation, and outliers anywhere in the scene.

    p = (1 - s) c ((1 - f) N(r_v, r_w) + f N(r_v) / 8 pi^2) + s / (scene 8 pi^2)

with a share s of outliers and a share f of the inliers whose orientation is wrong, such as a flat marker's that is
taken for its mirror image. Both are estimated. The states are at their best, and c is the share of their range (a turn,
the scene) that a frame leaves open to them: without it each state would make inliers of frames that are none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.pair_data import PairData
from station.fit.pair_model import ROTATION_VOLUME, Model
from station.fit.whitening import Whitening
from station.kinematics.joints import JointType
from station.logs import FloatArray

TURN = 2 * np.pi
# Counts of frames in the Beta priors that keep shares off 0 and 1.
PRIOR_OUT, PRIOR_IN = 0.5, 10.0


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Of P pairs in T frames, (P, T) each.

    Attributes:
        log_inside: log density of an inlier at its best states.
        log_total: log density; 0 unseen.
        inlier: probability that the frame is one; 0 unseen.
        oriented: probability that an inlier's orientation is right.
    """

    log_inside: FloatArray
    log_total: FloatArray
    inlier: FloatArray
    oriented: FloatArray

    @property
    def costs(self) -> FloatArray:
        """(P, T) -2 log likelihood of each frame."""
        return -2 * self.log_total

    @property
    def cost(self) -> FloatArray:
        """(P,) -2 log likelihood."""
        return -2 * self.log_total.sum(axis=-1)


def likelihood(
    data: PairData, model: Model, whitening: Whitening, residual: FloatArray, log_open: FloatArray
) -> Likelihood:
    """Of whitened residuals (6, P, T), with the logarithm of the share c (P,) that a frame leaves open to states."""
    share, flips = model.outlier_share[:, None], model.flip_share[:, None]
    by_position = whitening.log_v - 0.5 * np.sum(residual[:3] ** 2, axis=0)
    by_pose = by_position + whitening.log_w - 0.5 * np.sum(residual[3:] ** 2, axis=0)
    inside, oriented = either(np.log1p(-flips) + by_pose, np.log(flips / ROTATION_VOLUME) + by_position)
    inside, oriented = np.where(data.oriented, inside, by_pose), np.where(data.oriented, oriented, 1.0)
    total, inlier = either(np.log1p(-share) + inside + log_open[:, None], np.log(share) + data.log_outlier)
    return Likelihood(inside, total * data.seen, inlier * data.seen, oriented)


def either(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """log(exp(a) + exp(b)), and the share of the first; much faster than NumPy's logaddexp."""
    smaller = np.exp(-np.abs(a - b))
    whole = 1 + smaller
    return np.maximum(a, b) + np.log(whole), np.where(a > b, 1.0, smaller) / whole


def shares(data: PairData, seen: Likelihood) -> tuple[FloatArray, FloatArray]:
    """Share of outliers (P,), and of the inliers with a wrong orientation (P,): posterior means."""
    frames, inliers = data.seen.sum(axis=-1), seen.inlier.sum(axis=-1)
    oriented = (seen.inlier * data.oriented).sum(axis=-1)
    flipped = (seen.inlier * data.oriented * (1 - seen.oriented)).sum(axis=-1)
    prior = PRIOR_OUT + PRIOR_IN
    return (frames - inliers + PRIOR_OUT) / (frames + prior), (flipped + PRIOR_OUT) / (oriented + prior)


def log_open(joint: JointType, data: PairData, state_scale: FloatArray, weights: FloatArray) -> FloatArray:
    """(P,) logarithm of the share of the states' range that a frame leaves open, its mean over weighted frames (P, T).

    `state_scale` (s, P, T) are deviations of the states, each given those before it; 0 where it is not told.
    """
    whole = TURN if joint.unit == "rad" else data.scene_m[:, None]
    share = np.minimum(np.sqrt(TURN) * state_scale / whole, 1.0)
    log_share = np.where(share > 0, np.log(np.where(share > 0, share, 1.0)), 0.0).sum(axis=0)
    return np.sum(weights * log_share, axis=-1) / np.maximum(weights.sum(axis=-1), 1.0)
