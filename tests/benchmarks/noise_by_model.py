"""Does it matter how noise is distributed? Both methods under each model of noise, all with the same variances.

The paper (IV-C) has its noise uniform in se(3) and asks for other distributions. Here the lamp, three hinges in a
chain, is watched with noise whose mean variances over the three axes of position, and over those of orientation, are
alike for all models: a box for uniform noise, heavy tails for Student's (three degrees of freedom), depth and tilt
worse and 2 % of the poses turned over for a camera's; without those flips, too. 200 frames of the bounded walk; the
motion of a trial is the same for all models and levels. All right means the bodies, which of them are joined, and
each joint's type.

Run: python -m tests.benchmarks.noise_by_model [--seed N] [--trials N] [--quick] [--workers N]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from station.errors import StationError
from station.fit.learner import learn
from station.fit.options import METHODS, FitOptions
from station.formats.trees import load_tree
from station.simulate import Noise, SimulationOptions, make_noise, simulate
from station.tree_scores import score_tree
from tests.benchmarks.arguments import each, parser, trials_of

TREE, FRAMES = "lamp", 200
LEVELS = ((0.002, 0.02), (0.01, 0.1))  # standard deviations for each axis, m and rad
FREEDOM = 3
DEPTH, TILT = 5.0, 3.0
# What a magnitude has to be for a standard deviation of 1: of position, of orientation.
MODELS: Mapping[str, tuple[str, float, float, Mapping[str, float]]] = {
    "uniform": ("uniform", math.sqrt(3), math.sqrt(3), {}),
    "gaussian": ("gaussian", 1.0, 1.0, {}),
    "student": ("student", math.sqrt((FREEDOM - 2) / FREEDOM), math.sqrt((FREEDOM - 2) / FREEDOM), {}),
    "camera, no flips": ("camera", math.sqrt(3 / (2 + DEPTH**2)), math.sqrt(3 / (2 * TILT**2 + 1)), {"flips": 0.0}),
    "camera": ("camera", math.sqrt(3 / (2 + DEPTH**2)), math.sqrt(3 / (2 * TILT**2 + 1)), {"flips": 0.02}),
}


@dataclass(frozen=True)
class Job:
    """One fit."""

    model: str
    level: tuple[float, float]
    method: str
    seed: int


def noise_of(model: str, level: tuple[float, float]) -> Noise:
    """The model with these standard deviations [m, rad]."""
    name, translation, rotation, more = MODELS[model]
    return make_noise(name, translation * level[0], rotation * level[1], more)


def attempt(job: Job) -> tuple[bool, float]:
    """Whether all is right, and the largest error of an axis [deg]; NaN where it isn't."""
    options = SimulationOptions(frames=FRAMES, noise=noise_of(job.model, job.level))
    made = simulate(load_tree(TREE), options, job.seed)
    try:
        found = learn(made.log, FitOptions(method=job.method))
    except StationError:
        return False, math.nan
    scores = score_tree(found.tree, made.tree, made.truth)
    if not (scores.groups_correct and scores.structure_correct and scores.types_correct):
        return False, math.nan
    return True, math.degrees(max(joint.axis_error_rad or 0.0 for joint in scores.joints))


def main() -> None:
    """Print a table for each method."""
    chosen = parser(__doc__, trials=20, quick=2).parse_args()
    seeds = range(chosen.seed, chosen.seed + trials_of(chosen))
    levels = LEVELS[:1] if chosen.quick else LEVELS
    head = "".join(f"{1e3 * m:>9.0f} mm {rad:>5.2f} rad" for m, rad in levels)
    for method in METHODS:
        print(f"\n{method}: all right [%], median of the largest axis error where so [deg]\n{'':<18}{head}")
        for model in MODELS:
            cells = ""
            for level in levels:
                found = each(attempt, [Job(model, level, method, seed) for seed in seeds], chosen.workers)
                right = np.array([ok for ok, _ in found])
                axes = [error for ok, error in found if ok]
                cells += f"{100 * right.mean():>13.0f} {np.median(axes) if axes else math.nan:>7.2f}"
            print(f"{model:<18}{cells}", flush=True)


if __name__ == "__main__":
    main()
