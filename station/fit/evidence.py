"""The evidence of a joint type: its likelihood with the states of the frames integrated out, and what that is worth.

A movable joint's state soaks up one direction of every frame's noise. Without a price for the states (paper, 24) rigid
is never chosen on noisy data. Here each state is integrated out:

    p(frame) = integral N(e(q); Sigma) N(q; mu, C) dq
             = N(e(q^); Sigma) N(q^; mu, C + S) / N(0; 0, S)          (Laplace: the model is straight over S)

with q^ the best state, S its covariance, and the mean and spread C of the states their maximum likelihood estimates;
C = 0 is the rigid joint, so the models nest. The mean and the spread are parameters too, and each parameter costs
log(numbers measured) (Schwarz), with frames counted by how many of them are independent. Arms and pitches have priors,
and what errors of trackers fake is shared out (`lookalikes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.lookalikes import Seen, shared, size_price
from station.fit.noise import INLIER_ABOVE, time_of_correlation
from station.fit.pairwise import JointFit, PairTracks
from station.fit.state_spread import continuous_states, marginal_information, spread_of, spread_over_noise
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Of P pairs.

    Attributes:
        scores: (P,) -2 log evidence of each type, lower is better.
        in_full: (P,) the same with every frame counted in full, comparable between pairs.
        surely_rigid: (P,) rigid is the likeliest type even if no error wobbles.
        time: (P,) frames that repeat an error.
    """

    scores: Mapping[str, FloatArray]
    in_full: Mapping[str, FloatArray]
    surely_rigid: BoolArray
    time: FloatArray


def evidence(fits: Mapping[str, JointFit], tracks: PairTracks) -> Evidence:
    """Evidence of every fitted type."""
    found = {name: _integrated(fit, tracks) for name, fit in fits.items()}
    order = sorted(found, key=lambda name: -found[name].joint_parameters)
    seen = {name: found[name].seen for name in order}
    time = correlation_time(fits, tracks, {name: each.total for name, each in found.items()})
    measured = np.log(np.maximum(tracks.dimensions.sum(axis=-1) / time, 2.0))
    price = {name: each.parameters * measured + size_price(fits[name], tracks.lab_m) for name, each in found.items()}
    plain = {name: each.total / time + price[name] for name, each in found.items()}

    def with_lookalikes(scores: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        real = shared({name: -0.5 * scores[name] for name in order}, seen, tracks)
        return {name: -2 * real[name] for name in fits}

    surely = np.zeros(len(time), dtype=bool)
    if "rigid" in plain:
        surely = plain["rigid"] <= np.min(np.stack(list(plain.values())), axis=0)
    full = {name: each.total + price[name] for name, each in found.items()}
    return Evidence(with_lookalikes(plain), with_lookalikes(full), surely, time)


@dataclass(frozen=True, eq=False)
class _Integrated:
    """One type with its states integrated out: -2 log likelihood (P,), parameters (P,), the states' spread."""

    total: FloatArray
    parameters: FloatArray
    joint_parameters: int
    seen: Seen


def _integrated(fit: JointFit, tracks: PairTracks) -> _Integrated:
    profile = fit.log_density - 0.5 * fit.chi2
    s = fit.joint.states
    q, information = continuous_states(fit), fit.state_information
    spread = spread_of(q, information, fit.inlier)
    if s:
        d = q - spread.mean[:, None]
        G = marginal_information(spread.covariance, information)
        chi2 = np.einsum("pti,ptij,ptj->pt", d, G, d)
        profile = profile - 0.5 * _log_det(np.eye(s) + information @ spread.covariance[:, None]) - 0.5 * chi2
    over_noise = spread_over_noise(spread, information, fit.inlier) if s else np.zeros(len(q))
    numbers = s + s * (s + 1) // 2
    return _Integrated(
        total_of(fit, tracks, profile),
        geometry_parameters(fit, tracks) + numbers,
        fit.joint.parameters + numbers,
        Seen(fit, spread, over_noise),
    )


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
