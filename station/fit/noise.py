"""Noise of relative poses: propagated from known covariances or in unknown proportions, whitened, its scale estimated.

The covariance of a relative pose T_a_b is a sum of known shapes with unknown scales, Sigma_t = sum_s scale_s S_st:
- where covariances are given, one shape, S = Sigma_b + Ad Sigma_a Ad^T with Ad = Ad(T_b_a), and one scale, at least
  1: real poses have errors that their formal covariance doesn't know of, and none has fewer;
- else two, from unit variances of position and of orientation of either part. An orientation error of the parent moves
  the child by the distance between them, so the second has a translation part as well.
The scales are restricted maximum likelihood estimates: residuals within the states' directions carry no information.
"""

from __future__ import annotations

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
# Relative eigenvalue below which states are not told apart by what was measured (a ball's spin by its position).
RANK_ABOVE = 1e-9
# Degrees of freedom below which a scale keeps its value: nothing measures it.
LEAST_FREEDOMS = 1e-3


def chi2_median(freedoms: FloatArray) -> FloatArray:
    """Median of chi squared (Wilson and Hilferty, 1931); good to 1 % from three degrees of freedom."""
    k = np.maximum(freedoms, 1.0)
    return k * (1 - 2 / (9 * k)) ** 3


def inverse_cholesky(S: FloatArray) -> FloatArray:
    """(..., n, n) lower triangular W with W S W^T = I of symmetric positive definite S (..., n, n), n small.

    Loops over entries and not over matrices: for n = 6 that is ten times as fast as a library call for each matrix.
    """
    n = S.shape[-1]
    A = np.ascontiguousarray(np.moveaxis(S.reshape(-1, n, n), 0, -1))
    L, W = np.zeros_like(A), np.zeros_like(A)
    for j in range(n):
        diagonal = A[j, j] - np.einsum("kn,kn->n", L[j, :j], L[j, :j])
        W[j, j] = 1 / np.sqrt(diagonal)
        L[j, j] = diagonal * W[j, j]
        for i in range(j + 1, n):
            L[i, j] = (A[i, j] - np.einsum("kn,kn->n", L[i, :j], L[j, :j])) * W[j, j]
        for k in range(j):
            W[j, k] = -np.einsum("kn,kn->n", L[j, k:j], W[k:j, k]) * W[j, j]
    return np.moveaxis(W, -1, 0).reshape(S.shape)


@dataclass(frozen=True, eq=False)
class Noise:
    """Covariance of P pairs over T frames, up to scales.

    Attributes:
        shape: (P, T, 6, 6): the given covariance, or that of unit orientation errors.
        position: (P,) number of parts with unknown position errors, whose shape is the identity; None for given
            covariances.
        least: (S,) least scale of each variance, S = 1 if covariances are given, else 2 (position, orientation).
    """

    shape: FloatArray
    position: FloatArray | None
    least: FloatArray

    def take(self, pairs: NDArray[np.intp] | slice) -> Noise:
        """The noise of some of the pairs."""
        return Noise(self.shape[pairs], None if self.position is None else self.position[pairs], self.least)

    def covariance(self, scales: FloatArray) -> FloatArray:
        """(P, T, 6, 6) at scales (P, S)."""
        sigma = scales[:, -1, None, None, None] * self.shape
        if self.position is not None:
            variance = (scales[:, 0] * self.position)[:, None]
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

    def robust_scales(self, residual: FloatArray, seen: BoolArray, oriented: BoolArray) -> FloatArray:
        """Scales (P, S) from the medians of squared residuals (P, T, 6), to start with."""
        if self.position is None:
            W, _ = self.whitener(np.ones((len(seen), 1)), seen, oriented)
            chi2 = np.sum((W @ residual[..., None])[..., 0] ** 2, axis=-1)
            expected = chi2_median(3.0 * seen + 3.0 * oriented)
            return np.maximum(_median(chi2 / expected, seen)[:, None], self.least)
        one_axis = chi2_median(np.array(3.0))
        parts = np.maximum(self.position, 1.0)
        position = _median(np.sum(residual[..., :3] ** 2, axis=-1), seen) / (parts * one_axis)
        orientation = _median(np.sum(residual[..., 3:] ** 2, axis=-1), oriented) / (parts * one_axis)
        return np.maximum(np.stack([position, orientation], axis=-1), self.least)

    def updated_scales(
        self,
        scales: FloatArray,
        whitener: FloatArray,
        whitened: FloatArray,
        by_states: FloatArray,
        state_information: FloatArray,
        weights: FloatArray,
        parameters: int,
    ) -> FloatArray:
        """One multiplicative step (P, S) to the restricted likelihood's maximum.

        scale_s <- scale_s sum(w r^T M_s r) / sum(w tr(Q M_s)), with M_s = W S_s W^T, Q the projector that takes the
        states'
        directions out, and r = Q W e; the parameters take their share of the degrees of freedom. With two scales the
        shapes add up to the identity, scale_0 M_0 + scale_1 M_1 = I, and M_0 needs the first three columns of W only.

        Args:
            scales: (P, S).
            whitener: (P, T, 6, 6) at these scales.
            whitened: (P, T, 6) W e.
            by_states: (P, T, 6, s) whitened derivative by the states.
            state_information: (P, T, s, s) its Gram matrix.
            weights: (P, T).
            parameters: number of parameters of the joint.
        """
        unit = _orthonormal(by_states, state_information)
        r = whitened - (unit @ (np.swapaxes(unit, -1, -2) @ whitened[..., None]))[..., 0]
        measured = (whitener[..., range(6), range(6)] > 0).sum(axis=-1) - np.sum(unit**2, axis=(-2, -1))
        square = (weights * np.sum(r**2, axis=-1)).sum(axis=-1)
        freedoms = np.maximum((weights * measured).sum(axis=-1), 1.0)
        left = np.maximum(1 - parameters / freedoms, 1 / freedoms)
        if self.position is None:
            return np.maximum((scales[:, 0] * square / (freedoms * left))[:, None], self.least)
        columns = np.swapaxes(whitener[..., :3], -1, -2)
        ours = self.position * scales[:, 0]  # the share of position errors in numerator and denominator
        square_0 = ours * (weights * np.sum((columns @ r[..., None]) ** 2, axis=(-2, -1))).sum(axis=-1)
        trace = np.sum(columns**2, axis=(-2, -1)) - np.sum((columns @ unit) ** 2, axis=(-2, -1))
        freedoms_0 = ours * (weights * trace).sum(axis=-1)
        factors = np.stack(
            [_ratio(square_0, freedoms_0, left), _ratio(square - square_0, freedoms - freedoms_0, left)], -1
        )
        return np.maximum(scales * factors, self.least)


def _orthonormal(B: FloatArray, gram: FloatArray) -> FloatArray:
    """(..., 6, s) orthonormal columns that span those of B (..., 6, s); zero columns where they span less."""
    if B.shape[-1] == 0:
        return B
    if B.shape[-1] == 1:
        return B / np.sqrt(np.where(gram > 0, gram, 1.0))
    values, vectors = np.linalg.eigh(gram)
    told = values > RANK_ABOVE * values[..., -1:]
    return B @ (vectors * np.where(told, 1 / np.sqrt(np.where(told, values, 1.0)), 0.0)[..., None, :])


def _ratio(square: FloatArray, freedoms: FloatArray, left: FloatArray) -> FloatArray:
    """square / (freedoms left); 1 where there are no freedoms to tell."""
    told = freedoms > LEAST_FREEDOMS
    return np.where(told, np.maximum(square, 0.0) / np.where(told, freedoms * left, 1.0), 1.0)


def _median(values: FloatArray, seen: BoolArray) -> FloatArray:
    """(P,) medians over the seen frames of values (P, T); 1 without any."""
    ordered = np.sort(np.where(seen, values, np.inf), axis=-1)
    middle = np.maximum(seen.sum(axis=-1) - 1, 0) // 2
    found = np.take_along_axis(ordered, middle[:, None], axis=-1)[:, 0]
    return np.where(np.isfinite(found), found, 1.0)


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
    return Noise(relative_covariance(T_a_b, covariance_a, covariance_b), None, np.array([least]))


def unknown_noise(T_a_b: FloatArray, noisy_a: BoolArray, noisy_b: BoolArray) -> Noise:
    """Noise in unknown proportion of position and orientation; parts (P,) that are not noisy (a reference) add none."""
    unit = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    a, b = noisy_a.astype(np.float64), noisy_b.astype(np.float64)
    shape = relative_covariance(T_a_b, a[:, None, None, None] * unit, b[:, None, None, None] * unit)
    return Noise(shape, a + b, np.full(2, ROUNDING**2))
