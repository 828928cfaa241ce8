"""Frames in which a pair rests, thinned until they are no more than those in which it moves.

Frames at one pose are no independent observations: a tracker that stands still repeats its error, and a state that is
kept is one state. Counted one by one, a long rest makes the noise seem far less than it is from pose to pose, and a
joint that explains the rest alone, with the motion for outliers, the likeliest one. Which frames they are is told by
the steps from frame to frame alone, before there is any joint or noise.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from station.kinematics.joints.base import BALANCE_M
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Steps around a frame that tell its pace, by the third smallest of them: an outlier makes two of them large.
STEPS, SMALLEST = 8, 3
# A pair that rests at all does so in this share of the frames. Its pace there is the usual one of noise; it rests where
# it has no more than so many times that, and moves where it has far more than noise ever does.
RESTS, RESTS_BELOW, MOVES_ABOVE = 0.1, 2.0, 4.0
# Fewer frames in motion, in number or as a share, may be anything; so many at rest are kept anyhow.
LEAST_MOVING, LEAST_SHARE, LEAST_AT_REST = 10, 0.03, 40
# A frame that is so many times as far from its neighbours as they are apart is an outlier. Where these are no few,
# paces tell nothing.
SPIKE, FEW_SPIKES = 3.0, 0.05


def frames_to_count(T_a_b: FloatArray, seen: BoolArray) -> BoolArray:
    """(P, T) the frames of P pairs that count: seen ones, of those at rest as many as there are in motion.

    Args:
        T_a_b: (P, T, 4, 4), finite.
        seen: (P, T).
    """
    order = np.argsort(~seen, axis=-1, kind="stable")  # seen ones first, in order of time
    rests = np.zeros_like(seen)
    if seen.shape[1] > STEPS:
        poses = T_a_b[np.arange(len(seen))[:, None], order]
        np.put_along_axis(rests, order, _long_rests(poses, seen.sum(axis=-1)), axis=-1)
    resting = rests.sum(axis=-1)[:, None]
    kept = np.maximum(seen.sum(axis=-1)[:, None] - resting, LEAST_AT_REST)
    number = np.cumsum(rests, axis=-1)  # of a frame among those at rest, from 1
    whole = np.maximum(resting, 1)
    spread = number * kept // whole > (number - 1) * kept // whole
    return seen & (~rests | spread | (resting <= kept))


def _long_rests(T: FloatArray, count: IntArray) -> BoolArray:
    """(P, T) frames at rest of pairs that move as well, of which the first `count` (P,) were seen."""
    of_pair = count[:, None]
    known: BoolArray = np.arange(T.shape[1], dtype=np.intp) < of_pair
    steps = np.where(known[:, 1:], _distances(T[:, 1:], T[:, :-1]), np.inf)
    ends = ((0, 0), (STEPS // 2, STEPS // 2))
    around = sliding_window_view(np.pad(steps, ends, constant_values=np.inf), STEPS, axis=-1)
    pace = np.partition(around, SMALLEST - 1, axis=-1)[..., SMALLEST - 1]
    usual = np.take_along_axis(np.sort(pace, axis=-1), (RESTS * of_pair).astype(np.intp), axis=-1)
    moving = np.sum(np.isfinite(pace) & (pace > MOVES_ABOVE * usual), axis=-1)
    apart = np.where(known[:, 2:], _distances(T[:, 2:], T[:, :-2]), np.inf)
    spikes = np.sum(np.minimum(steps[:, 1:], steps[:, :-1]) > SPIKE * apart, axis=-1)
    long = (moving >= np.maximum(LEAST_MOVING, LEAST_SHARE * count)) & (spikes <= FEW_SPIKES * count)
    return known & (pace <= RESTS_BELOW * usual) & long[:, None]


def _distances(T: FloatArray, other: FloatArray) -> FloatArray:
    """(...) [m] between poses (..., 4, 4), a small turn of one radian counting as BALANCE_M."""
    change = T[..., :3, :] - other[..., :3, :]
    turn, shift = change[..., :3], change[..., 3]
    return np.sqrt(np.einsum("...i,...i", shift, shift) + 0.5 * BALANCE_M**2 * np.einsum("...ij,...ij", turn, turn))
