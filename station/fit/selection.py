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
from station.fit.pairwise import JointFit, PairTracks
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
    """(P, T) states without jumps of 2 pi from inlier to inlier; other frames take the branch of the one before."""
    q = fit.model.q
    if fit.joint.unit != "rad":
        return q
    good = fit.inlier > inlier_above
    count = np.cumsum(good, axis=-1)  # good frames so far; before the first, the first
    order = np.argsort(~good, axis=-1, kind="stable")
    last = np.take_along_axis(order, np.maximum(count - 1, 0), axis=-1)
    smooth = np.unwrap(np.take_along_axis(q, last, axis=-1), axis=-1)
    return smooth + np.arctan2(np.sin(q - smooth), np.cos(q - smooth))


def _spread(q: FloatArray, variance: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and variance tau^2 (P,) of states q (P, T) beyond their own variance (P, T), by scoring the likelihood."""
    total = np.maximum(weights.sum(axis=-1), 1.0)
    mean = (weights * q).sum(axis=-1) / total
    tau2 = np.maximum((weights * ((q - mean[:, None]) ** 2 - variance)).sum(axis=-1) / total, 0.0)
    for _ in range(SPREAD_ROUNDS):  # each round weighs by the last spread
        precision = weights / (variance + tau2[:, None])
        mean = (precision * q).sum(axis=-1) / np.maximum(precision.sum(axis=-1), np.finfo(float).tiny)
        excess = (q - mean[:, None]) ** 2 - variance
        information = precision / (variance + tau2[:, None])
        tau2 = (information * excess).sum(axis=-1) / np.maximum(information.sum(axis=-1), np.finfo(float).tiny)
        tau2 = np.maximum(tau2, 0.0)
    return mean, tau2


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
    if not fit.joint.states:
        total = _total(fit, tracks, profile)
        return _Integrated(total, total, parameters, np.zeros(len(total)))
    known = fit.state_information > 0
    variance = np.where(known, 1 / np.where(known, fit.state_information, 1.0), 1.0)
    q = continuous_states(fit)
    mean, tau2 = _spread(q, variance, fit.inlier)
    weight = fit.inlier / np.maximum(fit.inlier.sum(axis=-1, keepdims=True), 1.0)
    typical = 1 / np.maximum((weight / variance).sum(axis=-1), np.finfo(float).tiny)

    def marginal(spread: FloatArray) -> FloatArray:
        both = variance + spread[:, None]
        return profile + 0.5 * np.log(variance / both) - 0.5 * (q - mean[:, None]) ** 2 / both

    moving = _total(fit, tracks, marginal(tau2))
    wobbling = _total(fit, tracks, marginal(np.minimum(tau2, WOBBLE**2 * typical)))
    return _Integrated(moving, wobbling, parameters + 2.0 * fit.joint.states, np.sqrt(12 * tau2))


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
