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

# Steps around a frame by which it is judged, and the share of them that may be smaller than what they are said to be:
# an outlier makes two of them large.
STEPS, LOWER_SHARE = 8, 0.3
# A pair rests in this share of the frames if it does at all. It moves where its steps are so many times as large as
# there: those of noise alone are within half of that.
RESTS, MOVES_ABOVE = 0.1, 4.0
# Fewer frames in motion may be outliers; so many at rest are kept anyhow.
LEAST_MOVING, LEAST_AT_REST = 10, 40


def frames_to_count(T_a_b: FloatArray, seen: BoolArray) -> BoolArray:
    """(P, T) the frames of P pairs that count: seen ones, of those at rest as many as there are in motion.

    Args:
        T_a_b: (P, T, 4, 4), finite.
        seen: (P, T).
    """
    moves = _moves(T_a_b, seen)
    moving, resting = moves.sum(axis=-1), (seen & ~moves).sum(axis=-1)
    kept = np.maximum(moving, LEAST_AT_REST)
    thinned = (moving >= LEAST_MOVING) & (resting > kept)
    kept = np.where(thinned, kept, resting)[:, None]
    number = np.cumsum(seen & ~moves, axis=-1)  # of a frame among those at rest, from 1
    whole = np.maximum(resting, 1)[:, None]
    spread = number * kept // whole > (number - 1) * kept // whole
    return moves | (seen & ~moves & spread)


def _moves(T_a_b: FloatArray, seen: BoolArray) -> BoolArray:
    """(P, T) frames in which most steps around are far larger than at rest."""
    count = seen.sum(axis=-1)
    if seen.shape[1] <= STEPS:
        return np.zeros_like(seen)
    order = np.argsort(~seen, axis=-1, kind="stable")  # seen ones first, in order of time
    rows = np.arange(len(seen))[:, None]
    steps = _steps(T_a_b[rows, order])
    steps[np.arange(steps.shape[1]) >= count[:, None] - 1] = np.inf
    half = STEPS // 2
    around = sliding_window_view(np.pad(steps, ((0, 0), (half, half)), constant_values=np.inf), STEPS, axis=-1)
    rank = int(LOWER_SHARE * STEPS)
    size = np.partition(around, rank, axis=-1)[..., rank]
    at_rest = np.take_along_axis(np.sort(size, axis=-1), (RESTS * count).astype(np.intp)[:, None], axis=-1)
    found = np.zeros_like(seen)
    np.put_along_axis(found, order, np.isfinite(size) & (size > MOVES_ABOVE * at_rest), axis=-1)
    return found & seen


def _steps(T: FloatArray) -> FloatArray:
    """(P, T - 1) [m] from frame to frame of poses (P, T, 4, 4), a turn of one radian counting as BALANCE_M."""
    change = np.diff(T[..., :3, :], axis=1)
    turn = np.einsum("ptij,ptij->pt", change[..., :3], change[..., :3]) / 2  # of a small one, its square
    return np.sqrt(np.einsum("pti,pti->pt", change[..., 3], change[..., 3]) + BALANCE_M**2 * turn)
