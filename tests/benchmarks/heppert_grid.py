"""The pose grid of Heppert et al.: a parent and a child, both tracked with noise, 10 or 40 poses, the type known.

Radius 0.65 m, 0.2 m from the parent to the axis, states evenly spaced, the parent anywhere in each frame. RIPL's errors
are those that its authors printed for 10 poses; its gain from 40 is small. Median errors of the axis in the parent's
frame, over the trials; `same` is the ratio to the best linear estimate from the same noise, which errs as much as the
bound says. Wanted: below RIPL everywhere, and `same` near 1. What is above RIPL, or above 1.15 where the bound is below
15 deg, is marked <; so are fits without the joint.

Run: python -m tests.benchmarks.heppert_grid [--seed N] [--trials N] [--quick] [--workers N]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.options import FitOptions
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.bounds import bound, median_norm
from tests.benchmarks.made_joints import single_joint, watch
from tests.benchmarks.read_fits import attempt, axis_error_rad, found_type

RADIUS_M, LEVER_M = 0.65, 0.2
POSES = (10, 40)
NOISES = ((1.0, 1.0), (30.0, 3.0), (100.0, 10.0))  # mm, deg for each axis
TRAVELS = {"prismatic": (0.05, 0.2, 0.4), "revolute": tuple(np.radians([15.0, 45.0, 90.0]).tolist())}
# Median axis error of RIPL [deg] at 10 poses, where it was printed: type, travel [cm or deg], noise [mm].
RIPL_DEG = {
    ("prismatic", 5, 1): 16.0, ("prismatic", 20, 1): 4.1, ("prismatic", 20, 30): 24.0, ("prismatic", 40, 30): 15.0,
    ("revolute", 15, 1): 8.9, ("revolute", 45, 30): 11.4, ("revolute", 90, 30): 5.9, ("revolute", 90, 100): 20.5,
}  # fmt: skip
WANTED_RATIO = 1.15
LOCAL_DEG = 15.0  # directions are no plane: a bound above this says nothing about the error


@dataclass(frozen=True)
class Cell:
    """A joint type, its travel [m or rad], the noise [m, rad] and the number of poses."""

    kind: str
    travel: float
    std_m: float
    std_rad: float
    poses: int

    @property
    def shown(self) -> tuple[int, str]:
        """Travel in cm or deg, and the unit."""
        return (round(100 * self.travel), "cm") if self.kind == "prismatic" else (round(np.degrees(self.travel)), "deg")

    @property
    def ripl_deg(self) -> float:
        """NaN where it isn't known."""
        return RIPL_DEG.get((self.kind, self.shown[0], round(1e3 * self.std_m)), np.nan)


def try_cell(job: tuple[Cell, list[int]]) -> tuple[float, float, float]:
    """Axis error, median bound and the efficient estimate's error [rad]; a fit without the joint counts as infinite."""
    cell, seed = job
    rng = np.random.default_rng(seed)
    made = single_joint(
        rng, cell.kind, frames=cell.poses, travel=cell.travel, arm_m=RADIUS_M, lever_m=LEVER_M, parent_tracked=True
    )
    watched = watch(rng, made.T_ref_part, cell.std_m, cell.std_rad)
    least = bound(made, watched.noise, cell.std_m, cell.std_rad)
    best = float(np.linalg.norm(least.efficient[least.axis_columns[0]]))
    fit, _ = attempt(watched.log, FitOptions(joint_types=(cell.kind,), root="p0"))
    error = np.inf
    if fit is not None and found_type(fit.tree) == cell.kind:
        axis = fit.tree.joints[0].axis_parent
        error = np.inf if axis is None else axis_error_rad(axis, made.joints[0].axis)
    return error, median_norm(least.axis(0)), best


def row(cell: Cell, trials: list[tuple[float, float, float]]) -> str:
    """One line of the table."""
    values = np.degrees(np.array(trials))
    error, least, best = np.median(values, axis=0)
    lost = int(np.sum(np.isinf(values[:, 0])))
    travel, unit = cell.shown
    ripl = "     -" if np.isnan(cell.ripl_deg) else f"{cell.ripl_deg:6.1f}"
    far = least < LOCAL_DEG and error / best > WANTED_RATIO
    miss = "<" if error > cell.ripl_deg or far or lost else ""
    noise = f"{1e3 * cell.std_m:4.0f} {np.degrees(cell.std_rad):5.0f}"
    left = f"{cell.kind:9} {travel:4d} {unit:3}  {noise}  {cell.poses:5d}"
    return f"{left}  {error:8.2f}  {least:8.2f}  {ripl}  {error / least:6.2f}  {error / best:6.2f}  {lost:5d} {miss}"


def main() -> None:
    """Print a row a cell."""
    chosen = parser(__doc__, trials=20, quick=5).parse_args()
    print(f"{'':18}  {'noise':^10}  {'':5}  {'axis error, median [deg]':^26}  {'ratio to':^14}  {'no':>5}")
    print(
        f"{'type':9} {'travel':8}  {'[mm]':>4} {'[deg]':>5}  {'poses':>5}  {'fit':>8}  {'bound':>8}  {'RIPL':>6}"
        f"  {'bound':>6}  {'same':>6}  {'joint':>5}"
    )
    cells = [
        Cell(kind, travel, 1e-3 * mm, float(np.radians(deg)), poses)
        for kind, travels in TRAVELS.items()
        for travel in travels
        for mm, deg in NOISES
        for poses in POSES
    ]
    for number, cell in enumerate(cells):
        jobs = [(cell, [chosen.seed, number, trial]) for trial in range(trials_of(chosen))]
        print(row(cell, each(try_cell, jobs, chosen.workers)), flush=True)


if __name__ == "__main__":
    main()
