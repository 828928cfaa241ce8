"""Tests for one more way to be wrong: at all times, from some time on, or in proportion to time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincc, gammaln

from station.fit.image_checks.abruptness import LEAST_TICKS, is_abrupt
from station.fit.image_checks.sums import Sums
from station.logs import FloatArray

# Directions that a fit can do by itself, as a share of the best known one.
REDUNDANT = 1e-10
# What is known less well than this, m or rad, px, or as a share, isn't known: to it all is linear.
LEAST_KNOWN = {"twist": (0.02, 0.02, 0.02, 0.2, 0.2, 0.2), "number": (1.0,)}
# Directions that have less information than this share of the best known one are left out: sizes are of what is seen.
FAINT = 1e-4
# Blocks of time between which the noise is looked at, and how many ticks one has at least.
BLOCKS, BLOCK_TICKS = 24, 6


@dataclass(frozen=True, eq=False)
class Effect:
    """What a test found of one way to be wrong.

    Attributes:
        what: its name in `Sums.columns`.
        profile: (n,) over the ticks, by which it goes.
        size: (d,) its numbers.
        covariance: (d, d) of these, by the noise seen.
        information: (d, d) of these, in units of the covariances stated.
        gain: by how much twice the log likelihood grows, in units of the noise seen.
        explained: what of the squared residuals, in units of the covariances stated.
        log_p: logarithm of the chance of as much by chance.
        directions: that are known; 0 if nothing is.
        noise: variance between blocks of time over what the covariances say, at least 1.
        freedom: degrees of freedom that it is known from.
        times: (n,) chance of a change at the beginning of each tick; empty without.
        gap_s: (n,) times of the last frame before each tick, and of its first.
    """

    what: str
    profile: FloatArray
    size: FloatArray
    covariance: FloatArray
    information: FloatArray
    gain: float
    explained: float
    log_p: float
    directions: int
    noise: float
    freedom: float
    times: FloatArray
    gap_s: tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class _Known:
    """Eigenvalues (..., d) and -vectors (..., d, d) of informations in scaled units, and which count."""

    scale: FloatArray
    values: FloatArray
    vectors: FloatArray
    counts: FloatArray

    def inverse(self) -> FloatArray:
        """(..., d, d) covariances; along what isn't known, that of what is assumed before."""
        spread = np.where(self.counts, 1.0 / np.where(self.counts, self.values, 1.0), 1.0)
        half = self.vectors * np.sqrt(spread)[..., None, :] * self.scale[:, None]
        return half @ np.swapaxes(half, -1, -2)

    def pseudo_inverse(self) -> FloatArray:
        """(..., d, d) covariances; nothing along what isn't known."""
        spread = np.where(self.counts, 1.0 / np.where(self.counts, self.values, 1.0), 0.0)
        half = self.vectors * np.sqrt(spread)[..., None, :] * self.scale[:, None]
        return half @ np.swapaxes(half, -1, -2)


def _known(information: FloatArray, least: float = 1.0) -> _Known:
    d = information.shape[-1]
    scale = np.array(LEAST_KNOWN["twist"] if d == 6 else LEAST_KNOWN["number"] * d)
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
    best = values.max(axis=-1, keepdims=True)
    return _Known(scale, values, vectors, values > np.maximum(least, FAINT * best))


def taken_out(PP: FloatArray) -> FloatArray:
    """(P, r) root of the pseudo-inverse of the information about what a fit can do."""
    size = np.sqrt(np.einsum("ii->i", PP))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(PP / size[:, None] / size)
    kept = values > REDUNDANT * values.max(initial=0.0)
    return vectors[:, kept] / np.sqrt(values[kept]) / size[:, None]


@dataclass(frozen=True, eq=False)
class _Scan:
    """Information (m, d, d) and scores (m, d) by profile, after what a fit can do, and their gain (m,)."""

    information: FloatArray
    known: _Known
    score: FloatArray
    gain: FloatArray


def _scan(A: FloatArray, B: FloatArray, g: FloatArray, root: FloatArray, Pr: FloatArray) -> _Scan:
    BR = B @ root
    score = g - BR @ (root.T @ Pr)
    information = A - BR @ np.swapaxes(BR, -1, -2)
    known = _known(information)
    along = np.einsum("...ij,...i->...j", known.vectors, known.scale * score)
    gain = np.sum(np.where(known.counts, along**2 / np.where(known.counts, known.values, 1.0), 0.0), axis=-1)
    return _Scan(information, known, score, gain)


def detector_noise(sums: Sums, what: str, profile: FloatArray) -> float:
    """Variance of a gain by what detectors' own errors make of a change over time (n,), in that of corners' noise.

    An error of each coordinate that goes by the profile, each marker's by itself.
    """
    c = sums.columns[what]
    involved = np.einsum("tii->t", sums.DD[:, c, c]) > 0
    kind, _, number = what.partition(" ")
    of = sums.detector[:, int(number)][:, None] if kind == "marker" else sums.detector
    seen = np.flatnonzero(of.sum(axis=0) > 0)
    of, w = of[involved][:, seen], profile[involved, None]
    total: FloatArray = of.sum(axis=0)
    spread: FloatArray = np.sum(of * w**2, axis=0) - np.sum(of * w, axis=0) ** 2 / total
    return float(spread.sum()) / len(seen) if len(seen) else 0.0


def step_effect(sums: Sums, what: str) -> Effect:
    """The likeliest change from some time on; by chance, if it isn't sudden."""
    c, root = sums.columns[what], taken_out(sums.PP)
    A, B, g = (_from_on(x) for x in (sums.DD[:, c, c], sums.by_fit(what), sums.Dr[:, c]))
    informative = np.einsum("tii->t", sums.DD[:, c, c]) > 0
    before = np.cumsum(informative) - informative
    allowed = informative & (before >= LEAST_TICKS) & (informative.sum() - before >= LEAST_TICKS)
    scan = _scan(A, B, g, root, sums.Pr)
    directions = int(scan.known.counts[allowed].sum(axis=-1).max(initial=0))
    if not directions:
        return _nothing(sums, what)
    best = int(np.argmax(np.where(allowed, scan.gain, -1.0)))
    profile = (np.arange(len(g)) >= best).astype(np.float64)
    noise, freedom = noise_between_blocks(sums, what, profile)
    noise += detector_noise(sums, what, profile)
    x = as_chi2(scan.gain[best] / noise, freedom)
    behind = np.minimum(scan.gain - scan.gain[best], 0.0)  # where it isn't allowed it may be ahead
    likely = np.where(allowed, np.exp(0.5 * behind / noise), 0.0)
    ratio = (informative.sum() / LEAST_TICKS - 1.0) ** 2
    log_p = log_chance_of_a_step(x, directions, float(ratio))
    effect = _effect(sums, what, profile, scan, best, log_p, directions, noise, freedom, likely / likely.sum())
    return effect if is_abrupt(sums, what, best, effect.size) else replace(effect, log_p=0.0)


def constant_effect(sums: Sums, what: str, profile: FloatArray) -> Effect:
    """A change by a given profile (n,) over time: all ones for what is always so."""
    c, root = sums.columns[what], taken_out(sums.PP)
    A = np.einsum("t,tij->ij", profile**2, sums.DD[:, c, c])
    B, g = np.einsum("t,tij->ij", profile, sums.by_fit(what)), np.einsum("t,ti->i", profile, sums.Dr[:, c])
    scan = _scan(A[None], B[None], g[None], root, sums.Pr)
    directions = int(scan.known.counts[0].sum())
    if not directions:
        return _nothing(sums, what)
    noise, freedom = noise_between_blocks(sums, what, profile)
    noise += detector_noise(sums, what, profile)
    log_p = log_chance(as_chi2(scan.gain[0] / noise, freedom), directions)
    return _effect(sums, what, profile, scan, 0, log_p, directions, noise, freedom, np.zeros(0))


def _effect(
    sums: Sums,
    what: str,
    profile: FloatArray,
    scan: _Scan,
    at: int,
    log_p: float,
    directions: int,
    noise: float,
    freedom: float,
    times: FloatArray,
) -> Effect:
    size = scan.known.pseudo_inverse()[at] @ scan.score[at]
    # Of a move only what is seen is told; a number stands beside what the calibration says of it.
    known = scan.known.pseudo_inverse() if len(size) == len(LEAST_KNOWN["twist"]) else scan.known.inverse()
    covariance = noise * known[at]
    explained = float(scan.gain[at])
    information = scan.information[at]
    return Effect(
        what,
        profile,
        size,
        covariance,
        information,
        explained / noise,
        explained,
        log_p,
        directions,
        noise,
        freedom,
        times,
        _gaps(sums),
    )


def _gaps(sums: Sums) -> tuple[FloatArray, FloatArray]:
    return np.concatenate([sums.start_s[:1], sums.end_s[:-1]]), sums.start_s


def _nothing(sums: Sums, what: str) -> Effect:
    n, d = len(sums.start_s), len(range(sums.Dr.shape[1])[sums.columns[what]])
    nothing: FloatArray = np.zeros((d, d), dtype=np.float64)
    no_times: FloatArray = np.zeros(0, dtype=np.float64)
    return Effect(
        what=what,
        profile=np.zeros(n),
        size=np.zeros(d),
        covariance=nothing + np.inf,
        information=nothing,
        gain=0.0,
        explained=0.0,
        log_p=0.0,
        directions=0,
        noise=1.0,
        freedom=0.0,
        times=no_times,
        gap_s=_gaps(sums),
    )


def _from_on(values: FloatArray) -> FloatArray:
    """(n, ...) sums from each tick to the last."""
    return np.cumsum(values[::-1], axis=0)[::-1]


def noise_between_blocks(sums: Sums, what: str, profile: FloatArray) -> tuple[float, float]:
    """Variance of the scores of blocks of time over what their information says, at least 1, and its freedom.

    With the change itself taken out, as far as a fit can follow it. What is the same for a while, a lens model's error
    about a slow object, makes blocks differ by more than corners' noise does.
    """
    c, n = sums.columns[what], len(sums.start_s)
    allowed = sums.allowing(what, profile)
    root = taken_out(allowed.PP)
    block = (np.arange(n) * min(BLOCKS, max(n // BLOCK_TICKS, 1))) // n
    first = np.flatnonzero(np.diff(block, prepend=-1))
    A, E, g = (np.add.reduceat(x, first, axis=0) for x in (sums.DD[:, c, c], allowed.by_fit(what), sums.Dr[:, c]))
    ER = E @ root
    left = g - ER @ (root.T @ allowed.Pr)
    inverse = _known(A, 1e-9).pseudo_inverse()
    squared = float(np.einsum("bi,bij,bj->", left, inverse, left))
    freedom = float(np.einsum("bij,bji->", inverse, A - ER @ np.swapaxes(ER, -1, -2)))
    return (max(squared / freedom, 1.0), freedom) if freedom > 2.0 else (1.0, 2.0)


def as_chi2(gain: float, freedom: float) -> float:
    """The chi-squared value as rare as a gain over noise that is estimated with some degrees of freedom."""
    return max(freedom - 1.0, 1.0) * float(np.log1p(gain / freedom))


def log_chance(x: float, d: int) -> float:
    """Logarithm of the upper tail of chi-squared with d degrees of freedom, far out too."""
    tail = float(gammaincc(0.5 * d, 0.5 * x))
    if tail > 1e-200:
        return float(np.log(tail))
    return float((0.5 * d - 1.0) * np.log(0.5 * x) - 0.5 * x - gammaln(0.5 * d))


def log_chance_of_a_step(x: float, d: int, ratio: float) -> float:
    """Logarithm of the chance that the likeliest of all steps gains x or more by chance, d numbers each.

    Csoergoe and Horvath, Limit theorems in change-point analysis (1997), 1.3.26, after James, James and Siegmund
    (1987): for steps between shares h and 1 - h of what there is, `ratio` = ((1 - h) / h)^2.
    """
    if x <= d + 2.0:
        return 0.0
    tail = 0.5 * d * np.log(0.5 * x) - 0.5 * x - gammaln(0.5 * d)
    return min(float(tail + np.log((1.0 - d / x) * np.log(max(ratio, 1.0)) + 4.0 / x)), 0.0)
