"""The demo against the truth: detected angles against the true ones at mid-exposure, axes against the drawn ones.

One recording a seed, fitted from the corners, from poses, and by the paper's method; beside them the servos' read-back,
which is rounded to whole counts and arrives between frames.

Run: python -m tests.benchmarks.demo_truth [--seed N] [--trials N] [--refine image pose paper] [--keep FOLDER]
    [--workers N] [--brief]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from station.commands import fitting
from station.errors import StationError
from station.fit.options import FitOptions
from station.fit.result import Fit
from station.kinematics import se3
from station.kinematics.tree import Joint
from station.logs import FloatArray, JointLog
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.demo_seeds import JOINTS
from tests.benchmarks.demo_sessions import DemoSession, demo_folder, demo_session
from tests.benchmarks.rendered_truth import StateErrors, Truth, part_bodies, state_errors

REFINE = ("image", "pose", "paper")
READ_BACK = "read-back"
# RMSE that the demo is to stay below, deg.
WANTED_DEG = {"base_pan": 0.05, "shoulder": 0.2, "elbow": 0.2, "wrist": 0.2}


@dataclass(frozen=True)
class JointRow:
    """A joint by one fit of one seed.

    Attributes:
        rmse_deg: and median of the absolute error, stated deviation (median), share within two of them.
        against_read_back_deg: RMSE against the read-back in place of the truth; NaN for the read-back itself.
        axis_deg: error and stated deviation; point_mm: likewise; NaN for the read-back.
    """

    rmse_deg: float
    median_deg: float
    std_deg: float
    within: float
    against_read_back_deg: float = np.nan
    axis_deg: tuple[float, float] = (np.nan, np.nan)
    point_mm: tuple[float, float] = (np.nan, np.nan)


Rows = dict[tuple[str, str], JointRow]
"""By fit and joint."""


def options_of(refine: str) -> FitOptions:
    """How to fit: "paper" is a method, the others are refinements of the station's."""
    return FitOptions(method="paper") if refine == "paper" else FitOptions(refine=refine)


def angle_row(errors: StateErrors, read_back: FloatArray | None = None) -> JointRow:
    """Errors after the offset; against the read-back by its own errors (T,) [rad] at the same times."""
    error, std = errors.error_rad, errors.std_rad
    seen = np.isfinite(error)
    known = seen & np.isfinite(std)
    rmse_deg, median_deg = np.degrees([np.sqrt(np.mean(error[seen] ** 2)), np.median(np.abs(error[seen]))]).tolist()
    std_deg = float(np.degrees(np.median(std[known]))) if known.any() else np.nan
    within = float(np.mean(np.abs(error[known]) < 2 * std[known])) if known.any() else np.nan
    if read_back is None:
        return JointRow(rmse_deg, median_deg, std_deg, within)
    both = seen & np.isfinite(read_back)
    return JointRow(rmse_deg, median_deg, std_deg, within, float(np.degrees(np.std((error - read_back)[both]))))


def read_back_errors(measured: JointLog, t_s: FloatArray, truth: Truth) -> dict[str, StateErrors]:
    """The read-back at the frames' times (T,), by straight lines between its stamps, against the truth."""
    found: dict[str, StateErrors] = {}
    for name in truth.stage.joints:
        q = measured.state(name)
        known = np.isfinite(q)
        at_s = np.interp(t_s, measured.t_s[known], q[known], left=np.nan, right=np.nan)
        error = at_s - truth.states(t_s)[:, truth.joint(name)]
        found[name] = StateErrors(name, name, t_s, error - np.nanmean(error), np.full(t_s.shape, np.nan))
    return found


def axis_errors(joint: Joint, drawn: Joint, T_part_body: FloatArray) -> tuple[float, float]:
    """Angle [deg] between the fitted axis and the drawn one, and the distance [mm] of its point from that.

    Args:
        joint: in its parent's frame, with an axis and a point.
        drawn: in the frame of the body that the parent is on, at T_part_body (4, 4) in the parent.
    """
    assert joint.axis_parent is not None and joint.point_parent_m is not None
    assert drawn.axis_parent is not None and drawn.point_parent_m is not None
    axis = T_part_body[:3, :3] @ drawn.axis_parent
    off = joint.point_parent_m - T_part_body[:3, :3] @ drawn.point_parent_m - T_part_body[:3, 3]
    turn = np.arctan2(np.linalg.norm(np.cross(axis, joint.axis_parent)), abs(axis @ joint.axis_parent))
    return float(np.degrees(turn)), float(1e3 * np.linalg.norm(off - axis * (off @ axis)))


def fit_rows(fit: Fit, session: DemoSession) -> dict[str, JointRow]:
    """Rows of the joints that were found."""
    truth = session.truth
    read_back = read_back_errors(session.measured, fit.states.t_s, truth)
    part_body = part_bodies(truth, session.table)
    T_body_marker = {plate.marker_id: plate.T_body_marker for plate in truth.stage.plates}
    T_part_body = {marker.part: se3.inverse(T_body_marker[marker.id]) for marker in session.table.markers}
    rows: dict[str, JointRow] = {}
    for name, errors in state_errors(fit, truth, part_body).items():
        joint, drawn = fit.tree.joint(errors.fitted), truth.stage.tree.joint(name)
        # Seen from a fitted parent that is the drawn child, the axis is where it is: turns don't move it.
        axis_deg, point_mm = axis_errors(joint, drawn, T_part_body[joint.parent])
        rows[name] = replace(
            angle_row(errors, read_back[name].error_rad),
            axis_deg=(axis_deg, float(np.degrees(joint.axis_std_rad or np.nan))),
            point_mm=(point_mm, 1e3 * (joint.point_std_m or np.nan)),
        )
    return rows


def run_seed(seed: int, refine: Sequence[str], keep: Path | None) -> Rows:
    """One recording, fitted each way."""
    with demo_folder(keep, seed) as folder:
        session = demo_session(folder, seed)
        rows: Rows = {}
        for name in refine:
            try:
                fit = fitting.fit(folder, folder / name, options=options_of(name), force=True).fit
            except StationError as error:
                print(f"seed {seed}, {name}: {error}")
                continue
            rows |= {(name, joint): row for joint, row in fit_rows(fit, session).items()}
    for joint, errors in read_back_errors(session.measured, session.observations.t_s, session.truth).items():
        rows[READ_BACK, joint] = angle_row(errors)
    return rows


def show_seed(seed: int, rows: Rows) -> None:
    """Print a row a joint and fit."""
    for joint in JOINTS:
        for (name, of), row in rows.items():
            if of == joint:
                angle = "  ".join(f"{x:8.4f}" for x in (row.rmse_deg, row.median_deg, row.std_deg))
                place = "  ".join(f"{x:7.4f}" for x in (*row.axis_deg, *row.point_mm))
                print(f"{seed:4}  {joint:9}  {name:9}  {angle}  {100 * row.within:6.1f}  "
                      f"{row.against_read_back_deg:9.4f}    {place}".replace("nan", "  -"))  # fmt: skip


def show_worst(runs: Sequence[Rows], refine: Sequence[str]) -> None:
    """Print the median and the greatest RMSE of each joint by each fit."""
    print(f"\nRMSE against the true angle at mid-exposure, deg: median and most of {len(runs)} seeds")
    print(f"{'fit':9}  " + "  ".join(f"{joint:^17}" for joint in JOINTS) + "  found in all")
    for name in (*refine, READ_BACK):
        cells = [[run[name, joint].rmse_deg for run in runs if (name, joint) in run] for joint in JOINTS]
        complete = all(len(cell) == len(runs) for cell in cells)
        print(f"{name:9}  " + "  ".join(f"{np.median(c):8.4f} {np.max(c):8.4f}" if c else f"{'-':^17}" for c in cells)
              + f"  {'yes' if complete else 'NO'}")  # fmt: skip
    print(f"{'wanted':9}  " + "  ".join(f"{'':8} {WANTED_DEG[joint]:8.2f}" for joint in JOINTS))


def main() -> None:
    """Print the tables."""
    options: argparse.ArgumentParser = parser(__doc__, trials=10, quick=1)
    options.add_argument("--refine", nargs="+", choices=REFINE, default=REFINE, help="how to fit")
    options.add_argument("--keep", type=Path, help="folder that keeps the recordings, and has those of earlier runs")
    options.add_argument("--brief", action="store_true", help="leave the rows of the seeds out")
    chosen = options.parse_args()
    seeds = range(chosen.seed, chosen.seed + trials_of(chosen))
    runs = each(partial(run_seed, refine=tuple(chosen.refine), keep=chosen.keep), seeds, chosen.workers)
    if not chosen.brief:
        print(
            f"{'':26}  {'angle [deg], after the offset':^36}  {'against':>9}    {'axis [deg]':^16}  {'point [mm]':^16}"
        )
        print(f"{'seed':>4}  {'joint':9}  {'fit':9}  {'RMSE':>8}  {'median':>8}  {'std':>8}  {'% in 2':>6}  "
              f"{'read-back':>9}  " + f"  {'error':>7}  {'std':>7}" * 2)  # fmt: skip
        for seed, rows in zip(seeds, runs, strict=True):
            show_seed(seed, rows)
    show_worst(runs, chosen.refine)


if __name__ == "__main__":
    main()
