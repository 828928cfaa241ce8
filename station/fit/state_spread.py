"""States over the frames of a pair: without jumps of a full turn, and how far they spread beyond their own noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.pairwise import JointFit, small_inverse
from station.logs import FloatArray

SPREAD_ROUNDS = 8


def continuous_states(fit: JointFit, *, inlier_above: float = 0.5) -> FloatArray:
    """(P, T, s) states without jumps of a full turn from inlier to inlier; other frames take the branch of the one
    before.
    """
    q = fit.model.q
    good = fit.inlier > inlier_above
    count = np.cumsum(good, axis=-1)  # good frames so far; before the first, the first
    order = np.argsort(~good, axis=-1, kind="stable")
    last = np.take_along_axis(order, np.maximum(count - 1, 0), axis=-1)[..., None]
    smooth = fit.joint.continuous(np.take_along_axis(q, last, axis=-2))
    return np.where(good[..., None], smooth, fit.joint.nearest_turn(q, smooth))


@dataclass(frozen=True, eq=False)
class Spread:
    """Gaussian spread of states over the frames: mean (P, s), covariance (P, s, s)."""

    mean: FloatArray
    covariance: FloatArray

    @property
    def deviations(self) -> FloatArray:
        """(P, s) along the principal directions, rising."""
        return np.sqrt(np.maximum(np.linalg.eigvalsh(self.covariance), 0.0))

    @property
    def travel(self) -> FloatArray:
        """(P,) range of a uniform motion with the covariance's largest deviation."""
        return np.sqrt(12) * self.deviations[..., -1]


def spread_of(q: FloatArray, information: FloatArray, weights: FloatArray) -> Spread:
    """Maximum likelihood spread of states q (P, T, s) beyond their own noise.

    q_t ~ N(mean, C + Lambda_t^-1), by scoring started from the moments; Lambda_t may be singular.

    Args:
        q: (P, T, s).
        information: (P, T, s, s) Lambda.
        weights: (P, T).
    """
    total = np.maximum(weights.sum(axis=-1), 1.0)[:, None]
    mean = np.einsum("pt,pti->pi", weights, q) / total
    d = q - mean[:, None]
    variance = small_inverse(information)
    spread = _positive(
        np.einsum("pt,ptij->pij", weights, d[..., :, None] * d[..., None, :] - variance) / total[..., None]
    )
    for _ in range(SPREAD_ROUNDS):  # each round weighs by the last spread
        G = marginal_information(spread, information)  # precision of a frame about the mean
        wG = weights[..., None, None] * G
        mean = (small_inverse(wG.sum(axis=1)) @ (wG @ q[..., None]).sum(axis=1))[..., 0]
        u = (G @ (q - mean[:, None])[..., None])[..., 0]
        change = np.einsum("pt,ptij->pij", weights, u[..., :, None] * u[..., None, :] - G)
        spread = _scored(spread, change, wG.sum(axis=1), np.einsum("ptij,ptji->p", wG, G), total[..., None])
    return Spread(mean, spread)


def marginal_information(C: FloatArray, information: FloatArray) -> FloatArray:
    """(P, T, s, s) (C + Lambda^-1)^-1 of C (P, s, s) and Lambda (P, T, s, s), which may be singular."""
    if information.shape[-1] == 1:
        return information / (1 + C[:, None] * information)
    return np.asarray(np.linalg.solve(np.eye(C.shape[-1]) + information @ C[:, None], information), dtype=np.float64)


def spread_over_noise(spread: Spread, information: FloatArray, weights: FloatArray) -> FloatArray:
    """(P,) the largest deviation along a principal direction of the spread over the states' usual noise there."""
    total = np.maximum(weights.sum(axis=-1), 1.0)[:, None, None]
    mean = np.einsum("pt,ptij->pij", weights, information) / total
    values, vectors = np.linalg.eigh(spread.covariance)
    typical = np.einsum("pji,pjk,pki->pi", vectors, mean, vectors)
    return np.sqrt(np.maximum(values * typical, 0.0)).max(axis=-1)


def _scored(C: FloatArray, change: FloatArray, G: FloatArray, square: FloatArray, total: FloatArray) -> FloatArray:
    """One step of scoring: C + inverse(G) change inverse(G), by sums over frames, no longer than a Newton step."""
    mean = G / total
    size = np.einsum("pij,pji->p", mean, mean) / np.maximum(square / total[:, 0, 0], np.finfo(float).tiny)
    inverse = small_inverse(mean)
    return _positive(C + np.minimum(size, 1.0)[:, None, None] * (inverse @ (change / total) @ inverse))


def _positive(C: FloatArray) -> FloatArray:
    """The nearest positive semidefinite matrix to symmetric C (P, s, s)."""
    if C.shape[-1] <= 1:
        return np.maximum(C, 0.0)
    values, vectors = np.linalg.eigh(0.5 * (C + np.swapaxes(C, -1, -2)))
    return (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
