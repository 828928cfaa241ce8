"""Processor time of fits of small objects by trackers, frames and method: what a sweep of thousands of fits lives on.

Objects of four bodies joined by random hinges and slides, that move as in Experiment 1: a root that walks, states that
walk, a tracker a body, then 2, 3 and 4 (its inflation of 0 to 3). Wanted is a sweep of 4096 fits in under two minutes
on two cores: 58 ms of processor a fit in the mean. Each fit is in one thread, as a sweep's are; of several runs the
least counts, since a machine that is busy with other things takes longer.

Run: OPENBLAS_NUM_THREADS=1 python -m tests.benchmarks.small_fits [--seed N] [--trials N] [--quick]
"""

from __future__ import annotations

import time

import numpy as np

from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.parallel import in_this_thread
from station.logs import PoseLog
from tests.benchmarks.arguments import parser, trials_of
from tests.benchmarks.made_joints import watch
from tests.benchmarks.made_trees import random_tree

WANTED_MS = 1e3 * 120 * 2 / 4096
BODIES, TRACKERS, FRAMES = 4, (1, 2, 3, 4), (50, 100, 300)
QUICK_TRACKERS, QUICK_FRAMES = (1, 2), (100,)
METHODS = ("station", "paper")
STD_M, STD_RAD = 0.002, 0.02
RUNS = 2


def made_log(trackers: int, frames: int, seed: int) -> PoseLog:
    """A log of an object with so many trackers on each body."""
    rng = np.random.default_rng([seed, trackers, frames])
    kinds = ("prismatic", "revolute")
    made = random_tree(
        rng, bodies=BODIES, frames=frames, kinds=kinds, root_moves=True, walk=True, trackers=(trackers, trackers)
    )
    return watch(rng, made.T_ref_part, STD_M, STD_RAD).log


def time_ms(log: PoseLog, method: str) -> float:
    """Least processor time of a fit [ms]."""
    taken_ms: list[float] = []
    for _ in range(RUNS):
        start_s = time.thread_time()
        learn(log, FitOptions(method=method))
        taken_ms.append(1e3 * (time.thread_time() - start_s))
    return min(taken_ms)


def main() -> None:
    """Print the table: means over objects."""
    chosen = parser(__doc__, trials=4, quick=2).parse_args()
    objects = range(trials_of(chosen))
    trackers = QUICK_TRACKERS if chosen.quick else TRACKERS
    learn(made_log(1, FRAMES[0], chosen.seed))  # the first fit waits for imports
    print(f"{'trackers':>8} {'pairs':>6} {'frames':>7}" + "".join(f" {method + ' [ms]':>13}" for method in METHODS))
    with in_this_thread():
        for count in trackers:
            for frames in QUICK_FRAMES if chosen.quick else FRAMES:
                logs = [made_log(count, frames, chosen.seed + i) for i in objects]
                ms = [float(np.mean([time_ms(log, method) for log in logs])) for method in METHODS]
                parts = count * BODIES
                row = f"{parts:8d} {parts * (parts - 1) // 2:6d} {frames:7d}"
                print(row + "".join(f" {each:13.0f}" for each in ms), flush=True)
    print(f"wanted {WANTED_MS:.0f} ms a fit in the mean of a sweep")


if __name__ == "__main__":
    main()
