"""Whether the stated probability of a joint's type is the share of cases in which it is right.

One part against the reference, 60 to 200 frames, 3 mm and 0.02 rad for each axis: a third rigid, a third prismatic, a
third revolute, at random. A slide is 2 to 60 mm long, a turn 0.2 to 10 deg wide at a radius of 3 cm to 3 m, each drawn
evenly by its logarithm: from below the noise to well above, so that the type is often open. The first table: the type
given, of the cases in which a joint was reported, for only a joint states a probability. The second: every candidate of
the same cases. Where stated and right differ by more than two standard errors: <.

Run: python -m tests.benchmarks.calibration_of_probability [--seed N] [--trials N] [--quick] [--workers N]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.made_joints import single_joint, watch
from tests.benchmarks.read_fits import DEFAULT_TYPES, attempt, found_type

STD_M, STD_RAD = 0.003, 0.02
FRAMES = (60, 200)
SLIDE_M, TURN_RAD, RADIUS_M = (0.002, 0.06), (np.radians(0.2), np.radians(10.0)), (0.03, 3.0)
BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 0.999, 1.0)
STANDARD_ERRORS = 2.0
LEAST_PROBABILITY = 1e-6  # a certainty that is wrong costs no more than this


@dataclass(frozen=True)
class Case:
    """The truth, the type found, and the stated probabilities; none where no joint was reported."""

    truth: str
    found: str
    probability: Mapping[str, float]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def try_case(seed: list[int]) -> Case:
    """Draw a joint, learn it, read the probabilities."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(DEFAULT_TYPES))
    slide_m, turn_rad, radius_m = (log_uniform(rng, *ends) for ends in (SLIDE_M, TURN_RAD, RADIUS_M))
    travel = turn_rad if kind == "revolute" else slide_m
    made = single_joint(rng, kind, frames=int(rng.integers(*FRAMES)), travel=travel, arm_m=radius_m)
    fit, failure = attempt(watch(rng, made.T_ref_part, STD_M, STD_RAD).log)
    if fit is None:
        return Case(kind, failure, {})
    stated = fit.tree.joints[0].probability if fit.tree.joints else None
    return Case(kind, found_type(fit.tree), stated or {})


def show(title: str, pairs: Sequence[tuple[float, bool]]) -> None:
    """Print a row for each bin of (stated probability, whether right)."""
    print(title)
    print(f"{'stated':>15}  {'cases':>6}  {'mean stated [%]':>15}  {'right [%]':>9}  {'error [%]':>9}")
    for low, high in pairwise(BINS):
        some = [(p, right) for p, right in pairs if low <= p and (p < high or high == BINS[-1])]
        if not some:
            continue
        stated, right = np.mean(some, axis=0)
        # The error of a share that would be as stated, and at least what one case makes.
        error = max(np.sqrt(stated * (1 - stated) / len(some)), 0.5 / len(some))
        miss = "<" if abs(stated - right) > STANDARD_ERRORS * error else ""
        numbers = f"{len(some):6d}  {100 * stated:15.1f}  {100 * right:9.1f}  {100 * error:9.1f} {miss}"
        print(f"{low:6.3f} to {high:5.3f}  {numbers}")


def show_confusion(cases: Sequence[Case]) -> None:
    """Print how often each type was called what."""
    called = sorted({case.found for case in cases})
    print(f"{'truth':12}" + "".join(f"{name:>12}" for name in called) + "   called")
    for truth in DEFAULT_TYPES:
        some = [case.found for case in cases if case.truth == truth]
        print(f"{truth:12}" + "".join(f"{some.count(name):12d}" for name in called))


def main() -> None:
    """Print both tables and what was called what."""
    chosen = parser(__doc__, trials=1000, quick=100).parse_args()
    cases = each(try_case, [[chosen.seed, trial] for trial in range(trials_of(chosen))], chosen.workers)
    stated = [case for case in cases if case.probability]
    given = [(case.probability[case.found], case.found == case.truth) for case in stated]
    show("The type given", given)
    show("Every candidate", [(p, name == case.truth) for case in stated for name, p in case.probability.items()])
    show_confusion(cases)
    if stated:
        known = [max(case.probability.get(case.truth, 0.0), LEAST_PROBABILITY) for case in stated]
        score = -np.mean(np.log(known))
        print(f"mean of -log of the truth's probability: {score:.3f} (0 is best; {np.log(3):.3f} for thirds)")


if __name__ == "__main__":
    main()
