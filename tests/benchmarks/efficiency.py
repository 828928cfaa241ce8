"""How near fits of simulated objects come to the Cramer-Rao bound: root mean square of axis errors over the bound's.

A packaged tree, moved by Algorithm 2's walk and watched with Gaussian and with uniform noise of the same covariance, by
the station's method and the paper's. The bound is of Gaussian noise; an efficient fit has a ratio of 1, within the
scatter that is printed with it: of so many squared errors in two directions, the worst case that all is in one of them.
Fits with a wrong tree are counted and left out.

Run: python -m tests.benchmarks.efficiency [--seed N] [--trials N] [--quick] [--workers N]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.learner import learn
from station.fit.options import FitOptions
from station.formats.trees import load_tree
from station.simulate import GaussianNoise, SimulationOptions, UniformNoise, simulate
from station.tree_bounds import tree_bounds
from station.tree_scores import score_tree
from tests.benchmarks.arguments import each, parser, trials_of

TREE, FRAMES = "experiment1", 200
STD_M, STD_RAD = 0.0005, 0.01
NOISES = {
    "gaussian": GaussianNoise(STD_M, STD_RAD),
    "uniform": UniformNoise(np.sqrt(3) * STD_M, np.sqrt(3) * STD_RAD),
}
METHODS = ("station", "paper")
INFLATION = (0, 1)


@dataclass(frozen=True)
class Trial:
    """Squares of axis errors over the bound's by joint; none where the tree is wrong."""

    ratios: dict[str, float]


def tried(job: tuple[str, str, int, int]) -> Trial:
    """(noise, method, inflation, seed): simulate, fit, compare."""
    noise, method, inflation, seed = job
    options = SimulationOptions(frames=FRAMES, noise=NOISES[noise], inflation=inflation)
    made = simulate(load_tree(TREE), options, seed)
    scores = score_tree(learn(made.log, FitOptions(method=method)).tree, made.tree, made.truth)
    if not scores.types_correct:
        return Trial({})
    covariance = options.noise.covariance(made.truth.T_ref_part)
    bounds = tree_bounds(made.tree, made.truth, made.states, covariance, root_moves=True)
    pairs = [(s, b) for s, b in zip(scores.joints, bounds, strict=True) if s.axis_error_rad is not None and b.axis_rad]
    return Trial({score.joint: (score.axis_error_rad / bound.axis_rad) ** 2 for score, bound in pairs})


def main() -> None:
    """Print a row for each noise, method and inflation."""
    chosen = parser(__doc__, trials=40, quick=8).parse_args()
    count = trials_of(chosen)
    print(f"{TREE}, {FRAMES} frames, deviations {1e3 * STD_M:g} mm and {np.degrees(STD_RAD):.2g} deg, {count} objects")
    print(f"{'noise':>9} {'method':>8} {'inflation':>9} {'right':>6} {'RMS / bound':>12} {'scatter':>8}")
    for noise in NOISES:
        for method in METHODS:
            for inflation in INFLATION if method == "station" else INFLATION[:1]:
                jobs = [(noise, method, inflation, chosen.seed + i) for i in range(count)]
                trials = each(tried, jobs, chosen.workers)
                squares = [square for trial in trials for square in trial.ratios.values()]
                right = sum(bool(trial.ratios) for trial in trials)
                ratio = np.sqrt(np.mean(squares)) if squares else np.nan
                scatter = 0.5 * np.sqrt(2 / max(len(squares), 1))
                print(f"{noise:>9} {method:>8} {inflation:>9} {right:>6} {ratio:12.2f} {scatter:8.2f}", flush=True)


if __name__ == "__main__":
    main()
