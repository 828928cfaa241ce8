"""Which joint type explains a pair best: criteria that count the states of the frames, and probabilities.

A movable joint's state soaks up one direction of every frame's noise. Without a price for the states (paper, 24, with
6, 9 or 12 parameters) rigid is never chosen on noisy data. The default criterion, `evidence`, integrates each state
out:

    p(frame) = integral N(e(q); Sigma) N(q; mu, tau^2) dq
             = N(e(q^); Sigma) sqrt(2 pi) s_q N(q^; mu, s_q^2 + tau^2)          (Laplace: the model is straight over
             s_q)

with q^ the best state, s_q its deviation, and the mean and spread of the states their maximum likelihood estimates;
tau = 0 is the rigid joint, so the models nest. Parameters cost log(measured numbers) each (Schwarz), the states' two
included. The other criteria take the likelihood at the best states and count one parameter for each frame's state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.noise import INLIER_ABOVE, time_of_correlation
from station.fit.pairwise import JointFit, PairTracks, small_inverse
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Spread of the states over their noise below which motion is no motion: pose errors that change with the view look
# like it.
WOBBLE = 1.0
SPREAD_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores (P,) of each candidate type, -2 log scale, lower is better; that of nothing but outliers is 0.

    Attributes:
        criterion: how they were made.
        by_type: comparable within a pair; frames count by how many of them are independent there.
        weight: (P,) score of the likeliest type with every frame counted in full, comparable between pairs.
        surely_rigid: (P,) rigid is the likeliest type even if no error wobbles.
    """

    criterion: str
    by_type: Mapping[str, FloatArray]
    weight: FloatArray
    surely_rigid: BoolArray

    def best_type(self, pair: int) -> str:
        """Name of the likeliest type of one pair."""
        return min(self.by_type, key=lambda name: float(self.by_type[name][pair]))

    def probabilities(self, pair: int) -> dict[str, float]:
        """exp(-score / 2) of one pair, normalised over the candidates."""
        scores = np.array([self.by_type[name][pair] for name in self.by_type])
        odds = np.exp(-0.5 * (scores - scores.min()))
        return dict(zip(self.by_type, (odds / odds.sum()).tolist(), strict=True))


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
    def travel(self) -> FloatArray:
        """(P,) range of a uniform motion with the covariance's largest deviation."""
        return np.sqrt(12 * np.linalg.eigvalsh(self.covariance)[..., -1])


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
        G = _shrunk(spread, information)  # precision of a frame about the mean, (C + Lambda^-1)^-1
        wG = weights[..., None, None] * G
        mean = (small_inverse(wG.sum(axis=1)) @ (wG @ q[..., None]).sum(axis=1))[..., 0]
        u = (G @ (q - mean[:, None])[..., None])[..., 0]
        change = np.einsum("pt,ptij->pij", weights, u[..., :, None] * u[..., None, :] - G)
        spread = _scored(spread, change, wG.sum(axis=1), np.einsum("ptij,ptji->p", wG, G), total[..., None])
    return Spread(mean, spread)


def _shrunk(C: FloatArray, information: FloatArray) -> FloatArray:
    """(P, T, s, s) (C + Lambda^-1)^-1 of C (P, s, s) and Lambda (P, T, s, s), which may be singular."""
    if information.shape[-1] == 1:
        return information / (1 + C[:, None] * information)
    return np.asarray(np.linalg.solve(np.eye(C.shape[-1]) + information @ C[:, None], information), dtype=np.float64)


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


def _total(fit: JointFit, tracks: PairTracks, log_inside: FloatArray) -> FloatArray:
    """(P,) -2 log likelihood of all frames less that of all outliers."""
    share = fit.model.outlier_share[:, None]
    inside = np.log1p(-share) + log_inside - tracks.log_outlier_density
    return -2 * (tracks.seen * np.logaddexp(inside, np.log(share))).sum(axis=-1)


def _parameters(fit: JointFit, tracks: PairTracks) -> FloatArray:
    """(P,) honest parameters: by how many frames tell an orientation."""
    oriented = tracks.oriented.sum(axis=-1) > fit.joint.parameters
    return np.where(oriented, fit.joint.parameters, fit.joint.position_parameters).astype(np.float64)


@dataclass(frozen=True, eq=False)
class _Integrated:
    """-2 log likelihoods (P,) of one type with its states integrated out.

    `wobbling` is that of a rigid joint whose errors wobble along the type's motion; `travel` a uniform motion's of
    this spread.
    """

    moving: FloatArray
    wobbling: FloatArray
    parameters: FloatArray
    travel: FloatArray


def _integrated(fit: JointFit, tracks: PairTracks) -> _Integrated:
    profile = fit.log_density - 0.5 * fit.chi2
    parameters = _parameters(fit, tracks)
    s = fit.joint.states
    if not s:
        total = _total(fit, tracks, profile)
        return _Integrated(total, total, parameters, np.zeros(len(total)))
    q, information = continuous_states(fit), fit.state_information
    spread = spread_of(q, information, fit.inlier)
    d = q - spread.mean[:, None]

    def marginal(C: FloatArray) -> FloatArray:
        G = _shrunk(C, information)
        chi2 = np.einsum("pti,ptij,ptj->pt", d, G, d)
        return profile - 0.5 * _log_det(np.eye(s) + information @ C[:, None]) - 0.5 * chi2

    moving = _total(fit, tracks, marginal(spread.covariance))
    wobbling = _total(fit, tracks, marginal(_wobble(spread.covariance, information, fit.inlier)))
    return _Integrated(moving, wobbling, parameters + s + 0.5 * s * (s + 1), spread.travel)


def _log_det(S: FloatArray) -> FloatArray:
    return np.log(S[..., 0, 0]) if S.shape[-1] == 1 else np.linalg.slogdet(S)[1]


def _wobble(C: FloatArray, information: FloatArray, weights: FloatArray) -> FloatArray:
    """(P, s, s) spread C, along each of its principal directions at most `WOBBLE` of the states' usual noise."""
    total = np.maximum(weights.sum(axis=-1), 1.0)[:, None, None]
    mean = np.einsum("pt,ptij->pij", weights, information) / total
    values, vectors = np.linalg.eigh(C)
    typical = np.einsum("pji,pjk,pki->pi", vectors, mean, vectors)
    most = WOBBLE**2 / np.maximum(typical, np.finfo(float).tiny)
    return (vectors * np.minimum(values, most)[:, None, :]) @ np.swapaxes(vectors, -1, -2)


def _evidence(fits: Mapping[str, JointFit], tracks: PairTracks) -> Scores:
    found = {name: _integrated(fit, tracks) for name, fit in fits.items()}
    moving = {name: each.moving for name, each in found.items()}
    for name, fit in fits.items():
        limit = fit.joint.limit
        if limit in moving:
            same = fit.joint.is_degenerate(fit.model.frames, found[name].travel)
            moving[limit] = np.where(same, np.fmin(moving[limit], found[name].moving), moving[limit])
    plain = moving.get("rigid")
    if plain is not None:
        moving["rigid"] = np.min(np.stack([each.wobbling for each in found.values()]), axis=0)
    time = correlation_time(fits, tracks, moving)
    measured = np.log(np.maximum(tracks.dimensions.sum(axis=-1) / time, 2.0))
    scores = {name: total / time + found[name].parameters * measured for name, total in moving.items()}
    full = {name: total + found[name].parameters * measured for name, total in moving.items()}
    surely = np.zeros(len(measured), dtype=bool)
    if plain is not None:
        without = plain / time + found["rigid"].parameters * measured
        surely = without <= np.min(np.stack([scores[name] for name in scores if name != "rigid"] or [without]), axis=0)
    return Scores("evidence", scores, _at_least(scores, full), surely)


def _at_least(scores: Mapping[str, FloatArray], values: Mapping[str, FloatArray]) -> FloatArray:
    """(P,) of `values` for the type with the lowest score."""
    best = np.argmin(np.stack([scores[name] for name in scores]), axis=0)
    return np.take_along_axis(np.stack([values[name] for name in scores]), best[None], axis=0)[0]


def correlation_time(fits: Mapping[str, JointFit], tracks: PairTracks, totals: Mapping[str, FloatArray]) -> FloatArray:
    """(P,) `time_of_correlation` of each pair's likeliest type; taken for independent errors make any type certain."""
    names = list(fits)
    best = np.argmin(np.stack([totals[name] for name in names]), axis=0)
    time = np.ones(len(best))
    for i, name in enumerate(names):  # types are few
        rows = np.flatnonzero(best == i)
        if rows.size:
            time[rows] = _correlation_time(fits[name].take(rows), tracks.take(rows))
    return time


def _correlation_time(fit: JointFit, tracks: PairTracks) -> FloatArray:
    whitener, _ = tracks.noise.whitener(fit.model.scales, tracks.seen, tracks.oriented)
    r = (whitener @ fit.residual[..., None])[..., 0]
    return time_of_correlation(r, fit.inlier > INLIER_ABOVE, tracks.dimensions.max(axis=-1))


def _counted(price: Callable[[FloatArray, FloatArray], FloatArray]) -> Callable[[JointFit, PairTracks], FloatArray]:
    def score(fit: JointFit, tracks: PairTracks) -> FloatArray:
        parameters = _parameters(fit, tracks) + fit.joint.states * fit.inlier.sum(axis=-1)
        measured = (tracks.dimensions * fit.inlier).sum(axis=-1)
        return _total(fit, tracks, fit.log_density - 0.5 * fit.chi2) + price(parameters, measured)

    return score


def _corrected(k: FloatArray, n: FloatArray) -> FloatArray:
    """AICc's price; infinite where there are not more numbers than parameters."""
    return np.where(n - k > 1, 2 * k + 2 * k * (k + 1) / np.where(n - k > 1, n - k - 1, 1.0), np.inf)


COUNTING = {
    "bic": _counted(lambda k, n: k * np.log(np.maximum(n, 2.0))),
    "aic": _counted(lambda k, _: 2 * k),
    "aicc": _counted(_corrected),
}
CRITERIA = ("evidence", *COUNTING)


def check_criterion(name: str) -> None:
    """Raise InvalidData for a criterion that isn't there, with the choices."""
    if name not in CRITERIA:
        raise InvalidData(f"criterion '{name}' is unknown; choose one of {', '.join(CRITERIA)}")


def score_fits(fits: Mapping[str, JointFit], tracks: PairTracks, criterion: str) -> Scores:
    """Score every fitted type on P pairs."""
    check_criterion(criterion)
    if criterion != "evidence":
        scores = {name: COUNTING[criterion](fit, tracks) for name, fit in fits.items()}
        best = np.min(np.stack(list(scores.values())), axis=0)
        surely = np.equal(scores["rigid"], best) if "rigid" in scores else np.zeros(len(best), dtype=bool)
        return Scores(criterion, scores, _at_least(scores, scores), surely)
    return _evidence(fits, tracks)
