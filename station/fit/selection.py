"""Which joint type explains a pair best, how sure that is, and whether any does: scores, probabilities, free pairs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station.fit.criteria import CRITERIA, Compared, check_criterion
from station.fit.evidence import correlation_time
from station.fit.free_pairs import Left, log_odds_of_free, stays_in_place
from station.fit.pairwise import JointFit, PairTracks
from station.fit.state_spread import continuous_states
from station.logs import FloatArray

__all__ = [
    "CRITERIA",
    "FREE",
    "Scores",
    "check_criterion",
    "continuous_states",
    "correlation_time",
    "score_fits",
]

BoolArray = NDArray[np.bool_]

# No joint type: the hypothesis that nothing joins two parts.
FREE = "free"


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores (P,) of each candidate type, -2 log scale, lower is better; that of nothing but outliers is 0.

    Attributes:
        criterion: how they were made.
        by_type: comparable within a pair; frames count by how many of them are independent there.
        joined_weight: (P,) score of the likeliest type with every frame counted in full.
        misfit: (P,) by how much the likeliest type fits worse than it should, comparable between pairs; where that is
            not known, the joined weight.
        surely_rigid: (P,) rigid is the likeliest type even if no error wobbles.
        free: (P,) log odds that a pair is free; -inf if that was not asked.
        criteria: scores of every criterion, that of `by_type` among them.
    """

    criterion: str
    by_type: Mapping[str, FloatArray]
    joined_weight: FloatArray
    misfit: FloatArray
    surely_rigid: BoolArray
    free: FloatArray
    criteria: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict[str, Mapping[str, FloatArray]])

    @property
    def weight(self) -> FloatArray:
        """(P,) the joined weight; infinite for a pair that is free."""
        return np.where(self.free > 0, np.inf, self.joined_weight)

    @staticmethod
    def unknown(criterion: str, joint_types: Sequence[str], pairs: int) -> Scores:
        """Of pairs of which nothing is known."""
        never = np.full(pairs, np.inf)
        by_type = dict.fromkeys(joint_types, never)
        return Scores(criterion, by_type, never, never, np.zeros(pairs, dtype=bool), -never)

    def counted_for(self, share: FloatArray) -> Scores:
        """With frames that count `share` (P,) times as much between pairs."""
        return replace(self, joined_weight=self.joined_weight * share, misfit=self.misfit * share)

    def with_rows(self, rows: NDArray[np.intp], some: Sequence[Scores]) -> Scores:
        """With the scores by this criterion of some of the pairs, told in pieces."""

        def changed(before: NDArray[Any], of: Callable[[Scores], NDArray[Any]]) -> NDArray[Any]:
            after = before.copy()
            after[rows] = np.concatenate([of(piece) for piece in some])
            return after

        return Scores(
            self.criterion,
            {name: changed(each, lambda s, name=name: s.by_type[name]) for name, each in self.by_type.items()},
            changed(self.joined_weight, lambda s: s.joined_weight),
            changed(self.misfit, lambda s: s.misfit),
            changed(self.surely_rigid, lambda s: s.surely_rigid),
            changed(self.free, lambda s: s.free),
        )

    def best_type(self, pair: int) -> str:
        """Name of the likeliest type of one pair."""
        return min(self.by_type, key=lambda name: float(self.by_type[name][pair]))

    def told(self, pair: int, criterion: str, *, free: bool) -> dict[str, float]:
        """Scores of one pair by a criterion; if `free` is a candidate, its own too."""
        scores = {name: float(score[pair]) for name, score in self.criteria.get(criterion, self.by_type).items()}
        if free and np.isfinite(self.free[pair]):
            joined = np.logaddexp.reduce([-0.5 * score for score in scores.values()])
            scores[FREE] = float(-2 * (joined + self.free[pair]))
        return scores

    def probabilities(self, pair: int, *, free: bool = False) -> dict[str, float]:
        """exp(-score / 2) of one pair by the evidence, normalised over the candidates."""
        told = self.told(pair, "evidence", free=free)
        scores = np.array(list(told.values()))
        odds = np.exp(-0.5 * (scores - scores.min()))
        return dict(zip(told, (odds / odds.sum()).tolist(), strict=True))


def score_fits(fits: Mapping[str, JointFit], tracks: PairTracks, criterion: str, *, free: bool | None = None) -> Scores:
    """Score every fitted type on P pairs by all criteria.

    Args:
        fits: by type.
        tracks: what they were fitted to.
        criterion: the one that chooses.
        free: whether pairs may be free; None if rigid is among the types: who leaves that out asks for a joint.
    """
    check_criterion(criterion)
    compared = Compared(fits, tracks)
    criteria = {name: score(compared) for name, score in CRITERIA.items()}
    evidence, names = compared.evidence, list(fits)
    table = np.stack([criteria[criterion][name] for name in names])
    odds = np.full(table.shape[1], -np.inf)
    if free or (free is None and "rigid" in fits):
        odds = _free(fits, tracks, np.argmin(table, axis=0), evidence.time)
        table, odds = _explained(fits, tracks, table, odds, evidence.time)
    scores = dict(zip(names, table, strict=True))
    criteria[criterion] = scores
    best = np.argmin(table, axis=0)
    surely = evidence.surely_rigid
    if criterion != "evidence":
        surely = np.equal(scores["rigid"], table.min(axis=0)) if "rigid" in scores else np.zeros(len(best), dtype=bool)
    in_full = evidence.in_full if criterion == "evidence" else scores
    joined = _of_best(in_full, names, best)
    misfit = _of_best(evidence.misfit, names, best) if criterion == "evidence" else joined
    return Scores(criterion, scores, joined, misfit, surely, odds, criteria)


def _of_best(by_type: Mapping[str, FloatArray], names: Sequence[str], best: NDArray[np.intp]) -> FloatArray:
    """(P,) values of each pair's likeliest type."""
    return np.stack([by_type[name] for name in names])[best, np.arange(len(best))]


def _explained(
    fits: Mapping[str, JointFit], tracks: PairTracks, table: FloatArray, odds: FloatArray, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Scores (types, P) and odds (P,) with types that leave turns unexplained put behind those that don't.

    A part in the middle of a ball joint turns and stays where it is: positions tell of no joint, and as noise of the
    orientations any turns are as likely. Where no type explains them the pair is free, and all stays as it is.
    """
    rows = np.flatnonzero(odds > 0)
    if rows.size:
        likeliest = Left.by(list(fits.values()), np.argmin(table, axis=0))
        rows = rows[stays_in_place(likeliest.take(rows), tracks.take(rows))]
    if not rows.size:
        return table, odds
    some, taken = tracks.take(rows), [fit.take(rows) for fit in fits.values()]
    still = taken[list(fits).index("rigid")] if "rigid" in fits else None
    left = np.stack([log_odds_of_free(fit, still, some, time[rows]) for fit in taken])
    explained = left.min(axis=0) < 0
    table, odds = table.copy(), odds.copy()
    table[:, rows] += 2 * explained * np.maximum(left, 0.0)
    odds[rows] = np.where(explained, left[np.argmin(table[:, rows], axis=0), np.arange(len(rows))], odds[rows])
    return table, odds


def _free(fits: Mapping[str, JointFit], tracks: PairTracks, best: NDArray[np.intp], time: FloatArray) -> FloatArray:
    """(P,) log odds of free against each pair's likeliest type."""
    return log_odds_of_free(Left.by(list(fits.values()), best), fits.get("rigid"), tracks, time)
