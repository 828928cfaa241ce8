"""Fit every joint type to many pairs of bodies and score them; some pairs at a time, so that memory stays bounded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.bodies import Bodies, oriented_pairs, pair_tracks
from station.fit.pairwise import COST_TOLERANCE, LM_ITERATIONS, JointFit, PairTracks, fit_joint
from station.fit.selection import Scores, score_fits
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Common frames that a pair needs: below, the 11 numbers of a revolute joint and its states fit whatever noise there is.
MIN_FRAMES = 10
# Frames of all pairs that are fitted at once: some 300 numbers each, so about 100 MB.
FRAMES_AT_ONCE = 40_000
# Frames of a pair that tell its type and whether it is an edge; the tree's joints are fitted to all.
FRAMES_TO_COMPARE = 200
COMPARE_ITERATIONS = 10
COMPARE_TOLERANCE = 0.1
# Share of the log's frames beyond which seeing a pair together more often makes it no better an edge: pairs compare by
# the score of a frame. In the rest of the frames the tree explains the parts through their neighbours. Below, a pair
# counts for less: what did not move in a few frames looks rigid.
FULL_SHARE = 0.25
# Ratio of deviations: a rigid joint with so many times the noise that its parts have elsewhere is no rigid joint.
MISFIT = 4.0


@dataclass(frozen=True, eq=False)
class PairTable:
    """What is known of P pairs (P, 2), parent first.

    Attributes:
        pairs: (P, 2) bodies.
        enough: (P,) enough common frames.
        scores: of all types.
        best_types: P names.
        scales: (P, S) noise scales of the best type.
        rigid: (P,) the best type is rigid, and its noise is what its parts have elsewhere.
        T_a_b: (P, 4, 4) pose of the best type at the state 0.
    """

    pairs: IntArray
    enough: BoolArray
    scores: Scores
    best_types: tuple[str, ...]
    scales: FloatArray
    rigid: BoolArray
    T_a_b: FloatArray


def fit_types(tracks: PairTracks, joint_types: Sequence[str], *, quickly: bool) -> dict[str, JointFit]:
    """Every type fitted to all pairs; pairs without orientations by their positions."""
    by_pose = tracks.oriented.sum(axis=-1) >= MIN_FRAMES
    effort = (COMPARE_ITERATIONS, COMPARE_TOLERANCE) if quickly else (LM_ITERATIONS, COST_TOLERANCE)
    return {name: _fit_type(name, tracks, by_pose, *effort) for name in joint_types}


def _fit_type(name: str, tracks: PairTracks, by_pose: BoolArray, iterations: int, tolerance: float) -> JointFit:
    def fit(some: PairTracks, kind: bool) -> JointFit:
        return fit_joint(JOINT_TYPES[name], some, by_pose=kind, iterations=iterations, tolerance=tolerance)

    if by_pose.all() or not by_pose.any():
        return fit(tracks, bool(by_pose.all()))
    order = np.concatenate([np.flatnonzero(by_pose), np.flatnonzero(~by_pose)])
    fits = [fit(tracks.take(np.flatnonzero(by_pose == kind)), kind) for kind in (True, False)]
    return fits[0].joined(fits[1]).take(np.argsort(order))


def fit_pairs(
    bodies: Bodies, pairs: IntArray, joint_types: Sequence[str], criterion: str
) -> tuple[Mapping[str, JointFit], Scores, PairTracks]:
    """All types fitted to all frames of pairs (P, 2) as they are oriented, and scored."""
    tracks = pair_tracks(bodies, pairs)
    fits = fit_types(tracks, joint_types, quickly=False)
    return fits, score_fits(fits, tracks, criterion), tracks


def compare_pairs(bodies: Bodies, pairs: IntArray, joint_types: Sequence[str], criterion: str) -> PairTable:
    """Fit and score all pairs (P, 2) of bodies; pairs with too few common frames get infinite scores."""
    pairs = oriented_pairs(bodies, pairs)
    common = np.sum(bodies.oriented[:, pairs[:, 0]] & bodies.seen[:, pairs[:, 1]], axis=0)
    enough = common >= MIN_FRAMES
    by_type = {name: np.full(len(pairs), np.inf) for name in joint_types}
    weight, surely = np.full(len(pairs), np.inf), np.zeros(len(pairs), dtype=bool)
    scales: FloatArray = np.ones((len(pairs), 2 if bodies.covariance is None else 1))
    T_a_b = np.tile(np.eye(4), (len(pairs), 1, 1))
    at_once = max(FRAMES_AT_ONCE // max(min(len(bodies.seen), FRAMES_TO_COMPARE), 1), 1)
    rows, full = np.flatnonzero(enough), max(FULL_SHARE * len(bodies.seen), 1.0)
    for start in range(0, len(rows), at_once):  # memory, not time, asks for this loop
        row = rows[start : start + at_once]
        tracks = pair_tracks(bodies, pairs[row], at_most=FRAMES_TO_COMPARE)
        fits = fit_types(tracks, joint_types, quickly=True)
        scores = score_fits(fits, tracks, criterion)
        for i, pair in enumerate(row.tolist()):
            fit = fits[scores.best_type(i)]
            scales[pair] = fit.model.scales[i]
            T_a_b[pair] = fit.model.frames.T_parent_axis[i] @ fit.model.frames.T_axis_child[i]
        weight[row] = scores.weight * np.minimum(common[row], full) / tracks.seen.sum(axis=-1)
        surely[row] = scores.surely_rigid
        for name in joint_types:
            by_type[name][row] = scores.by_type[name]
    scores = Scores(criterion, by_type, weight, surely)
    best_types = tuple(scores.best_type(i) for i in range(len(pairs)))
    rigid = np.array([name == "rigid" for name in best_types], dtype=bool) & enough
    rigid &= _is_usual_noise(pairs, enough, scales, len(bodies.names), bodies.noisy)
    return PairTable(pairs, enough, scores, best_types, scales, rigid, T_a_b)


def _is_usual_noise(pairs: IntArray, enough: BoolArray, scales: FloatArray, count: int, noisy: BoolArray) -> BoolArray:
    """(P,) whether a pair's noise is near the least that one of its parts has in any pair.

    A free motion has no joint, and rigid is the least of all that fail; its residuals are then motion and not noise.
    """
    least = np.full((count, scales.shape[-1]), np.inf)
    for (a, b), scale in zip(pairs[enough].tolist(), scales[enough], strict=True):
        least[a], least[b] = np.minimum(least[a], scale), np.minimum(least[b], scale)
    least[~noisy] = 0.0
    usual = np.maximum(least[pairs[:, 0]], least[pairs[:, 1]])
    return np.all(scales <= MISFIT**2 * usual, axis=-1)
