"""Time and memory of the learner on simulated objects with three joint types and two trackers a body.

20 trackers (190 pairs), 1000 frames: wanted at most 2.5 s in-process on 2 cores. Then time against frames and against
pairs, with the exponent of the best power law, wanted at most 1: of processor time, which other programs disturb less.
The least of several runs counts. `--memory` adds the peak of a process that fits 50 trackers over 10,000 frames, its
own imports and data included: wanted at most 1.5 GB.

Run: python -m tests.benchmarks.fit_speed [--seed N] [--trials N] [--quick] [--memory]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Sequence

import numpy as np

from station.fit.learner import learn
from station.logs import PoseLog
from tests.benchmarks.arguments import parser, trials_of
from tests.benchmarks.made_joints import watch
from tests.benchmarks.made_trees import random_tree

WANTED_S, WANTED_GB = 2.5, 1.5
GOAL = (20, 1000)  # trackers, frames
MEMORY = (50, 10_000)
BY_FRAMES, QUICK_BY_FRAMES = (8, (500, 1000, 2000, 4000, 8000)), (8, (500, 1000, 2000))
BY_TRACKERS, QUICK_BY_TRACKERS = (300, (10, 20, 40, 60)), (300, (6, 12, 20))
STD_M, STD_RAD = 0.002, 0.02
KIBIBYTE = 1024  # ru_maxrss on Linux


def made_log(trackers: int, frames: int, seed: int) -> PoseLog:
    """A log of an object with half as many bodies as trackers."""
    rng = np.random.default_rng([seed, trackers])  # the same object, whatever the frames
    kinds = ("prismatic", "revolute")
    made = random_tree(
        rng, bodies=trackers // 2, frames=frames, kinds=kinds, root_moves=False, walk=False, trackers=(2, 2)
    )
    return watch(rng, made.T_ref_part, STD_M, STD_RAD).log


def time_s(trackers: int, frames: int, seed: int, runs: int) -> tuple[float, float]:
    """Least wall and processor time of a fit [s]."""
    log = made_log(trackers, frames, seed)
    wall_s, processor_s = np.inf, np.inf
    for _ in range(runs):
        start_s = time.perf_counter(), time.process_time()
        learn(log)
        wall_s = min(wall_s, time.perf_counter() - start_s[0])
        processor_s = min(processor_s, time.process_time() - start_s[1])
    return wall_s, processor_s


def exponent(sizes: Sequence[float], times_s: Sequence[float]) -> float:
    """Slope of the line through the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(times_s), 1)[0])


def pairs_of(trackers: int) -> int:
    return trackers * (trackers - 1) // 2


def timed_row(trackers: int, frames: int, seed: int, runs: int) -> tuple[float, float]:
    """Print one line; wall and processor time."""
    wall_s, processor_s = time_s(trackers, frames, seed, runs)
    miss = f"  wanted {WANTED_S} s" + (" <" if wall_s > WANTED_S else "") if (trackers, frames) == GOAL else ""
    print(f"{trackers:8d} {pairs_of(trackers):6d} {frames:7d} {wall_s:9.2f} {processor_s:9.2f}{miss}", flush=True)
    return wall_s, processor_s


def peak_gb(trackers: int, frames: int, seed: int) -> tuple[float, float]:
    """Peak resident memory [GB] before and after the fit, of a process of its own."""
    module = ("-m", "tests.benchmarks.fit_speed", "--seed", str(seed), "--child", str(trackers), str(frames))
    done = subprocess.run([sys.executable, *module], check=True, capture_output=True, text=True)
    before, after = (float(word) for word in done.stdout.split())
    return before, after


def run_child(trackers: int, frames: int, seed: int) -> None:
    """Fit, and print the process's own peak before and after [GB]."""
    log = made_log(trackers, frames, seed)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    learn(log)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(before * KIBIBYTE / 1e9, after * KIBIBYTE / 1e9)


def show_scaling(chosen: argparse.Namespace, runs: int) -> None:
    """Print time against frames and against pairs."""
    trackers, counts = QUICK_BY_FRAMES if chosen.quick else BY_FRAMES
    times_s = [timed_row(trackers, frames, chosen.seed, runs)[1] for frames in counts]
    print(f"processor time grows with frames to the power {exponent(counts, times_s):.2f}")
    frames, counts = QUICK_BY_TRACKERS if chosen.quick else BY_TRACKERS
    times_s = [timed_row(trackers, frames, chosen.seed, runs)[1] for trackers in counts]
    print(f"processor time grows with pairs to the power {exponent([pairs_of(n) for n in counts], times_s):.2f}")


def main() -> None:
    """Print the tables."""
    options = parser(__doc__, trials=2, quick=1)
    options.add_argument("--memory", action="store_true", help=f"peak of {MEMORY[0]} trackers, {MEMORY[1]} frames")
    options.add_argument("--child", nargs=2, type=int, metavar=("TRACKERS", "FRAMES"), help=argparse.SUPPRESS)
    chosen = options.parse_args()
    if chosen.child:
        run_child(chosen.child[0], chosen.child[1], chosen.seed)
        return
    runs = trials_of(chosen)
    print(f"{'trackers':>8} {'pairs':>6} {'frames':>7} {'wall [s]':>9} {'proc. [s]':>9}")
    timed_row(*GOAL, chosen.seed, runs)
    show_scaling(chosen, runs)
    if chosen.memory:
        before, after = peak_gb(*MEMORY, chosen.seed)
        miss = " <" if after > WANTED_GB else ""
        print(f"{MEMORY[0]} trackers, {MEMORY[1]} frames: peak {after:.2f} GB, of that {before:.2f} GB before the fit; "
              f"wanted {WANTED_GB} GB{miss}")  # fmt: skip


if __name__ == "__main__":
    main()
