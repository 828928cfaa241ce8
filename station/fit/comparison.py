"""Fit every joint type to many pairs of bodies and score them, with care only where it could matter.

All pairs are looked at in a few frames. The edges of the minimum spanning forest over those weights, and all pairs that
could still be in it if a careful look made them as much better as it ever does, are then fitted with care, until every
edge of the forest is. Pieces of pairs run on all cores and keep memory bounded; what is found doesn't depend on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit import pairwise
from station.fit.bodies import Bodies, counted_tracks, oriented_pairs
from station.fit.pairwise import COST_TOLERANCE, LM_ITERATIONS, JointFit, PairTracks
from station.fit.parallel import each, pieces
from station.fit.rare_motion import moved_rarely
from station.fit.selection import Scores, score_fits
from station.fit.structure import contenders, spanning_forest
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Common frames that a pair needs: below, the 11 numbers of a revolute joint and its states fit whatever noise there is.
MIN_FRAMES = 10
# Share of the log's frames beyond which seeing a pair together more often makes it no better an edge: pairs compare by
# the score of a frame. In the rest of the frames the tree explains the parts through their neighbours. Below, a pair
# counts for less: what did not move in a few frames looks rigid.
FULL_SHARE = 0.25
# Ratio of deviations: a rigid joint with so many times the noise that its parts have elsewhere is no rigid joint.
MISFIT = 4.0
# Pairs of which all are fitted with care: with so few a first look costs more than it spares.
FEW_PAIRS = 15
# How much better than the first look a careful one may make a pair, in -2 log likelihood of a frame: on simulated trees
# it is 0.5 at the median and 3.2 at most.
SCREEN_MARGIN = 6.0


@dataclass(frozen=True)
class Effort:
    """Frames of a pair to look at, spread evenly (None: all), least squares steps at most, and when they are enough."""

    frames: int | None
    iterations: int
    tolerance: float


SCREENING = Effort(frames=64, iterations=2, tolerance=0.1)
# Tells a pair's type and whether it is an edge; the tree's joints are fitted to all frames.
COMPARING = Effort(frames=200, iterations=10, tolerance=0.1)
FITTING = Effort(frames=None, iterations=LM_ITERATIONS, tolerance=COST_TOLERANCE)


@dataclass(frozen=True, eq=False)
class PairTable:
    """What is known of P pairs (P, 2), parent first.

    Attributes:
        pairs: (P, 2) bodies.
        enough: (P,) enough common frames.
        counted: (P,) common frames that count for an edge.
        careful: (P,) fitted with care; the others can be no edges, and what is known of them is of a first look.
        scores: of all types.
        scales: (P, S) noise scales of the best type.
        still: (P,) known not to have moved in a few frames among many.
        moved: (P,) known to have.
        rigid: (P,) the best type is rigid, its noise is what its parts have elsewhere, and not known to have moved.
        T_a_b: (P, 4, 4) pose of the best type at the state 0.
    """

    pairs: IntArray
    enough: BoolArray
    counted: FloatArray
    careful: BoolArray
    scores: Scores
    scales: FloatArray
    still: BoolArray
    moved: BoolArray
    rigid: BoolArray
    T_a_b: FloatArray


def fit_types(tracks: PairTracks, joint_types: Sequence[str], *, quickly: bool) -> dict[str, JointFit]:
    """Every type fitted to all pairs; pairs without orientations by their positions."""
    return _fit_types(tracks, joint_types, COMPARING if quickly else FITTING)


def _fit_types(tracks: PairTracks, joint_types: Sequence[str], effort: Effort) -> dict[str, JointFit]:
    return pairwise.fit_types(tracks, joint_types, iterations=effort.iterations, tolerance=effort.tolerance)


def fit_pairs(
    bodies: Bodies, pairs: IntArray, joint_types: Sequence[str], criterion: str
) -> tuple[Mapping[str, JointFit], Scores, PairTracks]:
    """All types fitted to all frames that count of pairs (P, 2) as they are oriented, and scored."""
    tracks = counted_tracks(bodies, pairs)
    work = pieces(len(pairs), len(bodies.seen))
    found = each(lambda piece: _fit_types(tracks.take(piece), joint_types, FITTING), work)
    fits = {name: JointFit.all_of([fit[name] for fit in found]) for name in joint_types}
    return fits, score_fits(fits, tracks, criterion), tracks


def compare_pairs(
    bodies: Bodies,
    pairs: IntArray,
    joint_types: Sequence[str],
    criterion: str,
    *,
    only_rigid: BoolArray | None = None,
) -> PairTable:
    """Fit and score pairs (P, 2) of bodies; pairs with too few common frames get infinite scores.

    Args:
        bodies: K of them.
        pairs: (P, 2).
        joint_types: the candidates.
        criterion: how they are compared.
        only_rigid: (K,) bodies that no movable joint may join; none if None.
    """
    pairs = oriented_pairs(bodies, pairs)
    barred = _any_end(np.zeros(len(bodies.names), dtype=bool) if only_rigid is None else only_rigid, pairs)
    table = _nothing_known(bodies, pairs, joint_types, criterion)
    todo = table.enough
    if todo.sum() > FEW_PAIRS:
        table = _looked_at(bodies, table, todo, joint_types, SCREENING)
        todo = _undecided(table, barred, len(bodies.names))
    while todo.any():  # what a careful look finds may make contenders of other pairs
        table = _looked_at(bodies, table, todo, joint_types, COMPARING)
        todo = _undecided(table, barred, len(bodies.names))
        if not todo.any():
            table = _with_rare_motion(bodies, table, barred, joint_types)
            todo = _undecided(table, barred, len(bodies.names))
    return table


def _with_rare_motion(bodies: Bodies, table: PairTable, barred: BoolArray, joint_types: Sequence[str]) -> PairTable:
    """The table with all frames of the forest's rigid edges looked at, until each is."""
    while True:
        edges = spanning_forest(len(bodies.names), table.pairs, _edge_weights(table, barred))
        new = edges[table.rigid[edges] & ~table.still[edges]]
        if not new.size:
            return table
        found = moved_rarely(bodies, table.pairs[new], table.T_a_b[new], table.scales[new], joint_types)
        still, moved = table.still.copy(), table.moved.copy()
        still[new], moved[new] = ~found, found
        table = replace(table, still=still, moved=moved, rigid=table.rigid & ~moved)


def edge_weights(table: PairTable, only_rigid: BoolArray) -> FloatArray:
    """(P,) weights of edges: infinite without enough frames, and at bodies (K,) that only a rigid joint may join."""
    return _edge_weights(table, _any_end(only_rigid, table.pairs))


def _any_end(of_bodies: BoolArray, pairs: IntArray) -> BoolArray:
    """(P,) whether it is so for either body."""
    return of_bodies[pairs[:, 0]] | of_bodies[pairs[:, 1]]


def _edge_weights(table: PairTable, barred: BoolArray) -> FloatArray:
    weights = np.where(table.enough & (table.rigid | ~barred), table.scores.weight, np.inf)
    return _in_order(table, weights, np.zeros(len(weights)))


def _in_order(table: PairTable, weights: FloatArray, less: FloatArray) -> FloatArray:
    """(P,) weights less so much, where they are still below 0, as misfits: all below 0, and in the order of these."""
    misfit = table.scores.misfit
    looked_at = np.isfinite(misfit)
    most = np.max(misfit, where=looked_at, initial=0.0) + 1.0
    return np.where(looked_at & (weights < less), misfit - less - most, np.inf)


def _undecided(table: PairTable, barred: BoolArray, count: int) -> BoolArray:
    """(P,) pairs that were not fitted with care and may be edges."""
    margin = SCREEN_MARGIN * table.counted
    least = _in_order(table, np.where(table.enough, table.scores.joined_weight, np.inf), margin)
    if "rigid" in table.scores.by_type:
        likeliest = np.min(np.stack(list(table.scores.by_type.values())), axis=0)
        least = np.where(barred & (table.scores.by_type["rigid"] > likeliest + margin), np.inf, least)
    return contenders(count, table.pairs, _edge_weights(table, barred), least) & ~table.careful


def _nothing_known(bodies: Bodies, pairs: IntArray, joint_types: Sequence[str], criterion: str) -> PairTable:
    P = len(pairs)
    common = np.sum(bodies.oriented[:, pairs[:, 0]] & bodies.seen[:, pairs[:, 1]], axis=0)
    no = np.zeros(P, dtype=bool)
    return PairTable(
        pairs=pairs,
        enough=common >= MIN_FRAMES,
        counted=np.minimum(common, max(FULL_SHARE * len(bodies.seen), 1.0)),
        careful=no,
        scores=Scores.unknown(criterion, joint_types, P),
        scales=np.ones((P, 2 if bodies.covariance is None else 1)),
        still=no,
        moved=no,
        rigid=no,
        T_a_b=np.tile(np.eye(4), (P, 1, 1)),
    )


def _looked_at(
    bodies: Bodies, table: PairTable, todo: BoolArray, joint_types: Sequence[str], effort: Effort
) -> PairTable:
    """The table after a look at some of its pairs (P,)."""
    rows = np.flatnonzero(todo)
    frames = len(bodies.seen) if effort.frames is None else min(len(bodies.seen), effort.frames)
    looks = each(lambda piece: _look(bodies, table, rows[piece], joint_types, effort), pieces(len(rows), frames))

    def with_found(before: FloatArray, found: Sequence[FloatArray]) -> FloatArray:
        after = before.copy()
        after[rows] = np.concatenate(found)
        return after

    found = replace(
        table,
        careful=table.careful | (todo & (effort is not SCREENING)),
        scores=table.scores.with_rows(rows, [scores for scores, _, _ in looks]),
        scales=with_found(table.scales, [scales for _, scales, _ in looks]),
        T_a_b=with_found(table.T_a_b, [T_a_b for _, _, T_a_b in looks]),
    )
    return replace(found, rigid=_rigid(found, bodies))


def _look(
    bodies: Bodies, table: PairTable, rows: IntArray, joint_types: Sequence[str], effort: Effort
) -> tuple[Scores, FloatArray, FloatArray]:
    """Scores of some pairs, weights for all frames that count, and the likeliest types' scales (P, S) and T_a_b."""
    tracks = counted_tracks(bodies, table.pairs[rows], at_most=effort.frames)
    fits = _fit_types(tracks, joint_types, effort)
    scores = score_fits(fits, tracks, table.scores.criterion)
    best = np.argmin(np.stack([scores.by_type[name] for name in fits]), axis=0)
    T_a_b = np.stack([f.model.frames.T_parent_axis @ f.model.frames.T_axis_child for f in fits.values()])
    scales = np.stack([fit.model.scales for fit in fits.values()])
    scores = scores.counted_for(table.counted[rows] / tracks.seen.sum(axis=-1))
    return scores, scales[best, np.arange(len(rows))], T_a_b[best, np.arange(len(rows))]


def _rigid(table: PairTable, bodies: Bodies) -> BoolArray:
    """(P,) rigid is the likeliest type, and the noise is near that of the pair in which one of the parts fits best.

    A free motion has no joint, and rigid is the least of all that fail; its residuals are then motion and not noise.
    """
    if "rigid" not in table.scores.by_type:
        return np.zeros(len(table.pairs), dtype=bool)
    usual = np.full((len(bodies.names), table.scales.shape[-1]), np.inf)
    known = np.flatnonzero(table.careful if table.careful.any() else table.enough)
    worst_first = known[np.argsort(-(table.scores.joined_weight[known] / table.counted[known]), kind="stable")]
    usual[table.pairs[worst_first]] = table.scales[worst_first][:, None]  # of several the last one stays
    usual[~bodies.noisy] = 0.0
    likeliest = np.min(np.stack(list(table.scores.by_type.values())), axis=0)
    rigid: BoolArray = table.enough & ~table.moved & (table.scores.by_type["rigid"] <= likeliest)
    most = np.maximum(usual[table.pairs[:, 0]], usual[table.pairs[:, 1]])
    return rigid & np.all(table.scales <= MISFIT**2 * most, axis=-1)
