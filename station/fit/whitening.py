"""Whitens residuals of relative poses told in the parent's axes, position before orientation; estimates their scales.

With the errors d of position and e of orientation of a measured pose T_a_b, told along the axes of a, the whitened
residual is

    r_v = W_vv d,   r_w = W_wv d + W_ww e,   cov(r) = 1:

r_v is what positions alone tell, r_w what orientations tell beyond. So either is at hand: where no orientation was
measured, and where only the orientation is wrong, as when a flat marker is taken for its mirror image. Scales are
restricted maximum likelihood estimates: residuals within the states' directions carry no information.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.noise import chi2_median, lower_inverse
from station.kinematics.joints.base import BALANCE_M
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

LOG_2PI = float(np.log(2 * np.pi))
# Degrees of freedom below which a scale keeps its value: nothing measures it.
LEAST_FREEDOMS = 1e-3
# How far apart two scales must be told, as the squared sine between them, for one step to move both.
LEAST_APART = 1e-4
# A step makes no scale more than so many times as large, or as small.
LARGEST_FACTOR = 10.0


@dataclass(frozen=True, eq=False)
class Whitening:
    """W of P pairs in T frames, entries first; zero for what was not measured.

    Attributes:
        vv: (3, 3, P, T) [1/m].
        wv: (3, 3, P, T) [1/m].
        ww: (3, 3, P, T) [1/rad].
        log_v: (P, T) log density [1/m^3] of the position at zero residual; 0 unseen.
        log_w: (P, T) log density [1/rad^3] of the orientation, given the position, at zero residual; 0 not measured.
    """

    vv: FloatArray
    wv: FloatArray
    ww: FloatArray
    log_v: FloatArray
    log_w: FloatArray

    def __call__(self, d: FloatArray, e: FloatArray) -> FloatArray:
        """(6, P, T) whitened residual of d and e (3, P, T)."""
        r = np.empty((6, *d.shape[1:]))
        np.einsum("ijpt,jpt->ipt", self.vv, d, out=r[:3])
        np.einsum("ijpt,jpt->ipt", self.ww, e, out=r[3:])
        r[3:] += np.einsum("ijpt,jpt->ipt", self.wv, d)
        return r

    def by_motion(self, u: FloatArray, w: FloatArray, turn: FloatArray) -> FloatArray:
        """(6, c, P, T) change of r with velocities u of the model's origin and w of its orientation (3, c, P, T).

        d changes by -u, and e by -turn w with turn (3, 3, P, T).
        """
        A = np.empty((6, *u.shape[1:]))
        np.einsum("ijpt,jcpt->icpt", self.vv, u, out=A[:3])
        np.einsum("ijpt,jcpt->icpt", np.einsum("ijpt,jkpt->ikpt", self.ww, turn), w, out=A[3:])
        A[3:] += np.einsum("ijpt,jcpt->icpt", self.wv, u)
        return np.negative(A, out=A)

    def take(self, rows: IntArray | BoolArray) -> Whitening:
        """That of some of the pairs."""
        return Whitening(
            self.vv[:, :, rows], self.wv[:, :, rows], self.ww[:, :, rows], self.log_v[rows], self.log_w[rows]
        )

    def trusting(self, share: FloatArray) -> Whitening:
        """With orientations that count by a share (P, T) only."""
        root = np.sqrt(share)
        return replace(self, wv=self.wv * root, ww=self.ww * root)


@dataclass(frozen=True, eq=False)
class Projected:
    """Whitened residuals of a fit, and what could take them up.

    Attributes:
        residual: (6, P, T).
        states: (6, s, P, T) orthonormal directions in which the states move it.
        weights: (P, T) of the frames.
        measured: (P, T) numbers that were measured in a frame.
        parameters: numbers that the fit moved.
    """

    residual: FloatArray
    states: FloatArray
    weights: FloatArray
    measured: FloatArray
    parameters: int

    @property
    def left(self) -> FloatArray:
        """(6, P, T) residual without the states' directions."""
        along = np.einsum("rspt,rpt->spt", self.states, self.residual)
        return self.residual - np.einsum("rspt,spt->rpt", self.states, along)

    @property
    def freedoms(self) -> FloatArray:
        """(P,) numbers measured less those that the states take up, at least 1."""
        free = self.measured - np.sum(self.states**2, axis=(0, 1))
        return np.maximum(np.sum(self.weights * free, axis=-1), 1.0)

    def share_left(self, freedoms: FloatArray) -> FloatArray:
        """(P,) share of the degrees of freedom that the parameters leave."""
        return np.maximum(1 - self.parameters / freedoms, 1 / freedoms)


@dataclass(frozen=True, eq=False)
class GivenNoise:
    """Covariances that were given, up to one scale: their whitening at scale 1, and the least scale (P, 1)."""

    unit: Whitening
    least: FloatArray

    def take(self, rows: IntArray | BoolArray) -> GivenNoise:
        """The noise of some of the pairs."""
        return GivenNoise(self.unit.take(rows), self.least[rows])

    def frames(self, rows: IntArray, frames: IntArray) -> GivenNoise:
        """That of some frames (N,) of some pairs (N,), each as a pair of its own."""
        w = self.unit
        vv, wv, ww = (matrix[:, :, rows, frames, None] for matrix in (w.vv, w.wv, w.ww))
        log_v, log_w = (log[rows, frames, None] for log in (w.log_v, w.log_w))
        return GivenNoise(Whitening(vv, wv, ww, log_v, log_w), self.least[rows])

    def whitening(self, scales: FloatArray) -> Whitening:
        """At scales (P, 1)."""
        w, root = self.unit, 1 / np.sqrt(scales)
        log_v = w.log_v + np.where(w.log_v != 0, 3 * np.log(root), 0.0)
        log_w = w.log_w + np.where(w.log_w != 0, 3 * np.log(root), 0.0)
        return Whitening(w.vv * root, w.wv * root, w.ww * root, log_v, log_w)

    def robust_scales(self, d: FloatArray, e: FloatArray, seen: BoolArray, oriented: BoolArray) -> FloatArray:
        """(P, 1) from the median of squared residuals, to start with."""
        chi2 = np.sum(self.unit(d, e) ** 2, axis=0) / chi2_median(3.0 * seen + 3.0 * oriented)
        return np.maximum(medians(chi2, seen)[:, None], self.least)

    def mean_scales(self, d: FloatArray, e: FloatArray, weights: FloatArray, oriented: BoolArray) -> FloatArray:
        """(P, 1) from the mean of squared residuals with weights (P, T)."""
        measured = np.sum(weights * (3.0 + 3.0 * oriented), axis=-1)
        square = np.sum(weights * np.sum(self.unit(d, e) ** 2, axis=0), axis=-1)
        return np.maximum((square / np.maximum(measured, 1.0))[:, None], self.least)

    def updated_scales(self, scales: FloatArray, whitening: Whitening, fit: Projected) -> FloatArray:
        """(P, 1) one multiplicative step to the restricted likelihood's maximum."""
        freedoms = fit.freedoms
        square = np.sum(fit.weights * np.sum(fit.left**2, axis=0), axis=-1)
        return np.maximum(scales * (square / (freedoms * fit.share_left(freedoms)))[:, None], self.least)


@dataclass(frozen=True, eq=False)
class UnknownNoise:
    """Errors of unknown size: the same in all directions, for positions and for orientations of each part.

    An orientation error of the parent moves the child across the line between them, by the distance. With the variances
    s of position and t of orientation, a noisy parents and b noisy children, and the child at p in the parent,

        cov(d) = (a + b) s 1 + a t (|p|^2 1 - p p^T),  cov(e, d) = a t hat(p),  cov(e) = (a + b) t 1,

    which has the eigenvectors along and across p.

    Attributes:
        position: (3, P, T) of the child in the parent, p.
        noisy: (2, P) a and b, 0 or 1.
        seen: (P, T).
        oriented: (P, T).
        least: (P, 2) least s and t.
    """

    position: FloatArray
    noisy: FloatArray
    seen: BoolArray
    oriented: BoolArray
    least: FloatArray

    def take(self, rows: IntArray | BoolArray) -> UnknownNoise:
        """The noise of some of the pairs."""
        return UnknownNoise(
            self.position[:, rows], self.noisy[:, rows], self.seen[rows], self.oriented[rows], self.least[rows]
        )

    def frames(self, rows: IntArray, frames: IntArray) -> UnknownNoise:
        """That of some frames (N,) of some pairs (N,), each as a pair of its own."""
        return UnknownNoise(
            self.position[:, rows, frames, None],
            self.noisy[:, rows],
            self.seen[rows, frames, None],
            self.oriented[rows, frames, None],
            self.least[rows],
        )

    def whitening(self, scales: FloatArray) -> Whitening:
        """At scales (P, 2)."""
        (a, b), p = self.noisy[..., None], self.position
        s, t = scales[:, :1], scales[:, 1:]
        square = np.sum(p**2, axis=0)
        apart = np.broadcast_to((a + b) * s, square.shape)
        lever = a * t * square
        across, along = 1 / np.sqrt(apart + lever), 1 / np.sqrt(apart)
        gain = a * t * across**2
        turn_along = np.broadcast_to(1 / np.sqrt((a + b) * t), square.shape)
        turn_across = 1 / np.sqrt(t * (b + a * apart * across**2))
        outer = p[:, None] * (p / np.where(square > 0, square, 1.0))
        return _masked(
            Whitening(
                vv=_along_and_across(outer, along, across),
                wv=_hat(p, turn_across * gain),
                ww=_along_and_across(outer, turn_along, turn_across),
                log_v=np.log(along * across**2) - 1.5 * LOG_2PI,
                log_w=np.log(turn_along * turn_across**2) - 1.5 * LOG_2PI,
            ),
            self.seen,
            self.oriented,
        )

    def robust_scales(self, d: FloatArray, e: FloatArray, seen: BoolArray, oriented: BoolArray) -> FloatArray:
        """(P, 2) from the medians of squared residuals, to start with; orientations that states explain whole tell
        nothing.
        """
        one = chi2_median(np.array(3.0))
        return self._started(medians(np.sum(d**2, axis=0), seen) / one, medians(np.sum(e**2, axis=0), oriented) / one)

    def mean_scales(self, d: FloatArray, e: FloatArray, weights: FloatArray, oriented: BoolArray) -> FloatArray:
        """(P, 2) from the means of squared residuals with weights (P, T)."""
        position = np.sum(weights * np.sum(d**2, axis=0), axis=-1) / np.maximum(3 * weights.sum(axis=-1), 1.0)
        trusted = weights * oriented
        orientation = np.sum(trusted * np.sum(e**2, axis=0), axis=-1) / np.maximum(3 * trusted.sum(axis=-1), 1.0)
        return self._started(position, orientation)

    def _started(self, position: FloatArray, orientation: FloatArray) -> FloatArray:
        """(P, 2) scales of variances of relative poses (P,)."""
        parts = np.maximum(self.noisy.sum(axis=0), 1.0)
        orientation = np.where(orientation > parts * self.least[:, 1], orientation, position / BALANCE_M**2)
        return np.maximum(np.stack([position / parts, orientation / parts], axis=-1), self.least)

    def updated_scales(self, scales: FloatArray, whitening: Whitening, fit: Projected) -> FloatArray:
        """(P, 2) one step of Fisher's scoring to the restricted likelihood's maximum.

        With M_k = W S_k W^T for the part S_k of the covariance of scale s_k, Q the projector that takes the states'
        directions out, and a_k = s_k Q M_k Q, scale k should have squares r^T a_k r of as much as its freedoms tr a_k;
        what a relative change of scale l adds to them is tr(a_k a_l). As a_0 + a_1 = Q, the columns of positions alone
        tell all of them.
        """
        left, freedoms = fit.left, fit.freedoms
        share = fit.share_left(freedoms)
        columns = np.concatenate([whitening.vv, whitening.wv]) * np.sqrt(self.noisy.sum(axis=0) * scales[:, 0])[:, None]
        by_residual = np.einsum("rjpt,rpt->jpt", columns, left)
        by_states = np.einsum("rjpt,rspt->jspt", columns, fit.states)
        inside = np.einsum("rjpt,rkpt->jkpt", columns, columns) - np.einsum("jspt,kspt->jkpt", by_states, by_states)
        square = np.sum(fit.weights * np.sum(left**2, axis=0), axis=-1)
        square_0 = np.sum(fit.weights * np.sum(by_residual**2, axis=0), axis=-1)
        told_0 = np.sum(fit.weights * (inside[0, 0] + inside[1, 1] + inside[2, 2]), axis=-1)
        both_0 = np.sum(fit.weights * np.sum(inside**2, axis=(0, 1)), axis=-1)
        scales = np.maximum(scales * _scored(square_0, square, told_0, freedoms, both_0, share), self.least)
        # A parent's orientation errors, acting over the distance, can take all errors of few positions for theirs.
        scales[:, 0] = np.maximum(scales[:, 0], BALANCE_M**2 / np.maximum(freedoms, 1.0) * scales[:, 1])
        return scales


def _scored(
    square_0: FloatArray,
    square: FloatArray,
    told_0: FloatArray,
    told: FloatArray,
    both_0: FloatArray,
    share: FloatArray,
) -> FloatArray:
    """(P, 2) factors of two scales: squares and degrees of freedom of the first and of both together, and tr(a_0 a_0).

    Where the two are hardly told apart each is changed by itself, which is slower but safe.
    """
    excess_0, excess_1 = square_0 / share - told_0, (square - square_0) / share - (told - told_0)
    across, both_1 = told_0 - both_0, told - 2 * told_0 + both_0
    det = both_0 * told - told_0**2
    apart = det > LEAST_APART * both_0 * told
    safe = np.where(apart, det, 1.0)
    together = [(both_1 * excess_0 - across * excess_1) / safe, (both_0 * excess_1 - across * excess_0) / safe]
    alone = [_ratio(excess_0, told_0), _ratio(excess_1, told - told_0)]
    change = np.stack([np.where(apart, one, other) for one, other in zip(together, alone, strict=True)], axis=-1)
    return np.clip(1 + change, 1 / LARGEST_FACTOR, LARGEST_FACTOR)


def _ratio(excess: FloatArray, freedoms: FloatArray) -> FloatArray:
    """excess / freedoms; 0 where there are no freedoms to tell."""
    told = freedoms > LEAST_FREEDOMS
    return np.where(told, excess / np.where(told, freedoms, 1.0), 0.0)


PairNoise = GivenNoise | UnknownNoise


def given_whitening(covariance: FloatArray, R: FloatArray, seen: BoolArray, oriented: BoolArray) -> Whitening:
    """Of covariances (P, T, 6, 6) of right perturbations of poses with rotations R (3, 3, P, T)."""
    sigma = np.moveaxis(covariance, (-2, -1), (0, 1))
    turned = np.empty(sigma.shape)
    for i, j in ((0, 0), (1, 0), (1, 1)):  # position with position, orientation with position, and with itself
        block = sigma[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
        turned[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = np.einsum(
            "ijpt,ljpt->ilpt", np.einsum("ijpt,jkpt->ikpt", R, block), R
        )
    for entry in range(6):
        unmeasured = ~(seen if entry < 3 else oriented)
        if unmeasured.any():
            turned[entry, :entry, unmeasured] = 0.0
            turned[entry, entry, unmeasured] = 1.0
    W = lower_inverse(turned)
    log_v, log_w = (np.log(W[0, 0] * W[1, 1] * W[2, 2]), np.log(W[3, 3] * W[4, 4] * W[5, 5]))
    whole = Whitening(W[:3, :3], W[3:, :3], W[3:, 3:], log_v - 1.5 * LOG_2PI, log_w - 1.5 * LOG_2PI)
    return _masked(whole, seen, oriented)


def _masked(w: Whitening, seen: BoolArray, oriented: BoolArray) -> Whitening:
    """Zero for what was not measured."""
    if oriented.all():
        return w
    return Whitening(w.vv * seen, w.wv * oriented, w.ww * oriented, w.log_v * seen, w.log_w * oriented)


def _along_and_across(outer: FloatArray, along: FloatArray, across: FloatArray) -> FloatArray:
    """(3, 3, P, T) matrices with eigenvalues `along` and `across` the direction with the projector `outer`."""
    matrix = outer * (along - across)
    for i in range(3):
        matrix[i, i] += across
    return matrix


def _hat(p: FloatArray, factor: FloatArray) -> FloatArray:
    """(3, 3, P, T) matrices of -factor p x."""
    found = np.zeros((3, *p.shape))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(p[k], factor, out=found[i, j])
        np.negative(found[i, j], out=found[j, i])
    return found


def medians(values: FloatArray, seen: BoolArray) -> FloatArray:
    """(P,) medians over the seen frames of values (P, T); 1 without any."""
    ordered = np.sort(np.where(seen, values, np.inf), axis=-1)
    middle = np.maximum(seen.sum(axis=-1) - 1, 0) // 2
    found = np.take_along_axis(ordered, middle[:, None], axis=-1)[:, 0]
    return np.where(np.isfinite(found), found, 1.0)
