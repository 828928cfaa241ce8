"""The evidence of a joint type: its likelihood with the states of the frames integrated out, and what that is worth.

A movable joint's state soaks up one direction of every frame's noise. Without a price for the states (paper, 24) rigid
is never chosen on noisy data. Here each state is integrated out:

    p(frame) = integral N(e(q); Sigma) N(q; mu, C) dq
             = N(e(q^); Sigma) N(q^; mu, C + S) / N(0; 0, S)          (Laplace: the model is straight over S)

with q^ the best state, S its covariance, and the mean and spread C of the states their maximum likelihood estimates;
C = 0 is the rigid joint, so the models nest. The joint's own numbers, the mean and the spread are integrated out
likewise: with priors of deviations D (`priors`) and the information H of the data, they cost log det(1 + D H D). What
the data don't tell costs nothing, and the same numbers cost the same whatever type has them. (Schwarz's price, the
logarithm of what was measured for each, takes data to tell all of them alike: a hinge that turned by a degree would be
called a slide for sure.) Frames count by how many of them are independent, and what errors of trackers fake is shared
out (`lookalikes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.lookalikes import Seen, shared
from station.fit.noise import INLIER_ABOVE, time_of_correlation
from station.fit.pairwise import JointFit, PairTracks
from station.fit.priors import LESSER_TURN_RAD, RANGE, TURN_STD_RAD, mean_deviation, number_deviations, size_price
from station.fit.state_spread import continuous_states, marginal_information, spread_of, spread_over_noise
from station.kinematics.joints import JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Of P pairs.

    Attributes:
        scores: (P,) -2 log evidence of each type, lower is better.
        in_full: (P,) the same with every frame counted in full.
        misfit: (P,) by how much that is worse than a joint of the same motion would do with the noise that its parts
            are known to have: comparable between pairs, of which one may have an exact parent. Where the noise is not
            known, the score in full itself.
        surely_rigid: (P,) rigid is the likeliest type even if no error wobbles.
        time: (P,) frames that repeat an error.
    """

    scores: Mapping[str, FloatArray]
    in_full: Mapping[str, FloatArray]
    misfit: Mapping[str, FloatArray]
    surely_rigid: BoolArray
    time: FloatArray


def evidence(fits: Mapping[str, JointFit], tracks: PairTracks) -> Evidence:
    """Evidence of every fitted type."""
    found = {name: _integrated(fit, tracks) for name, fit in fits.items()}
    order = sorted(found, key=lambda name: -_numbers(fits[name].joint))
    seen = {name: found[name].seen for name in order}
    time = correlation_time(fits, tracks, {name: each.total for name, each in found.items()})
    price = {name: _price(each, tracks.lab_m, time) for name, each in found.items()}
    plain = {name: each.total / time + price[name] for name, each in found.items()}

    def with_lookalikes(scores: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        real = shared({name: -0.5 * scores[name] for name in order}, seen, tracks, time)
        return {name: -2 * real[name] for name in fits}

    surely = np.zeros(len(time), dtype=bool)
    if "rigid" in plain:
        surely = plain["rigid"] <= np.min(np.stack(list(plain.values())), axis=0)
    full = with_lookalikes({name: each.total + price[name] for name, each in found.items()})
    return Evidence(with_lookalikes(plain), full, _misfit(full, found, tracks), surely, time)


def _misfit(
    full: Mapping[str, FloatArray], found: Mapping[str, _Integrated], tracks: PairTracks
) -> Mapping[str, FloatArray]:
    """Frames that a joint leaves out as outliers are charged all that they would have told: a joint that explains the
    frames at rest alone, and leaves out the motion, would fit best of all otherwise.
    """
    if tracks.noise.noisy is not None:
        return full
    _, log_density = tracks.noise.whitener(np.ones((len(tracks.seen), 1)), tracks.seen, tracks.oriented)
    log_density = log_density - tracks.log_outlier_density
    misfit: dict[str, FloatArray] = {}
    for name, each in found.items():
        fit = each.seen.fit
        of_frame = log_density - 0.5 * np.maximum(tracks.dimensions - fit.joint.states, 0.0)
        misfit[name] = full[name] + 2 * np.sum(tracks.seen * of_frame, axis=-1) - each.by_motion
    return misfit


@dataclass(frozen=True, eq=False)
class _Integrated:
    """One type with its states integrated out: -2 log likelihood (P,), the states' spread, what tells it and its mean.

    Attributes:
        total: (P,) -2 log likelihood.
        by_motion: (P,) what of it is for the states' spread beyond their noise.
        seen: the fit and the spread.
        of_mean: (P, s, s) information of the states' mean.
        variances: (P, s) of the spread along its principal directions, rising.
        of_variances: (P, s) information of these.
        of_turns: (P, s (s - 1) / 2) information of turns of the spread's principal directions into each other.
    """

    total: FloatArray
    by_motion: FloatArray
    seen: Seen
    of_mean: FloatArray
    variances: FloatArray
    of_variances: FloatArray
    of_turns: FloatArray


def _integrated(fit: JointFit, tracks: PairTracks) -> _Integrated:
    profile = fit.log_density - 0.5 * fit.chi2
    s = fit.joint.states
    q, information = continuous_states(fit), fit.state_information
    spread = spread_of(q, information, fit.inlier)
    G, by_motion = marginal_information(spread.covariance, information), np.zeros_like(profile)
    if s:
        d = q - spread.mean[:, None]
        by_motion = _log_det(np.eye(s) + information @ spread.covariance[:, None])
        profile = profile - 0.5 * by_motion - 0.5 * np.einsum("pti,ptij,ptj->pt", d, G, d)
    over_noise = spread_over_noise(spread, information, fit.inlier) if s else np.zeros(len(q))
    values, vectors = np.linalg.eigh(spread.covariance)
    along = np.maximum(np.einsum("pji,ptjk,pki->pti", vectors, G, vectors), 0.0)
    i, j = np.triu_indices(s, k=1)
    both = np.einsum("pt,pti,pti->pi", fit.inlier, along[..., i], along[..., j])
    return _Integrated(
        total_of(fit, tracks, profile),
        np.sum(fit.inlier * by_motion, axis=-1),
        Seen(fit, spread, over_noise),
        np.einsum("pt,ptij->pij", fit.inlier, G),
        values,
        0.5 * np.einsum("pt,pti->pi", fit.inlier, along**2),
        (values[:, i] - values[:, j]) ** 2 * both,
    )


def _price(found: _Integrated, lab_m: float, time: FloatArray) -> FloatArray:
    """(P,) -2 log of the share that the data leave of what was possible before, for frames that repeat errors."""
    fit = found.seen.fit
    before = number_deviations(fit.joint, lab_m)
    numbers = fit.information * np.outer(before, before) / time[:, None, None]
    mean = found.of_mean * mean_deviation(fit.joint, lab_m) ** 2 / time[:, None, None]
    turns = np.log1p(found.of_turns * TURN_STD_RAD**2 / time[:, None]).sum(axis=-1)
    of_states = _log_det_1(mean) + _spread_price(found, time) + turns
    return _log_det_1(numbers) + of_states + size_price(fit, lab_m, time) - 2 * np.log(fit.joint.usual)


def _spread_price(found: _Integrated, time: FloatArray) -> FloatArray:
    """(P,) that of the spread's deviations: of the largest by its logarithm, any size being as likely as any other; of
    the lesser ones, which a ball has, by their size.
    """
    v, of_v = found.variances, found.of_variances / time[:, None]
    largest = np.log1p(4 * v[:, -1:] ** 2 * of_v[:, -1:] * RANGE**2 / (2 * np.pi)).sum(axis=-1)
    v, of_v = v[:, :-1], of_v[:, :-1]
    told = LESSER_TURN_RAD**2 * (4 * v * of_v + np.sqrt(of_v))  # a deviation near none is told by its square
    return largest + np.sum(np.log1p(told) + v / LESSER_TURN_RAD**2, axis=-1)


def _log_det_1(S: FloatArray) -> FloatArray:
    """(P,) log det(1 + S) of symmetric positive semidefinite S (P, n, n)."""
    return np.log1p(np.maximum(np.linalg.eigvalsh(S), 0.0)).sum(axis=-1) if S.shape[-1] else np.zeros(len(S))


def _numbers(joint: JointType) -> int:
    return joint.parameters + joint.states + joint.states * (joint.states + 1) // 2


def _log_det(S: FloatArray) -> FloatArray:
    return np.log(S[..., 0, 0]) if S.shape[-1] == 1 else np.linalg.slogdet(S)[1]


def total_of(fit: JointFit, tracks: PairTracks, log_inside: FloatArray) -> FloatArray:
    """(P,) -2 log likelihood of all frames less that of all outliers, from inliers' log density (P, T)."""
    share = fit.model.outlier_share[:, None]
    inside = np.log1p(-share) + log_inside - tracks.log_outlier_density
    return -2 * (tracks.seen * np.logaddexp(inside, np.log(share))).sum(axis=-1)


def geometry_parameters(fit: JointFit, tracks: PairTracks) -> FloatArray:
    """(P,) honest parameters: by how many frames tell an orientation."""
    oriented = tracks.oriented.sum(axis=-1) > fit.joint.parameters
    return np.where(oriented, fit.joint.parameters, fit.joint.position_parameters).astype(np.float64)


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
