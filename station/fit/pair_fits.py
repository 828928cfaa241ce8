"""Fits of pairs to all frames that count: those of a careful look, where it looked at all, are made but once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.pairwise import JointFit
from station.fit.selection import Scores

IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PairFits:
    """Of P pairs: which (P, 2), parent first, the fits of all types, and their scores."""

    pairs: IntArray
    fits: Mapping[str, JointFit]
    scores: Scores

    def take(self, rows: IntArray) -> PairFits:
        """Those of some of the pairs."""
        fits = {name: fit.take(rows) for name, fit in self.fits.items()}
        return PairFits(self.pairs[rows], fits, self.scores.take(rows))

    @staticmethod
    def all_of(some: Sequence[PairFits]) -> PairFits:
        """Those of pairs one after another; all of the same types, frames and criteria."""
        fits = {name: JointFit.all_of([each.fits[name] for each in some]) for name in some[0].fits}
        scores = Scores.all_of([each.scores for each in some])
        return PairFits(np.concatenate([each.pairs for each in some]), fits, scores)

    def of(self, pairs: IntArray) -> PairFits:
        """Those of the pairs (P, 2) that are among them, in whichever order of their bodies."""
        row = {frozenset(pair): i for i, pair in enumerate(self.pairs.tolist())}
        found = [row[frozenset(pair)] for pair in pairs.tolist() if frozenset(pair) in row]
        return self.take(np.array(found, dtype=np.intp))

    def likeliest(self, joint_types: Sequence[str]) -> list[JointFit]:
        """Of each pair the fit of the likeliest of some types."""
        scores = np.stack([self.scores.by_type[name] for name in joint_types])
        best: list[int] = np.argmin(scores, axis=0).tolist()
        return [self.fits[joint_types[i]].take(np.array([row])) for row, i in enumerate(best)]
