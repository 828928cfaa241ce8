"""Which joint type explains a pair best, how sure that is, and whether any does: scores, probabilities, free pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from station.fit.criteria import CRITERIA, Compared, check_criterion
from station.fit.evidence import correlation_time
from station.fit.free_pairs import log_odds_of_free, stays_in_place
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
        weight: (P,) score of the likeliest type with every frame counted in full, comparable between pairs; infinite
            for a pair that is free.
        surely_rigid: (P,) rigid is the likeliest type even if no error wobbles.
        criteria: scores of every criterion, that of `by_type` among them.
        free: (P,) log odds that a pair is free; None if that was not asked.
        joined_weight: (P,) the weight as if no pair were free.
    """

    criterion: str
    by_type: Mapping[str, FloatArray]
    weight: FloatArray
    surely_rigid: BoolArray
    criteria: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict[str, Mapping[str, FloatArray]])
    free: FloatArray | None = None
    joined_weight: FloatArray | None = None

    def best_type(self, pair: int) -> str:
        """Name of the likeliest type of one pair."""
        return min(self.by_type, key=lambda name: float(self.by_type[name][pair]))

    def told(self, pair: int, criterion: str, *, free: bool) -> dict[str, float]:
        """Scores of one pair by a criterion; if `free` is a candidate, its own too."""
        scores = {name: float(score[pair]) for name, score in self.criteria.get(criterion, self.by_type).items()}
        if free and self.free is not None:
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
    odds = None
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
    joined = np.stack([in_full[name] for name in names])[best, np.arange(len(best))]
    weight = joined if odds is None else np.where(odds > 0, np.inf, joined)
    return Scores(criterion, scores, weight, surely, criteria, odds, joined)


def _explained(
    fits: Mapping[str, JointFit], tracks: PairTracks, table: FloatArray, odds: FloatArray, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Scores (types, P) and odds (P,) with types that leave turns unexplained put behind those that don't.

    A part in the middle of a ball joint turns and stays where it is: positions tell of no joint, and as noise of the
    orientations any turns are as likely. Where no type explains them the pair is free, and all stays as it is.
    """
    likeliest = np.argmin(table, axis=0)
    rows = np.flatnonzero(odds > 0)
    if not rows.size:
        return table, odds
    some, taken = tracks.take(rows), [fit.take(rows) for fit in fits.values()]
    in_place = np.stack([stays_in_place(fit, some) for fit in taken])[likeliest[rows], np.arange(len(rows))]
    still = taken[list(fits).index("rigid")] if "rigid" in fits else None
    left = np.stack([log_odds_of_free(fit, still, some, time[rows]) for fit in taken])
    explained = in_place & (left.min(axis=0) < 0)
    table, odds = table.copy(), odds.copy()
    table[:, rows] += 2 * explained * np.maximum(left, 0.0)
    odds[rows] = np.where(explained, left[np.argmin(table[:, rows], axis=0), np.arange(len(rows))], odds[rows])
    return table, odds


def _free(fits: Mapping[str, JointFit], tracks: PairTracks, best: NDArray[np.intp], time: FloatArray) -> FloatArray:
    """(P,) log odds of free against each pair's likeliest type."""
    odds = np.zeros(len(best))
    still = fits.get("rigid")
    for i, fit in enumerate(fits.values()):  # types are few
        rows = np.flatnonzero(best == i)
        if rows.size:
            mine = fit.take(rows)
            odds[rows] = log_odds_of_free(
                mine, None if still is None else still.take(rows), tracks.take(rows), time[rows]
            )
    return odds
