"""Noise of relative poses: propagated from known covariances or in unknown proportions, and how slowly errors change.

The covariance of a relative pose T_a_b is a sum of known shapes with unknown scales, Sigma_t = sum_s scale_s S_st:
- where covariances are given, one shape, S = Sigma_b + Ad Sigma_a Ad^T with Ad = Ad(T_b_a), and one scale, at least
  1: real poses have errors that their formal covariance doesn't know of, and none has fewer;
- else two, from unit variances of position and of orientation of either part. An orientation error of the parent moves
  the child by the distance between them, so the second has a translation part as well.
`whitening` estimates the scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.kinematics import se3
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Standard deviations below this [m, rad] are rounding in files and arithmetic, not noise.
ROUNDING = 1e-6
# Given covariances are formal: real errors are at least as large.
LEAST_GIVEN_SCALE = 1.0
# Estimated covariances err to both sides; this only keeps an exact fit from dividing by zero.
LEAST_ESTIMATED_SCALE = 1e-4
# Probability of being no outlier above which a frame counts as an inlier.
INLIER_ABOVE = 0.5
# Correlations below this many of their own standard deviations are taken for none.
LOST_CORRELATION = 2.0


def chi2_median(freedoms: FloatArray) -> FloatArray:
    """Median of chi squared (Wilson and Hilferty, 1931); good to 1 % from three degrees of freedom."""
    k = np.maximum(freedoms, 1.0)
    return k * (1 - 2 / (9 * k)) ** 3


def inverse_cholesky(S: FloatArray) -> FloatArray:
    """(..., n, n) lower triangular W with W S W^T = I of symmetric positive definite S (..., n, n), n small."""
    entries = np.ascontiguousarray(np.moveaxis(S, (-2, -1), (0, 1)))
    return np.ascontiguousarray(np.moveaxis(lower_inverse(entries), (0, 1), (-2, -1)))


def lower_inverse(S: FloatArray) -> FloatArray:
    """(n, n, ...) `inverse_cholesky` of S (n, n, ...), of which the lower triangle is read.

    Loops over entries and not over matrices: for n = 6 that is ten times as fast as a library call for each matrix.
    """
    L, W = np.zeros(S.shape), np.zeros(S.shape)
    for j in range(len(S)):
        diagonal = S[j, j] - np.einsum("k...,k...->...", L[j, :j], L[j, :j])
        W[j, j] = 1 / np.sqrt(diagonal)
        L[j, j] = diagonal * W[j, j]
        for i in range(j + 1, len(S)):
            L[i, j] = (S[i, j] - np.einsum("k...,k...->...", L[i, :j], L[j, :j])) * W[j, j]
        for k in range(j):
            W[j, k] = -np.einsum("k...,k...->...", L[j, k:j], W[k:j, k]) * W[j, j]
    return W


@dataclass(frozen=True, eq=False)
class Noise:
    """Covariance of P pairs over T frames, up to scales.

    Attributes:
        shape: (P, T, 6, 6): the given covariance, or that of unit orientation errors.
        noisy: (2, P) 1 where the parent and the child have errors of unknown size, else 0; those of position have the
            identity for a shape. None for given covariances.
        least: (P, S) least scale of each variance, S = 1 if covariances are given, else 2 (position, orientation).
    """

    shape: FloatArray
    noisy: FloatArray | None
    least: FloatArray

    @property
    def position(self) -> FloatArray | None:
        """(P,) number of parts with errors of unknown size; None for given covariances."""
        return None if self.noisy is None else self.noisy.sum(axis=0)

    def take(self, pairs: NDArray[np.intp] | slice) -> Noise:
        """The noise of some of the pairs."""
        noisy = None if self.noisy is None else self.noisy[:, pairs]
        return Noise(self.shape[pairs], noisy, self.least[pairs])

    @staticmethod
    def all_of(noises: Sequence[Noise]) -> Noise:
        """The noise of pairs one after another; of all it is given, or of none."""
        known = [noise.noisy for noise in noises if noise.noisy is not None]
        shape, least = (np.concatenate(part) for part in zip(*((n.shape, n.least) for n in noises), strict=True))
        return Noise(shape, np.concatenate(known, axis=1) if known else None, least)

    def covariance(self, scales: FloatArray) -> FloatArray:
        """(P, T, 6, 6) at scales (P, S)."""
        sigma = scales[:, -1, None, None, None] * self.shape
        if self.noisy is not None:
            variance = (scales[:, 0] * self.noisy.sum(axis=0))[:, None]
            for i in range(3):
                sigma[..., i, i] += variance
        return sigma

    def whitener(self, scales: FloatArray, seen: BoolArray, oriented: BoolArray) -> tuple[FloatArray, FloatArray]:
        """W (P, T, 6, 6), W^T W = Sigma^-1, zero rows for what was not measured; and the log density at zero (P, T)."""
        sigma = self.covariance(scales)
        measured = np.concatenate([np.repeat(seen[..., None], 3, -1), np.repeat(oriented[..., None], 3, -1)], axis=-1)
        everything = bool(measured.all())
        if not everything:
            sigma = np.where(measured[..., :, None] & measured[..., None, :], sigma, np.eye(6))
        W = inverse_cholesky(sigma) * measured[..., :, None]
        diagonal = np.where(measured, np.diagonal(W, axis1=-2, axis2=-1), 1.0)
        log_density = np.log(diagonal).sum(axis=-1) - 0.5 * np.log(2 * np.pi) * measured.sum(axis=-1)
        return W, log_density


def time_of_correlation(whitened: FloatArray, good: BoolArray, dimensions: FloatArray) -> FloatArray:
    """(P,) frames that tell as much as one would if errors were independent from frame to frame; at least 1.

    tau = 1 + 2 sum_k rho_k over the lags until the correlation rho_k of the residuals is lost in its own noise.
    Trackers' errors change slowly with the view, so neighbouring frames repeat them.

    Args:
        whitened: (P, T, D) residuals.
        good: (P, T) frames that count.
        dimensions: (P,) numbers measured in a frame.
    """
    r = np.where(good[..., None], whitened, 0.0)
    frames = r.shape[1]
    length = 2 * frames  # zeros after the end: the transform is periodic
    power = np.sum(np.abs(np.fft.rfft(r, length, axis=1)) ** 2, axis=-1)
    products = np.fft.irfft(power, length, axis=1)[:, :frames]
    both = np.abs(np.fft.rfft(good.astype(np.float64), length, axis=1)) ** 2
    count = np.maximum(np.fft.irfft(both, length, axis=1)[:, :frames], 1.0)
    mean = products / count
    rho = np.asarray(mean / np.maximum(mean[:, :1], np.finfo(float).tiny), dtype=np.float64)
    lost = rho < LOST_CORRELATION / np.sqrt(np.maximum(count * dimensions[:, None], 1.0))
    before: BoolArray = np.cumsum(lost, axis=-1) == 0
    return 1 + 2 * np.sum(np.where(before, rho, 0.0)[:, 1:], axis=-1)


def relative_covariance(T_a_b: FloatArray, covariance_a: FloatArray, covariance_b: FloatArray) -> FloatArray:
    """(..., 6, 6) covariance of T_a_b = T_a^-1 T_b: to first order its right perturbation is xi_b - Ad(T_b_a) xi_a."""
    Ad = se3.adjoint(se3.inverse(T_a_b))
    return covariance_b + Ad @ covariance_a @ np.swapaxes(Ad, -1, -2)


def given_noise(T_a_b: FloatArray, covariance_a: FloatArray, covariance_b: FloatArray, least: float) -> Noise:
    """Noise of (P, T, 4, 4) relative poses from both parts' covariances (P, T, 6, 6); `least` scale of the sum."""
    return Noise(relative_covariance(T_a_b, covariance_a, covariance_b), None, np.full((len(T_a_b), 1), least))


def unknown_noise(T_a_b: FloatArray, noisy_a: BoolArray, noisy_b: BoolArray) -> Noise:
    """Noise in unknown proportion of position and orientation; parts (P,) that are not noisy (a reference) add none."""
    unit = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    a, b = noisy_a.astype(np.float64), noisy_b.astype(np.float64)
    shape = relative_covariance(T_a_b, a[:, None, None, None] * unit, b[:, None, None, None] * unit)
    return Noise(shape, np.stack([a, b]), np.full((len(T_a_b), 2), ROUNDING**2))
