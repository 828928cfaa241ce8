"""Chains that rest for long while one joint after another moves: are groups, structure and types right.

One or two trackers on each of three to five bodies, 100 to 900 frames, joints in motion in a share of them; 1 to 3 mm
and 0.3 to 1.5 deg of errors for each axis, a share of whose variance goes with the pose, so that a tracker at rest errs
alike in all frames. The log tells the errors' covariance, or not. Rows with gross outliers, too. Wanted: 95 % right.

Run: python -m tests.benchmarks.rests [--seed N] [--trials N] [--quick] [--only TEXT] [--workers N]
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.made_rests import chain_that_rests, watch_resting
from tests.benchmarks.made_trees import mistakes
from tests.benchmarks.read_fits import attempt

WANTED_PERCENT = 95


@dataclass(frozen=True)
class Case:
    """Share of frames in motion, of variance that goes with the pose, of outliers; whether covariances are told."""

    moving: float
    by_pose: float
    outliers: float
    told: bool
    trackers: int = 2

    @property
    def name(self) -> str:
        """What is in the table."""
        covariance = "told" if self.told else "untold"
        return (
            f"{self.moving:.0%} moving, {self.by_pose:.0%} by pose, {self.outliers:.0%} outliers, {covariance}, "
            f"{self.trackers} each"
        )


CASES = tuple(
    Case(moving, by_pose, outliers, told, trackers)
    for told in (True, False)
    for trackers, moving, by_pose, outliers in (
        (2, 0.8, 0.9, 0.0),
        (2, 0.8, 0.99, 0.0),
        (2, 0.4, 0.9, 0.0),
        (2, 0.4, 0.99, 0.0),
        (2, 0.8, 0.0, 0.0),
        (2, 0.4, 0.0, 0.0),
        (2, 0.8, 0.0, 0.2),
        (1, 0.8, 0.0, 0.2),
        (1, 0.8, 0.9, 0.1),
    )
)


def try_chain(job: tuple[int, int, Case]) -> tuple[str, float]:
    """What is wrong, by its first step, with the fit of one chain; and its processor time [s]."""
    seed, number, case = job
    rng = np.random.default_rng([seed, number])
    bodies, frames = int(rng.integers(3, 6)), int(rng.integers(100, 901))
    std_m, std_rad = rng.uniform(0.001, 0.003), np.radians(rng.uniform(0.3, 1.5))
    made = chain_that_rests(rng, bodies=bodies, frames=frames, moving=case.moving, trackers=case.trackers)
    log = watch_resting(rng, made, std_m, std_rad, by_pose=case.by_pose, outliers=case.outliers, told=case.told)
    start_s = time.process_time()
    fit, failure = attempt(log)
    cpu_s = time.process_time() - start_s
    return next(iter({"groups": failure} if fit is None else mistakes(fit.tree, made)), ""), cpu_s


def main() -> None:
    """Print a row a case."""
    options = parser(__doc__, trials=40, quick=8)
    options.add_argument("--only", default="", help="cases with this text in their name")
    chosen = options.parse_args()
    print(f"{'':66} {'right':>7}   wrong groups, edges, types   {'mean [s]':>8}")
    for case in (case for case in CASES if chosen.only in case.name):
        found = each(try_chain, [(chosen.seed, i, case) for i in range(trials_of(chosen))], chosen.workers)
        wrong = [sum(step == kind for step, _ in found) for kind in ("groups", "edges", "types")]
        right = 100 * (1 - sum(wrong) / len(found))
        miss = "<" if right < WANTED_PERCENT else ""
        cpu_s = np.mean([cpu for _, cpu in found])
        print(
            f"{case.name:66} {right:5.1f} %   {wrong[0]:8d} {wrong[1]:8d} {wrong[2]:8d}   {cpu_s:8.2f} {miss}",
            flush=True,
        )


if __name__ == "__main__":
    main()
