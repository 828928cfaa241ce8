"""Pairs that stood still but for a few frames: a door that was opened once in a long recording.

Among many frames at rest the few that moved look like outliers. Here they are looked at by themselves, with as many of
the others: if a movable joint explains them as well, the pair is no rigid one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from station.fit.asking import COMPARING, Asking, Explained, Question, ask
from station.fit.bodies import Bodies, pair_tracks
from station.fit.noise import INLIER_ABOVE
from station.fit.pair_likelihood import likelihood
from station.fit.pair_model import OUTLIER_SHARE_START, Model, PairTracks
from station.fit.pair_residuals import errors
from station.fit.pair_starts import FLIP_SHARE_START
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Frames of a pair that are looked at, at most half of which are unexplained.
FRAMES = 200
# Frames that a movable joint has to explain beyond a rigid one, and that share of the unexplained ones besides: with
# its freedom it passes through an outlier or two.
LEAST_FRAMES, LEAST_SHARE = 4.0, 0.1
# It must not lose more than this share of those that the rigid one explains.
LOST_SHARE = 0.1


def moved_rarely(
    bodies: Bodies, pairs: IntArray, T_a_b: FloatArray, scales: FloatArray, joint_types: Sequence[str]
) -> Asking[BoolArray]:
    """(P,) whether pairs (P, 2), rigid with poses (P, 4, 4) and noise scales (P, S), moved in a few frames."""
    movable = [name for name in joint_types if JOINT_TYPES[name].states]
    moved = np.zeros(len(pairs), dtype=bool)
    seen, explained = explained_frames(bodies, pairs, T_a_b, scales)
    some = np.flatnonzero(np.sum(seen & ~explained, axis=-1) >= LEAST_FRAMES)
    if not (some.size and movable):
        return moved
    rows = _balanced_rows(seen[some], explained[some])
    still = np.take_along_axis(explained[some], rows, axis=-1)

    def tracks(piece: IntArray) -> PairTracks:
        return pair_tracks(bodies, pairs[some][piece], rows=rows[piece])

    def told(found: Explained) -> tuple[BoolArray, BoolArray]:
        return found.tracks.seen, np.stack([fit.inlier > INLIER_ABOVE for fit in found.fits.values()])

    T = len(bodies.seen)
    found = yield from ask(Question(len(some), T, tracks, tuple(movable), COMPARING, "evidence", False, told))
    shown, inliers = np.concatenate([each[0] for each in found]), np.concatenate([each[1] for each in found], axis=1)
    odd = shown & ~still
    gained, kept = np.sum(inliers & odd, axis=-1), np.sum(inliers & shown & still, axis=-1)
    enough = (gained >= LEAST_FRAMES + LEAST_SHARE * odd.sum(axis=-1)) & (
        kept >= (1 - LOST_SHARE) * np.sum(shown & still, axis=-1)
    )
    moved[some] = enough.any(axis=0)
    return moved


def explained_frames(
    bodies: Bodies, pairs: IntArray, T_a_b: FloatArray, scales: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """(P, T) where pairs were seen, and where that agrees with rigid poses."""
    seen, explained = np.zeros((2, len(pairs), len(bodies.seen)), dtype=bool)
    for p in range(len(pairs)):  # memory asks for this loop; pairs are the edges of a forest, and frames are many
        tracks = pair_tracks(bodies, pairs[p : p + 1])
        data, share = tracks.data, np.full(1, OUTLIER_SHARE_START)
        frames = JointFrames.plain(se3.identity(1), T_a_b[p : p + 1])
        q = np.zeros((1, len(bodies.seen), 0))
        at = errors(JOINT_TYPES["rigid"], frames, q, data.R, data.t)
        model = Model(frames, q, scales[p : p + 1], share, np.full(1, FLIP_SHARE_START))
        whitening = data.noise.whitening(model.scales)
        found = likelihood(data, model, whitening, whitening(at.d, at.e), np.zeros(1))
        seen[p], explained[p] = tracks.seen[0], found.inlier[0] > INLIER_ABOVE
    return seen, explained


def _balanced_rows(seen: BoolArray, explained: BoolArray) -> IntArray:
    """(P, N) rows in order, half of them unexplained if there are so many, both kinds spread over their frames."""
    N = min(FRAMES, seen.shape[1])
    found = np.zeros((len(seen), N), dtype=np.intp)
    for p in range(len(seen)):  # a few pairs
        odd, rest = np.flatnonzero(seen[p] & ~explained[p]), np.flatnonzero(explained[p])
        size = min(len(odd), max(N // 2, N - len(rest)))
        rows = np.concatenate([odd[_spread(len(odd), size)], rest[_spread(len(rest), min(N - size, len(rest)))]])
        unseen = np.flatnonzero(~seen[p])[: N - len(rows)]
        found[p] = np.sort(np.concatenate([rows, unseen]))
    return found


def _spread(count: int, size: int) -> IntArray:
    """`size` indices spread over `count`."""
    return np.arange(size, dtype=np.intp) * count // max(size, 1)
