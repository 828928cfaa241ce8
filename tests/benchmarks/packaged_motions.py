"""Packaged rigs through the motions that suit any rig: is the arm found, and how far are its angles from the read-back?

Run: python -m tests.benchmarks.packaged_motions [--rigs NAME ...] [--motions NAME ...] [--seeds N] [--workers N]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from station.commands import planning, sessions
from station.fit_files import read_fit
from station.rig import load_rig
from station.rig_reading import packaged_names
from tests.benchmarks.arguments import each
from tests.benchmarks.demo_seeds import rmse_deg
from tests.benchmarks.packaged_rigs import arm_found

MOTIONS = ("each_joint", "combined", "sinusoids", "explore")


def run_motion(job: tuple[str, str, int]) -> str:
    """Capture, fit and compare one packaged rig with one motion: a line of the table."""
    rig, motion, seed = job
    start_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / rig
        comparison = sessions.run(rig, motion, out, seed=seed)
        tree = read_fit(out / "fit").tree
    planned = planning.plan(rig, motion)
    ways = np.ptp([leg.q_to for leg in planned.segments], axis=0)
    still = [joint.name for joint, way in zip(planned.joints, ways, strict=True) if way == 0]
    right = arm_found(tree, load_rig(rig).table, still)
    types = " ".join(f"{joint.name}:{joint.type}" for joint in tree.joints)
    errors = "  ".join(f"{joint} {error:.3f}" for joint, error in rmse_deg(comparison).items())
    wall_s = time.perf_counter() - start_s
    line = f"{rig:<18} {motion:<10} {seed:4}  {'right' if right else 'WRONG ' + types:<6} {wall_s:7.0f}  {errors}"
    print(line, flush=True)
    return line


def main() -> None:
    """Print a row a session as it is done, then how many were right."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rigs", nargs="+", default=packaged_names("rigs"), help="names of packaged rigs")
    options.add_argument("--motions", nargs="+", default=list(MOTIONS), help="names of packaged motions")
    options.add_argument("--seeds", type=int, default=1, help="seeds 0, 1, ... of each")
    options.add_argument("--workers", type=int, default=1, help="processes; the numbers don't depend on it")
    chosen = options.parse_args()
    jobs = [(rig, motion, seed) for rig in chosen.rigs for motion in chosen.motions for seed in range(chosen.seeds)]
    print(f"{'rig':<18} {'motion':<10} seed  tree    wall s  detected against read-back, RMSE [deg] by joint")
    lines = each(run_motion, jobs, chosen.workers)
    print(f"{sum('WRONG' not in line for line in lines)} of {len(lines)} right")


if __name__ == "__main__":
    main()
