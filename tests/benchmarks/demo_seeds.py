"""The demo for ten seeds: structure, and detected against read-back angle after sign and offset only.

Run: python tests/benchmarks/demo_seeds.py [SEEDS]
"""

from __future__ import annotations

import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from station.commands import sessions
from station.compare import Comparison
from station.fit_files import read_fit
from station.kinematics.tree import KinematicTree

JOINTS = ("base_pan", "shoulder", "elbow", "wrist")
BODIES = ("base", "turntable", "upper_arm", "forearm", "hand")
WORKERS = 2


def structure_right(tree: KinematicTree) -> bool:
    """Whether the tree is the arm: two trackers a body, four revolute joints in its order from the base."""
    groups = {frozenset(group) for group in tree.rigid_groups}
    joints = [(joint.name, joint.type, tree.body_of(joint.parent), tree.body_of(joint.child)) for joint in tree.joints]
    chain = [(name, "revolute", *BODIES[i : i + 2]) for i, name in enumerate(JOINTS)]
    return groups == {frozenset((body, f"{body}_b")) for body in BODIES} and sorted(joints) == sorted(chain)


def rmse_deg(comparison: Comparison) -> dict[str, float]:
    """Detected against read-back, deg, by joint."""
    return {
        joint.joint: float(np.degrees(joint.against_measured.rmse))
        for joint in comparison.joints
        if joint.against_measured is not None
    }


def run_seed(seed: int) -> tuple[int, bool, dict[str, float], float]:
    """One demo: seed, whether the structure is right, errors, wall time [s]."""
    start_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "demo"
        comparison = sessions.run("demo", "demo", out, seed=seed)
        tree = read_fit(out / "fit").tree
    return seed, structure_right(tree), rmse_deg(comparison), time.perf_counter() - start_s


def main() -> None:
    """Print a row a seed and the greatest error of each joint."""
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
    print(f"{'seed':>4}  structure  " + "  ".join(f"{joint:>9}" for joint in JOINTS) + "   time [s]")
    errors = []
    with ProcessPoolExecutor(WORKERS) as pool:
        for seed, right, rmse, wall_s in pool.map(run_seed, seeds):
            row = [rmse.get(joint, np.nan) for joint in JOINTS]
            errors.append(row)
            said = "right" if right else "WRONG"
            print(f"{seed:4}  {said:9}  " + "  ".join(f"{e:9.3f}" for e in row) + f"   {wall_s:8.1f}")
    print(f"{'max':>4}  {'':9}  " + "  ".join(f"{e:9.3f}" for e in np.max(errors, axis=0)) + "   RMSE [deg]")


if __name__ == "__main__":
    main()
