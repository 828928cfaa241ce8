"""Fit every joint type to many pairs of bodies and score them, with care only where it could matter.

All pairs are looked at in a few frames. The edges of the minimum spanning forest over those weights, and all pairs that
could still be in it if a careful look made them as much better as it ever does, are then fitted with care, until every
edge of the forest is. As long as it is the parts' noise that is to be found, a few frames do for this, but for the
forest's rigid edges: what becomes one body stays one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from station.fit import pairwise
from station.fit.asking import COMPARING, FITTING, SCREENING, Asking, Effort, Explained, Question, ask
from station.fit.bodies import Bodies, counted_tracks, oriented_pairs
from station.fit.known_joints import KnownJoints
from station.fit.pair_fits import PairFits
from station.fit.pairwise import JointFit, PairTracks, told_by_pose
from station.fit.rare_motion import moved_rarely
from station.fit.selection import Scores
from station.fit.structure import contenders, spanning_forest
from station.kinematics.joints import JointFrames
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
Told = TypeVar("Told")

# Common frames that a pair needs: below, the 11 numbers of a revolute joint and its states fit whatever noise there is.
MIN_FRAMES = 10
# Share of the log's frames beyond which seeing a pair together more often makes it no better an edge: pairs compare by
# the score of a frame. In the rest of the frames the tree explains the parts through their neighbours. Below, a pair
# counts for less: what did not move in a few frames looks rigid.
FULL_SHARE = 0.25
# Ratio of deviations: a rigid joint with so many times the noise that its parts have elsewhere is no rigid joint.
MISFIT = 4.0
# The same by a first look, from which on a careful one makes no rigid joint of it.
SCREEN_MISFIT = 2 * MISFIT
# How much better than the first look a careful one may make a pair, in -2 log likelihood of a frame: on simulated trees
# it is 0.5 at the median and 3.2 at most.
SCREEN_MARGIN = 6.0


@dataclass(frozen=True, eq=False)
class PairTable:
    """What is known of P pairs (P, 2), parent first.

    Attributes:
        bodies: how many.
        pairs: (P, 2) bodies.
        barred: (P,) only a rigid joint may join them.
        enough: (P,) enough common frames.
        counted: (P,) common frames that count for an edge.
        careful: (P,) fitted with care; the others can be no edges, and what is known of them is of a first look.
        compared: (P,) so they were, to as many frames as types are told by.
        scores: of all types.
        scales: (P, S) noise scales of the best type.
        still: (P,) known not to have moved in a few frames among many.
        moved: (P,) known to have.
        rigid: (P,) the best type is rigid, its noise is what its parts have elsewhere, and not known to have moved.
        misfit: (P,) the noise is far from what its parts have elsewhere.
        T_a_b: (P, 4, 4) pose of the best type at the state 0.
        joints: of all types, as far as they were fitted.
        fitted: of pairs that were fitted with care to all frames, in pieces.
    """

    bodies: int
    pairs: IntArray
    barred: BoolArray
    enough: BoolArray
    counted: FloatArray
    careful: BoolArray
    compared: BoolArray
    scores: Scores
    scales: FloatArray
    still: BoolArray
    moved: BoolArray
    rigid: BoolArray
    misfit: BoolArray
    T_a_b: FloatArray
    joints: KnownJoints
    fitted: tuple[PairFits, ...] = ()

    @cached_property
    def edge_weights(self) -> FloatArray:
        """(P,) weights of edges: infinite without enough frames, and where only a rigid joint may be."""
        weights = np.where(self.enough & (self.rigid | ~self.barred), self.scores.weight, np.inf)
        return _in_order(self, weights, np.zeros(len(weights)))

    @cached_property
    def edges(self) -> IntArray:
        """Rows of the minimum spanning forest."""
        return spanning_forest(self.bodies, self.pairs, self.edge_weights)

    @property
    def fitted_edges(self) -> PairFits | None:
        """Those of the forest's edges that were fitted with care to all frames."""
        found = [some.of(self.pairs[self.edges]) for some in self.fitted]
        return PairFits.all_of(found) if found else None


def fit_types(tracks: PairTracks, joint_types: Sequence[str], *, quickly: bool) -> dict[str, JointFit]:
    """Every type fitted to all pairs; pairs without orientations by their positions."""
    effort = COMPARING if quickly else FITTING
    return pairwise.fit_types(tracks, joint_types, iterations=effort.iterations, tolerance=effort.tolerance)


def question_of(
    bodies: Bodies,
    pairs: IntArray,
    joint_types: Sequence[str],
    effort: Effort,
    criterion: str,
    *,
    free: bool | None,
    told: Callable[[Explained], Told],
    known: KnownJoints | None = None,
) -> Question[Told]:
    """About pairs (P, 2) of bodies as they are oriented, by frames that count; from what is known of some pairs."""

    def tracks(rows: IntArray) -> PairTracks:
        return counted_tracks(bodies, pairs[rows], at_most=effort.frames)

    start = None if known is None else known.of(pairs, joint_types)
    start = None if start is None or not start.known.any() else start
    return Question(len(pairs), len(bodies.seen), tracks, tuple(joint_types), effort, criterion, free, told, start)


def fit_pairs(
    bodies: Bodies, pairs: IntArray, joint_types: Sequence[str], criterion: str, known: KnownJoints | None = None
) -> Asking[PairFits]:
    """All types fitted to all frames that count of pairs (P, 2) as they are oriented, and scored."""

    def told(found: Explained) -> tuple[Mapping[str, JointFit], Scores]:
        return found.fits, found.scores

    question = question_of(bodies, pairs, joint_types, FITTING, criterion, free=None, told=told, known=known)
    found = yield from ask(question)
    fits = {name: JointFit.all_of([fits[name] for fits, _ in found]) for name in joint_types}
    return PairFits(pairs, fits, Scores.all_of([scores for _, scores in found]))


def compare_pairs(
    bodies: Bodies,
    pairs: IntArray,
    joint_types: Sequence[str],
    criterion: str,
    *,
    effort: Effort = COMPARING,
    only_rigid: BoolArray | None = None,
    known: KnownJoints | None = None,
) -> Asking[PairTable]:
    """Fit and score pairs (P, 2) of bodies; pairs with too few common frames get infinite scores.

    Args:
        bodies: K of them.
        pairs: (P, 2).
        joint_types: the candidates.
        criterion: how they are compared.
        effort: care that pairs are fitted with that may be edges; with less than `COMPARING`, rigid edges with that.
        only_rigid: (K,) bodies that no movable joint may join; none if None.
        known: of some of the pairs, to start at.
    """
    pairs = oriented_pairs(bodies, pairs)
    barred: BoolArray = np.zeros(len(pairs), dtype=bool)
    if only_rigid is not None:
        barred |= only_rigid[pairs].any(axis=-1)
    table = _nothing_known(bodies, pairs, barred, joint_types, criterion)
    if known is not None:
        table = replace(table, joints=known.of(pairs, joint_types))
    todo = table.enough
    if todo.any():
        table = yield from _looked_at(bodies, table, todo, joint_types, SCREENING)
        todo = _undecided(table)
    while todo.any():  # what a careful look finds may make contenders of other pairs
        table = yield from _looked_at(bodies, table, todo, joint_types, effort)
        todo = _undecided(table)
        if not todo.any():
            looked_at = table
            table = yield from _with_rigid_compared(bodies, table, joint_types)
            table = yield from _with_rare_motion(bodies, table, joint_types)
            todo = todo if table is looked_at else _undecided(table)
    return table


def _with_rigid_compared(bodies: Bodies, table: PairTable, joint_types: Sequence[str]) -> Asking[PairTable]:
    """The table with the forest's rigid edges told by as many frames as types are, until each is."""
    while (table.rigid & ~table.compared).any():
        todo = np.zeros(len(table.pairs), dtype=bool)
        todo[table.edges] = (table.rigid & ~table.compared)[table.edges]
        if not todo.any():
            break
        table = yield from _looked_at(bodies, table, todo, joint_types, COMPARING)
    return table


def _with_rare_motion(bodies: Bodies, table: PairTable, joint_types: Sequence[str]) -> Asking[PairTable]:
    """The table with all frames of the forest's rigid edges looked at, until each is."""
    while (table.rigid & ~table.still).any():
        new = table.edges[(table.rigid & ~table.still)[table.edges]]
        if not new.size:
            break
        found = yield from moved_rarely(bodies, table.pairs[new], table.T_a_b[new], table.scales[new], joint_types)
        still, moved = table.still.copy(), table.moved.copy()
        still[new], moved[new] = ~found, found
        table = replace(table, still=still, moved=moved, rigid=table.rigid & ~moved)
    return table


def _in_order(table: PairTable, weights: FloatArray, less: FloatArray) -> FloatArray:
    """(P,) weights less so much, where they are still below 0, as misfits: all below 0, and in the order of these."""
    misfit = table.scores.misfit
    looked_at = np.isfinite(misfit)
    most = np.max(misfit, where=looked_at, initial=0.0) + 1.0
    return np.where(looked_at & (weights < less), misfit - less - most, np.inf)


def _undecided(table: PairTable) -> BoolArray:
    """(P,) pairs that were not fitted with care and may be edges."""
    margin = SCREEN_MARGIN * table.counted
    least = _in_order(table, np.where(table.enough, table.scores.joined_weight, np.inf), margin)
    least = np.where(table.barred & table.misfit, np.inf, least)
    if "rigid" in table.scores.by_type:
        likeliest = np.min(np.stack(list(table.scores.by_type.values())), axis=0)
        least = np.where(table.barred & (table.scores.by_type["rigid"] > likeliest + margin), np.inf, least)
    return contenders(table.bodies, table.pairs, table.edge_weights, least, table.edges) & ~table.careful


def _nothing_known(
    bodies: Bodies, pairs: IntArray, barred: BoolArray, joint_types: Sequence[str], criterion: str
) -> PairTable:
    P = len(pairs)
    common = np.sum(bodies.oriented[:, pairs[:, 0]] & bodies.seen[:, pairs[:, 1]], axis=0)
    no = np.zeros(P, dtype=bool)
    return PairTable(
        bodies=len(bodies.names),
        pairs=pairs,
        barred=barred,
        enough=common >= MIN_FRAMES,
        counted=np.minimum(common, max(FULL_SHARE * len(bodies.seen), 1.0)),
        careful=no,
        compared=no,
        scores=Scores.unknown(criterion, joint_types, P),
        scales=np.ones((P, 2 if bodies.covariance is None else 1)),
        still=no,
        moved=no,
        rigid=no,
        misfit=no,
        T_a_b=np.tile(np.eye(4), (P, 1, 1)),
        joints=KnownJoints.none(pairs, joint_types),
    )


def _looked_at(
    bodies: Bodies, table: PairTable, todo: BoolArray, joint_types: Sequence[str], effort: Effort
) -> Asking[PairTable]:
    """The table after a look at some of its pairs (P,)."""
    rows = np.flatnonzero(todo)
    criterion = table.scores.criterion

    def told(found: Explained) -> _Look:
        everything = effort is COMPARING and found.tracks.seen.shape[1] == len(bodies.seen)
        return _Look.of(found, everything=everything)

    question = question_of(
        bodies, table.pairs[rows], joint_types, effort, criterion, free=None, told=told, known=table.joints
    )
    looks = yield from ask(question)
    seen = np.concatenate([look.seen for look in looks])
    scores = Scores.all_of([look.scores for look in looks]).counted_for(table.counted[rows] / seen)

    def with_found(before: FloatArray, found: Sequence[FloatArray]) -> FloatArray:
        after = before.copy()
        after[rows] = np.concatenate(found)
        return after

    found = replace(
        table,
        careful=table.careful | (todo & (effort is not SCREENING)),
        compared=table.compared | (todo & (effort is COMPARING)),
        scores=table.scores.with_rows(rows, scores),
        scales=with_found(table.scales, [look.scales for look in looks]),
        T_a_b=with_found(table.T_a_b, [look.T_a_b for look in looks]),
        joints=table.joints.with_rows(rows, _joints(table.pairs[rows], looks)),
        fitted=(*table.fitted, *_fitted(table.pairs[rows], looks)),
    )
    return replace(found, rigid=_rigid(found, bodies), misfit=~_noise_within(found, bodies, SCREEN_MISFIT))


@dataclass(frozen=True, eq=False)
class _Look:
    """What is kept of a look at P pairs: scores, the likeliest types' scales (P, S) and T_a_b, seen frames, all joints,
    whether they are told by orientations, and the fits themselves if they are of all frames.
    """

    scores: Scores
    scales: FloatArray
    T_a_b: FloatArray
    seen: IntArray
    frames: Mapping[str, JointFrames]
    by_pose: BoolArray
    fits: Mapping[str, JointFit] | None

    @staticmethod
    def of(found: Explained, *, everything: bool) -> _Look:
        fits, P = found.fits, len(found.tracks.seen)
        best = np.argmin(np.stack([found.scores.by_type[name] for name in fits]), axis=0)
        T_a_b = np.stack([f.model.frames.T_parent_axis @ f.model.frames.T_axis_child for f in fits.values()])
        scales = np.stack([fit.model.scales for fit in fits.values()])
        seen = found.tracks.seen.sum(axis=-1)
        frames = {name: fit.model.frames for name, fit in fits.items()}
        rows, by_pose = np.arange(P), told_by_pose(found.tracks)
        kept = fits if everything else None
        return _Look(found.scores, scales[best, rows], T_a_b[best, rows], seen, frames, by_pose, kept)


def _pieces(pairs: IntArray, looks: Sequence[_Look]) -> list[tuple[IntArray, _Look]]:
    """Pairs (P, 2) as they were looked at, with each look."""
    ends = np.cumsum([len(look.by_pose) for look in looks])
    return list(zip(np.split(pairs, ends[:-1]), looks, strict=True))


def _joints(pairs: IntArray, looks: Sequence[_Look]) -> KnownJoints:
    """Of pairs (P, 2) that were looked at in pieces."""
    some = [
        KnownJoints(piece, np.ones(len(piece), dtype=bool), look.by_pose, look.frames)
        for piece, look in _pieces(pairs, looks)
    ]
    return KnownJoints.all_of(some)


def _fitted(pairs: IntArray, looks: Sequence[_Look]) -> list[PairFits]:
    """Of pairs (P, 2) that were looked at in pieces, those of which all frames were."""
    return [PairFits(piece, look.fits, look.scores) for piece, look in _pieces(pairs, looks) if look.fits is not None]


def _rigid(table: PairTable, bodies: Bodies) -> BoolArray:
    """(P,) rigid is the likeliest type, and the noise is near that of the pair in which one of the parts fits best.

    A free motion has no joint, and rigid is the least of all that fail; its residuals are then motion and not noise.
    """
    if "rigid" not in table.scores.by_type:
        return np.zeros(len(table.pairs), dtype=bool)
    likeliest = np.min(np.stack(list(table.scores.by_type.values())), axis=0)
    rigid: BoolArray = table.enough & ~table.moved & (table.scores.by_type["rigid"] <= likeliest)
    return rigid & _noise_within(table, bodies, MISFIT)


def _noise_within(table: PairTable, bodies: Bodies, factor: float) -> BoolArray:
    """(P,) deviations are no more than so many times those of the pair in which one of the parts fits best."""
    usual = np.full((len(bodies.names), table.scales.shape[-1]), np.inf)
    known = np.flatnonzero(table.careful if table.careful.any() else table.enough)
    worst_first = known[np.argsort(-(table.scores.joined_weight[known] / table.counted[known]), kind="stable")]
    usual[table.pairs[worst_first]] = table.scales[worst_first][:, None]  # of several the last one stays
    usual[~bodies.noisy] = 0.0
    most = np.maximum(usual[table.pairs[:, 0]], usual[table.pairs[:, 1]])
    return np.all(table.scales <= factor**2 * most, axis=-1)
