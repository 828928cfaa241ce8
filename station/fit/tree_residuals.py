"""Measured poses of a tree's parts, whitened, and how far a model is from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammaincinv

from station.fit import entrywise
from station.fit.bodies import Bodies
from station.fit.entrywise import entries_last
from station.fit.noise import Noise
from station.fit.pairwise import OUTLIER_SHARE_START, ROTATION_VOLUME
from station.fit.tree_data import PartEquations
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Poses whitened at once: some 200 numbers each while it lasts.
POSES_AT_ONCE = 40_000
# A pose that is less likely an inlier than this tells nothing; as a tiny weight it would only ruin the arithmetic.
LEAST_INLIER = 1e-3
# Where a part's better squared residuals, up to this share of its poses, are so many times the usual, the part is not
# where it belongs; the usual ones of a whole pose, and of a position alone.
BETTER_SHARE, HOT = 0.25, 2.0
USUAL = (float(2.0 * gammaincinv(6 / 2, BETTER_SHARE)), float(2.0 * gammaincinv(3 / 2, BETTER_SHARE)))


@dataclass(frozen=True, eq=False)
class Measured:
    """Poses of the tree's K parts.

    Attributes:
        T_ref_part: (T, K, 4, 4).
        whitener: (T, K, 6, 6) W with W^T W the inverse covariance along the reference's axes; zero for what was not
            measured.
        log_odds: (T, K) of inlier against outlier at zero residual, as the whitener has it; -inf where unseen.
        dimensions: (T, K) numbers measured: 6, 3 without orientation, 0 unseen.
        spread: (K, 2) deviations of position and orientation, as multiples of those that the whitener has.
    """

    T_ref_part: FloatArray
    whitener: FloatArray
    log_odds: FloatArray
    dimensions: FloatArray
    spread: FloatArray

    def take(self, rows: slice | IntArray) -> Measured:
        """Some of the frames."""
        return Measured(
            self.T_ref_part[rows], self.whitener[rows], self.log_odds[rows], self.dimensions[rows], self.spread
        )

    def of_parts(self, parts: Sequence[int]) -> Measured:
        """Some of the parts."""
        k = list(parts)
        return Measured(
            self.T_ref_part[:, k], self.whitener[:, k], self.log_odds[:, k], self.dimensions[:, k], self.spread[k]
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(T, K)."""
        return self.dimensions.shape[0], self.dimensions.shape[1]

    def chi2(self, T_ref_part: FloatArray, shared: FloatArray) -> FloatArray:
        """(T, K) squared lengths of the whitened residuals; poses share nothing."""
        return tree_residuals(self, T_ref_part).chi2

    def on_parts(
        self, T_ref_part: FloatArray, shared: FloatArray, centre: FloatArray, weights: FloatArray
    ) -> PartEquations:
        """Equations by twists about `centre` (T, 3), poses counting by their weights (T, K)."""
        residuals = tree_residuals(self, T_ref_part)
        by_twist = part_jacobians(self, residuals, T_ref_part, centre)
        weighted_t = np.ascontiguousarray(np.swapaxes(by_twist, -1, -2)) * weights[..., None, None]
        return PartEquations(weighted_t @ by_twist, (weighted_t @ residuals.whitened[..., None])[..., 0])

    def hotter(self, heat: FloatArray) -> Measured:
        """With variances so many times as large (K,)."""
        if np.all(heat == 1):
            return self
        return replace(self, spread=self.spread * np.sqrt(heat)[:, None])

    def heat(self, chi2: FloatArray) -> FloatArray:
        """(K,) factors, at least 1, of the variances of parts that as a whole don't fit, by chi2 (T, K).

        While a joint is far from where it belongs, its parts are no outliers. Their variances are raised until the
        better poses of a part, those up to `BETTER_SHARE` of its squared residuals, are `HOT` times the usual.
        """
        against_usual = np.where(self.seen, chi2 / np.where(self.dimensions == 6, *USUAL), np.inf)
        return np.maximum(better_ones(against_usual, self.seen) / HOT, 1.0)

    def weights(self, chi2: FloatArray) -> FloatArray:
        """(T, K) probability that a pose is no outlier, by its whitened squared residual (T, K)."""
        probability = np.asarray(expit(self._log_odds(chi2)), dtype=np.float64)
        return np.where(probability > LEAST_INLIER, probability, 0.0)

    def costs(self, chi2: FloatArray) -> FloatArray:
        """(T, K) -2 log likelihood of each pose, inlier or outlier, less that of an outlier."""
        return -2 * np.logaddexp(self._log_odds(chi2), 0.0)

    def _log_odds(self, chi2: FloatArray) -> FloatArray:
        position, orientation = np.log(self.spread).T
        volume = 3 * position + np.maximum(self.dimensions - 3, 0.0) * orientation
        return self.log_odds - volume - 0.5 * chi2

    @property
    def seen(self) -> BoolArray:
        """(T, K)."""
        return self.dimensions > 0

    @property
    def per_row(self) -> FloatArray:
        """(K, 6) one over the spread, for each whitened residual."""
        return np.repeat(1 / self.spread, 3, axis=-1)

    @cached_property
    def spread_whitener(self) -> FloatArray:
        """(T, K, 6, 6) with the spread in it."""
        return self.whitener * self.per_row[..., None]


def measured_parts(bodies: Bodies, parts: Sequence[int]) -> Measured:
    """What was measured of some parts, each still a body of its own, with their covariances."""
    k = list(parts)
    T_ref_part, seen, oriented = bodies.T_ref_body[:, k], bodies.seen[:, k], bodies.oriented[:, k]
    if bodies.covariance is None:
        raise ValueError("a tree is fitted with covariances")
    whitener, log_density = np.empty((*seen.shape, 6, 6)), np.empty(seen.shape)
    rows = max(POSES_AT_ONCE // max(len(k), 1), 1)
    for start in range(0, len(seen), rows):  # memory asks for this loop
        some = slice(start, start + rows)
        noise = Noise(bodies.covariance[some, k], None, np.ones((len(seen[some]), 1)))
        W, log_density[some] = noise.whitener(np.ones((len(seen[some]), 1)), seen[some], oriented[some])
        R_part_ref = np.swapaxes(T_ref_part[some, ..., :3, :3], -1, -2)
        for columns in (slice(0, 3), slice(3, 6)):
            whitener[some, ..., columns] = W[..., columns] @ R_part_ref
    outside = -np.log(bodies.scene_m3) * seen - np.log(ROTATION_VOLUME) * oriented
    log_odds = log_density - outside + np.log((1 - OUTLIER_SHARE_START) / OUTLIER_SHARE_START)
    dimensions = 3.0 * seen + 3.0 * oriented
    return Measured(T_ref_part, whitener, np.where(seen, log_odds, -np.inf), dimensions, np.ones((len(k), 2)))


@dataclass(frozen=True, eq=False)
class TreeResiduals:
    """Measured against model: turn (T, K, 3) [rad] along the reference's axes, and whitened (T, K, 6)."""

    turn: FloatArray
    whitened: FloatArray

    @property
    def chi2(self) -> FloatArray:
        """(T, K) squared lengths of the whitened residuals."""
        return np.einsum("tki,tki->tk", self.whitened, self.whitened)


def tree_residuals(measured: Measured, T_ref_part: FloatArray) -> TreeResiduals:
    """Residuals of model poses (T, K, 4, 4): p_meas - p_model and log(R_meas R_model^T), whitened.

    Along the reference's axes they are those of `pairwise.residuals`, turned by R_meas; the whitener knows of it.
    """
    R_model_t = np.ascontiguousarray(np.swapaxes(T_ref_part[..., :3, :3], -1, -2))
    turned = measured.T_ref_part[..., :3, :3] @ R_model_t
    e = np.empty((*turned.shape[:-2], 6))
    e[..., :3] = measured.T_ref_part[..., :3, 3] - T_ref_part[..., :3, 3]
    e[..., 3:] = entries_last(entrywise.log(np.moveaxis(turned, (-2, -1), (0, 1))), 1)
    return TreeResiduals(e[..., 3:], np.einsum("tkij,tkj->tki", measured.spread_whitener, e))


def part_jacobians(
    measured: Measured, residuals: TreeResiduals, T_ref_part: FloatArray, centre: FloatArray
) -> FloatArray:
    """(T, K, 6, 6) derivative of whitened residuals by twists of the parts about `centre` (T, 3).

    A twist [v, w] moves the position by v + w x p and turns R_model to exp(w) R_model: with phi the turn that is left,
    d phi = -Jr^-1(phi) w.
    """
    moved = np.zeros((*residuals.turn.shape[:-1], 6, 6))
    x, y, z = np.moveaxis(T_ref_part[..., :3, 3] - centre[:, None], -1, 0)
    moved[..., 0, 0] = moved[..., 1, 1] = moved[..., 2, 2] = -1.0
    moved[..., 0, 4], moved[..., 1, 5], moved[..., 2, 3] = -z, -x, -y
    moved[..., 0, 5], moved[..., 1, 3], moved[..., 2, 4] = y, z, x
    turn = np.ascontiguousarray(np.moveaxis(residuals.turn, -1, 0))
    moved[..., 3:, 3:] = entries_last(-entrywise.inverse_right_jacobian(turn), 2)
    return measured.spread_whitener @ moved


def better_ones(against_usual: FloatArray, seen: BoolArray) -> FloatArray:
    """(C,) of squared residuals (T, C), inf unseen, the one up to which are `BETTER_SHARE` of those seen; 0 if none."""
    at = BETTER_SHARE * np.maximum(seen.sum(axis=0) - 1, 0)  # of those in order
    rows = np.stack([np.floor(at), np.ceil(at)]).astype(np.intp)
    below, above = np.take_along_axis(np.sort(against_usual, axis=0), rows, axis=0)
    known = seen.any(axis=0)
    below, above = np.where(known, below, 0.0), np.where(known, above, 0.0)
    return np.asarray(below + (at - rows[0]) * (above - below), dtype=np.float64)
