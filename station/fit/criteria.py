"""The criteria by which joint types compare: a registry; add a line to it, and it is scored, written and tested.

A criterion takes what is being compared, and gives (P,) scores of each type on a -2 log scale, lower is better, with
nothing but outliers at 0. `evidence` integrates states out; the others take the likelihood at the best states and count
a parameter for each inlier's state, but `paper-aic`, which has the paper's counts and no price for the states (24).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from station.errors import InvalidData
from station.fit.evidence import Evidence, evidence, geometry_parameters, total_of
from station.fit.pairwise import JointFit, PairTracks
from station.logs import FloatArray


@dataclass(frozen=True, eq=False)
class Counted:
    """A type at its best states: -2 log likelihood, parameters with and without states, numbers measured; all (P,)."""

    total: FloatArray
    parameters: FloatArray
    measured: FloatArray
    paper_parameters: int


@dataclass(frozen=True, eq=False)
class Compared:
    """Types fitted to the same P pairs, and what criteria need to know of them, worked out once."""

    fits: Mapping[str, JointFit]
    tracks: PairTracks

    @cached_property
    def evidence(self) -> Evidence:
        """States integrated out."""
        return evidence(self.fits, self.tracks)

    @cached_property
    def counted(self) -> dict[str, Counted]:
        """At the best states."""
        return {name: self._counted(fit) for name, fit in self.fits.items()}

    def _counted(self, fit: JointFit) -> Counted:
        return Counted(
            total_of(fit, self.tracks, fit.log_density - 0.5 * fit.chi2),
            geometry_parameters(fit, self.tracks) + fit.joint.states * fit.inlier.sum(axis=-1),
            (self.tracks.dimensions * fit.inlier).sum(axis=-1),
            fit.joint.paper_parameters,
        )


Criterion = Callable[[Compared], Mapping[str, FloatArray]]


def _priced(price: Callable[[Counted], FloatArray | float]) -> Criterion:
    def score(compared: Compared) -> dict[str, FloatArray]:
        return {name: each.total + price(each) for name, each in compared.counted.items()}

    return score


def _corrected(each: Counted) -> FloatArray:
    """AICc's price; infinite where there are not more numbers than parameters."""
    k, n = each.parameters, each.measured
    return np.where(n - k > 1, 2 * k + 2 * k * (k + 1) / np.where(n - k > 1, n - k - 1, 1.0), np.inf)


CRITERIA: Mapping[str, Criterion] = {
    "evidence": lambda compared: compared.evidence.scores,
    "bic": _priced(lambda each: each.parameters * np.log(np.maximum(each.measured, 2.0))),
    "aic": _priced(lambda each: 2 * each.parameters),
    "aicc": _priced(_corrected),
    "paper-aic": _priced(lambda each: 2.0 * each.paper_parameters),
}


def check_criterion(name: str) -> None:
    """Raise InvalidData for a criterion that isn't there, with the choices."""
    if name not in CRITERIA:
        raise InvalidData(f"criterion '{name}' is unknown; choose one of {', '.join(CRITERIA)}")
