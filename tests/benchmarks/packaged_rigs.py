"""Every packaged rig through its own motion: is the arm found, and how far are its angles from the read-back?

Run: python tests/benchmarks/packaged_rigs.py [--rigs NAME ...] [--seeds N] [--workers N]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Collection
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from station.commands import sessions
from station.fit_files import read_fit
from station.formats.rig import RigTable
from station.kinematics.tree import KinematicTree
from station.rig import load_rig
from station.rig_reading import packaged_names
from tests.benchmarks.demo_seeds import rmse_deg


@dataclass(frozen=True)
class RigRun:
    """One session: whether its tree is the rig's, and detected against read-back by joint [deg]."""

    rig: str
    seed: int
    right: bool
    rmse_deg: dict[str, float]
    wall_s: float


def arm_found(tree: KinematicTree, rig: RigTable, still: Collection[str] = ()) -> bool:
    """Whether the tree is what the rig draws: its root, a body's markers together, its joints between seen bodies.

    Bodies between which there are only `still` joints, which nothing moved, are one.
    """
    simulation = rig.simulation
    if simulation is None:
        return False
    part_of = {marker.id: marker.part for marker in rig.marker_table().markers}
    carrier = {joint.child: joint.parent for joint in simulation.joint if joint.name in still}

    def carried_by(body: str) -> str:
        return carried_by(carrier[body]) if body in carrier else body

    parts: dict[str, set[str]] = {}
    for plate in simulation.plate:
        parts.setdefault(carried_by(plate.body), set()).add(part_of[plate.id])
    body_of = {part: body for body, together in parts.items() for part in together}
    groups = {frozenset(group) for group in tree.rigid_groups}
    found = {(joint.name, joint.type, body_of[joint.parent], body_of[joint.child]) for joint in tree.joints}
    drawn = {
        (joint.name, "revolute", carried_by(joint.parent), joint.child)
        for joint in simulation.joint
        if joint.child in parts and joint.name not in still
    }
    return (
        body_of[tree.root] == simulation.root
        and groups == {frozenset(together) for together in parts.values()}
        and found == drawn
        and len(tree.joints) == len(drawn)
    )


def run_rig(job: tuple[str, int]) -> RigRun:
    """Capture, fit, compare and report one packaged rig with the motion of its name."""
    rig, seed = job
    start_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / rig
        comparison = sessions.run(rig, rig, out, seed=seed)
        tree = read_fit(out / "fit").tree
    right = arm_found(tree, load_rig(rig).table)
    return RigRun(rig, seed, right, rmse_deg(comparison), time.perf_counter() - start_s)


def row(run: RigRun) -> str:
    """One session as a line of the table."""
    errors = "  ".join(f"{joint} {error:.3f}" for joint, error in run.rmse_deg.items())
    return f"{run.rig:<18} {run.seed:4}  {'right' if run.right else 'WRONG':9}  {run.wall_s:8.1f}  {errors}"


def main() -> None:
    """Print a row a session as it is done, then how many were right and the greatest error."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rigs", nargs="+", default=packaged_names("rigs"), help="names of packaged rigs")
    options.add_argument("--seeds", type=int, default=3, help="seeds 0, 1, ... of each rig")
    options.add_argument("--workers", type=int, default=1, help="processes; the numbers don't depend on it")
    chosen = options.parse_args()
    jobs = [(rig, seed) for rig in chosen.rigs for seed in range(chosen.seeds)]
    print(f"{'rig':<18} seed  structure  time [s]  RMSE against read-back [deg]")
    runs: list[RigRun] = []
    with ProcessPoolExecutor(chosen.workers) as pool:
        for run in pool.map(run_rig, jobs):
            runs.append(run)
            print(row(run), flush=True)
    worst = max(error for run in runs for error in run.rmse_deg.values())
    print(f"{sum(run.right for run in runs)} of {len(runs)} structures right, greatest RMSE {worst:.3f} deg")


if __name__ == "__main__":
    main()
