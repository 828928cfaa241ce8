"""Processor time of the simulator: frames, parts, trackers, repeats; alone and all at once.

Wanted: 1,000 frames of an object of 10 parts in milliseconds. The object is a tree of revolute and prismatic joints,
two on each part; its root moves, noise is uniform. The least of several runs counts, of processor time, which other
programs disturb less. A row tells also the time for one pose, which says how far more of them at once are cheaper.

Run: python -m tests.benchmarks.simulator_speed [--seed N] [--trials N] [--quick]
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from station.kinematics.joint import Joint
from station.kinematics.tree import KinematicTree
from station.simulate import NOISE_MODELS, SimulationOptions, make_noise, simulate, simulate_all
from tests.benchmarks.arguments import parser, trials_of

WANTED_MS = 100.0
GOAL = (10, 1000)  # parts, frames
SIZES = ((4, 100), (10, 100), GOAL, (10, 10_000))
REPEATS = (1, 10, 100)
NOISE = (0.001, 0.01)


def made_tree(parts: int) -> KinematicTree:
    """Each part carries two, by hinges and slides in turn about and along the three axes."""
    names = tuple(f"p{i}" for i in range(parts))
    joints = tuple(
        Joint(
            name=f"j{i}",
            type="prismatic" if i % 4 == 3 else "revolute",
            parent=names[(i - 1) // 2],
            child=names[i],
            axis_parent=np.eye(3)[i % 3],
            point_parent_m=None if i % 4 == 3 else np.array([0.1, 0.0, 0.0]),
            T_parent_child_zero=np.eye(4),
            limits=(0.0, 0.5),
        )
        for i in range(1, parts)
    )
    return KinematicTree(root="p0", parts=names, rigid_groups=(), trees=(names,), joints=joints)


def least_ms(work: Callable[[], object], runs: int) -> float:
    """Least processor time of several runs [ms]."""
    found = np.inf
    for _ in range(runs):
        start_s = time.process_time()
        work()
        found = min(found, time.process_time() - start_s)
    return 1e3 * found


def row(what: str, poses: int, ms: float) -> str:
    return f"{what:<44} {poses:>9,} {ms:>9.1f} {1e3 * ms / poses:>9.2f}"


def main() -> None:
    """Print the tables."""
    chosen = parser(__doc__, trials=7, quick=2).parse_args()
    runs = trials_of(chosen)
    print(f"{'':<44} {'poses':>9} {'ms':>9} {'us/pose':>9}")
    goal_ms = np.inf
    for parts, frames in SIZES[:3] if chosen.quick else SIZES:
        tree, options = made_tree(parts), SimulationOptions(frames=frames)
        ms = least_ms(lambda tree=tree, options=options: simulate(tree, options, chosen.seed), runs)
        goal_ms = ms if (parts, frames) == GOAL else goal_ms
        print(row(f"{parts} parts, {frames:,} frames", parts * frames, ms))
    tree, options = made_tree(10), SimulationOptions(frames=100)
    for count in REPEATS[:2] if chosen.quick else REPEATS:
        seeds = range(chosen.seed, chosen.seed + count)
        ms = least_ms(lambda seeds=seeds: simulate_all(tree, options, seeds), runs)
        print(row(f"10 parts, 100 frames, {count} repeats at once", 1000 * count, ms))
    ms = least_ms(lambda: simulate(tree, SimulationOptions(frames=100, inflation=4), chosen.seed), runs)
    print(row("10 parts and 40 virtual, 100 frames", 5000, ms))
    for name in NOISE_MODELS:
        options = SimulationOptions(frames=GOAL[1], noise=make_noise(name, *NOISE))
        ms = least_ms(lambda options=options: simulate(tree, options, chosen.seed), runs)
        print(row(f"10 parts, 1,000 frames, {name} noise", 10_000, ms))
    options = SimulationOptions(frames=GOAL[1], motion="smooth", outliers=0.05, missing=0.1)
    ms = least_ms(lambda: simulate(tree, options, chosen.seed), runs)
    print(row("10 parts, 1,000 frames, smooth, with gaps", 10_000, ms))
    print(f"\n10 parts, 1,000 frames: {goal_ms:.0f} ms of processor time; wanted at most {WANTED_MS:.0f}")


if __name__ == "__main__":
    main()
