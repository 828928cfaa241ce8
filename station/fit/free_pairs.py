"""Free pairs: parts that nothing joins. A hypothesis on a pair and no joint type, as it has no edge.

A joint of unknown noise explains any motion: what it can't follow is noise. So noise is looked at. What the likeliest
type leaves of a pair's motion is taken for

- noise, as far as it is forgotten within LAG of the record: white noise may be of any size;
- a tracker's slow errors, as far as they are no more than SLOW_M and SLOW_RAD for each part, orientation errors of the
  parent acting over the distance; or as long as the joint explains all of the motion but a share of SHARE: what moved
  far may have large errors;
- and beyond, motion: the pair is free. So it is if orientations err by ABSURD_RAD, as no tracker does, and if fewer
  than MOST of the frames are inliers: any joint goes through some frames of a motion.

With kappa the variance of what isn't forgotten over what slow errors may have, a square that is known as one of n
independent numbers is, the pair is free with the probability that chi squared of n degrees is below n kappa. What isn't
forgotten counts only if it is more than SURE deviations of what white noise would show by chance.

A pair whose noise fills the scene (its weight is not below that of nothing but outliers) is no edge anyhow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtr, chdtrc

from station.fit.noise import INLIER_ABOVE
from station.fit.pairwise import JointFit, PairTracks
from station.fit.whitening import UnknownNoise
from station.kinematics import se3
from station.kinematics.joints.base import BALANCE_M
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Deviations for each axis: markers and cameras of tracked doors and drawers err by 1-3 mm and 0.5-2 deg for seconds. In
# a scene of more than a metre, for each metre of it.
SLOW_M, SLOW_RAD = 0.004, float(np.radians(2.5))
# For each axis; two parts tracked to 10 deg each are off by 14 deg.
ABSURD_RAD = float(np.radians(25.0))
# Share of the frames.
MOST = 0.5
# Share of the motion's variance that a joint may leave to errors: a tracker's are a few hundredths of it at most, and a
# linkage that is only nearly straight, by 30 deg to either side, leaves as much.
SHARE = 0.05
# Share of the record over which noise is forgotten.
LAG = 0.02
SURE = 3.5
# Share of the relative orientation's variance above which the parent has a part in it.
PARENTS_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Left:
    """What types leave of P pairs' motion: residuals (P, T, 6) and the probability (P, T) of inliers, of `JointFit`."""

    residual: FloatArray
    inlier: FloatArray

    @staticmethod
    def by(fits: Sequence[JointFit], chosen: NDArray[np.intp]) -> Left:
        """By one of several types for each pair (P,)."""
        residual, inlier = fits[0].residual.copy(), fits[0].inlier.copy()
        for i, fit in enumerate(fits[1:], 1):  # types are few
            rows = chosen == i
            residual[rows], inlier[rows] = fit.residual[rows], fit.inlier[rows]
        return Left(residual, inlier)

    def take(self, rows: NDArray[np.intp]) -> Left:
        """Of some of the pairs."""
        return Left(self.residual[rows], self.inlier[rows])


def log_odds_of_free(
    best: Left | JointFit, still: JointFit | None, tracks: PairTracks, repeats: FloatArray
) -> FloatArray:
    """(P,) log odds that a pair is free.

    Args:
        best: the likeliest type, or what it leaves.
        still: the rigid joint, whose residuals are the motion; None if it was not fitted: no share of it counts then.
        tracks: what both were fitted to.
        repeats: (P,) frames that repeat an error of the likeliest type.
    """
    good = (best.inlier > INLIER_ABOVE) & tracks.seen
    kappa = _slow_errors(best, tracks, good).max(axis=0)
    if still is not None:
        kappa = np.minimum(kappa, _share_left(best, still, good) / SHARE)
    numbers = np.maximum(np.sum(tracks.dimensions * good, axis=-1) / repeats, 6.0)
    below: FloatArray = np.asarray(chdtr(numbers, numbers * kappa), dtype=np.float64)
    above: FloatArray = np.asarray(chdtrc(numbers, numbers * kappa), dtype=np.float64)
    tiny = np.finfo(float).tiny
    odds = np.log(np.maximum(below, tiny)) - np.log(np.maximum(above, tiny))
    absurd = _turns(best, good & tracks.oriented) > ABSURD_RAD
    absurd |= good.sum(axis=-1) < MOST * tracks.seen.sum(axis=-1)
    return np.where(absurd, -np.log(tiny), odds)


def _turns(fit: Left | JointFit, good: BoolArray) -> FloatArray:
    """(P,) rad for each axis: root mean square of the orientation errors in good frames."""
    square = np.sum(fit.residual[..., 3:] ** 2, axis=-1)
    return np.sqrt(np.sum(good * square, axis=-1) / (3 * np.maximum(good.sum(axis=-1), 1)))


def stays_in_place(fit: Left | JointFit, tracks: PairTracks) -> BoolArray:
    """(P,) whether a type leaves no motion of most frames' positions, whatever it leaves of the orientations."""
    good = (fit.inlier > INLIER_ABOVE) & tracks.seen
    most: BoolArray = good.sum(axis=-1) >= MOST * tracks.seen.sum(axis=-1)
    return most & (_slow_errors(fit, tracks, good)[0] < 1)


def _slow_errors(fit: Left | JointFit, tracks: PairTracks, good: BoolArray) -> FloatArray:
    """(2, P) variance of errors of position and orientation that last, over that which slow errors may have."""
    data = tracks.data
    noisy = tracks.noise.noisy if tracks.noise.noisy is not None else _noisy(tracks)
    slow = UnknownNoise(data.t, noisy, tracks.seen, tracks.oriented, np.zeros(2))
    whitening = slow.whitening(np.tile([(SLOW_M * tracks.lab_m) ** 2, SLOW_RAD**2], (len(good), 1)))
    d, e = (np.einsum("ijpt,ptj->ipt", data.R, part) for part in np.split(fit.residual, 2, axis=-1))
    u = np.moveaxis(whitening(d, e), 0, -1)
    lasting, of_all, deviations = zip(
        _lasting(u[..., :3], good), _lasting(u[..., 3:], good & tracks.oriented), strict=True
    )
    sure = np.sum(of_all, axis=0) > SURE * np.sqrt(np.sum(np.square(deviations), axis=0))
    return np.where(sure, np.stack(lasting), 0.0)


def _lasting(u: FloatArray, good: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariance (P,), for each axis, of errors u (P, T, 3) with those a lag later, in the good frames only; as a share
    of their variance; and that share's deviation if errors are independent.
    """
    order = np.argsort(~good, axis=-1, kind="stable")
    u, good = np.take_along_axis(u, order[..., None], axis=1), np.take_along_axis(good, order, axis=-1)
    count = good.sum(axis=-1)
    lag: NDArray[np.intp] = np.maximum(np.rint(LAG * count), 1.0).astype(np.intp)
    later: NDArray[np.intp] = np.arange(u.shape[1], dtype=np.intp) + lag[:, None]
    both: BoolArray = later < count[:, None]
    u, pairs = np.where(good[..., None], u, 0.0), np.maximum(count - lag, 1)
    later_u = np.take_along_axis(u, np.where(both, later, 0)[..., None], axis=1)
    lasting = np.einsum("pt,pti,pti->p", both.astype(np.float64), u, later_u) / (3 * pairs)
    whole = np.sum(u**2, axis=(1, 2)) / (3 * np.maximum(count, 1))
    known = (count > lag) & (whole > 0)
    share = np.where(known, lasting / np.where(known, whole, 1.0), 0.0)
    return np.where(known, np.maximum(lasting, 0.0), 0.0), share, np.where(known, 1 / np.sqrt(3 * pairs), 0.0)


def _share_left(best: Left | JointFit, still: JointFit, good: BoolArray) -> FloatArray:
    """(P,) share of the motion, a turn of one radian counting as BALANCE_M, that the likeliest type leaves."""
    left, moved = (
        np.sum(good * (np.sum(v**2, axis=-1) + BALANCE_M**2 * np.sum(w**2, axis=-1)), axis=-1)
        for v, w in (np.split(fit.residual, 2, axis=-1) for fit in (best, still))
    )
    return left / np.maximum(moved, np.finfo(float).tiny)


def _noisy(tracks: PairTracks) -> FloatArray:
    """(2, P) 1 for the child, and for a parent that has a part in the given covariances, else 0.

    A parent's orientation errors of variance v move the child: cov(position, orientation) has the part v hat(p), with p
    the parent in the child.
    """
    p = se3.inverse(tracks.T_a_b)[..., :3, 3]
    both, own = tracks.noise.shape[..., :3, 3:], np.trace(tracks.noise.shape[..., 3:, 3:], axis1=-2, axis2=-1) / 3
    across = np.stack(
        [both[..., 2, 1] - both[..., 1, 2], both[..., 0, 2] - both[..., 2, 0], both[..., 1, 0] - both[..., 0, 1]], -1
    )
    told = np.sum(tracks.seen * np.sum(across * p, axis=-1), axis=-1)
    whole = np.sum(tracks.seen * own * 2 * np.sum(p**2, axis=-1), axis=-1)
    return np.stack([told > PARENTS_SHARE * whole, np.ones(len(told), dtype=bool)]).astype(np.float64)
