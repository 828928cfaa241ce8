"""Random trees of 3 to 8 bodies with 1 to 3 trackers each: are groups, structure and types right.

Each joint moves by 15 to 120 deg or 5 to 25 cm, smoothly or by the random walk of the paper's Algorithm 2; the root
stands or moves; 1 to 3 mm and 0.5 to 2 deg of noise for each axis, 120 to 600 frames. A tree is right if the trackers
are told apart into its bodies, and the joints connect those that they do and have their types. Wanted: 98 % right.
Failures are listed with the number of their trial, which `--trial` runs alone.

Run: python -m tests.benchmarks.random_trees [--seed N] [--trials N] [--quick] [--all-types] [--trial N] [--workers N]
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from station.fit.options import FitOptions
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.made_joints import MadeObject, named, watch
from tests.benchmarks.made_trees import mistakes, random_tree
from tests.benchmarks.read_fits import ALL_TYPES, DEFAULT_TYPES, attempt

WANTED_PERCENT = 98
QUICK_BODIES, BODIES = (3, 5), (3, 8)
STEPS = ("groups", "edges", "types")


@dataclass(frozen=True)
class Trial:
    """One tree: what it was, what was wrong with the fit, and how long it took [s]."""

    number: int
    root: str
    states: str
    bodies: int
    parts: int
    frames: int
    noise: tuple[float, float]
    wrong: dict[str, str]
    wall_s: float

    @property
    def said(self) -> str:
        """A line for the list of failures."""
        what = f"{self.bodies} bodies, {self.parts} parts, {self.frames} frames, {self.root} root, {self.states}"
        noise = f"{1e3 * self.noise[0]:.1f} mm, {np.degrees(self.noise[1]):.1f} deg"
        told = "; ".join(f"{step}: {text}" for step, text in self.wrong.items())
        return f"  trial {self.number}: {what}, {noise}\n    {told}"


def made_tree(seed: int, number: int, kinds: tuple[str, ...], bodies: tuple[int, int]) -> tuple[MadeObject, str, list]:
    """The tree of a trial, how its states move, and the generator with the noise [m, rad]."""
    rng = np.random.default_rng([seed, number])
    walk, root_moves = bool(number % 2), bool(number // 2 % 2)
    made = random_tree(
        rng,
        bodies=int(rng.integers(bodies[0], bodies[1] + 1)),
        frames=int(rng.integers(120, 601)),
        kinds=kinds,
        root_moves=root_moves,
        walk=walk,
    )
    return made, "walk" if walk else "smooth", [rng, rng.uniform(0.001, 0.003), np.radians(rng.uniform(0.5, 2.0))]


def try_tree(job: tuple[int, int, tuple[str, ...], tuple[int, int]]) -> Trial:
    """Make a tree, learn it, compare."""
    seed, number, joint_types, bodies = job
    kinds = tuple(name for name in joint_types if name != "rigid")
    made, states, (rng, std_m, std_rad) = made_tree(seed, number, kinds, bodies)
    log = named(watch(rng, made.T_ref_part, std_m, std_rad), made.parts).log
    start_s = time.perf_counter()
    fit, failure = attempt(log, FitOptions(joint_types=joint_types))
    wall_s = time.perf_counter() - start_s
    wrong = {"groups": failure} if fit is None else mistakes(fit.tree, made)
    count, frames = len(set(made.body_of)), len(log.t_s)
    return Trial(number, made.root, states, count, len(made.parts), frames, (std_m, float(std_rad)), wrong, wall_s)


def row(name: str, trials: list[Trial]) -> str:
    """Shares of all trees that are right up to each step."""
    failed = [next((step for step in STEPS if step in trial.wrong), None) for trial in trials]
    right = [100 * np.mean([step is None or STEPS.index(step) > i for step in failed]) for i in range(len(STEPS))]
    wall_s = np.median([trial.wall_s for trial in trials])
    miss = "<" if right[-1] < WANTED_PERCENT else ""
    shares = "  ".join(f"{percent:9.1f}" for percent in right)
    return f"{name:24} {len(trials):6d}  {shares}  {wall_s:9.2f} {miss}"


def main() -> None:
    """Print a row for each kind of tree, one for all, and the failures."""
    options = parser(__doc__, trials=60, quick=12)
    options.add_argument("--all-types", action="store_true", help="screws and spherical joints among them")
    options.add_argument("--trial", type=int, default=None, help="this one alone")
    chosen = options.parse_args()
    types = ALL_TYPES if chosen.all_types else DEFAULT_TYPES
    numbers = range(trials_of(chosen)) if chosen.trial is None else [chosen.trial]
    jobs = [(chosen.seed, number, types, QUICK_BODIES if chosen.quick else BODIES) for number in numbers]
    trials = each(try_tree, jobs, chosen.workers)
    print(f"{'':24} {'':6}  {'right so far [%]':^31}  {'median':>9}")
    print(f"{'root, states':24} {'trees':>6}  " + "  ".join(f"{step:>9}" for step in STEPS) + f"  {'time [s]':>9}")
    for kind in sorted({(trial.root, trial.states) for trial in trials}):
        print(row(", ".join(kind), [trial for trial in trials if (trial.root, trial.states) == kind]))
    print(row("all", trials))
    for trial in trials:
        if trial.wrong:
            print(trial.said)


if __name__ == "__main__":
    main()
