"""A camera calibrated from 15 rendered views: are the stated standard deviations true, and are bad sets called bad?

Every run is another camera (focal length, centre, distortion, blur, noise) and other views. The table counts how often
each parameter's error is within 1, 2 and 3 of its stated standard deviations.

Run: python -m tests.benchmarks.camera_calibration [--trials N] [--seed S] [--workers N] [--quick]
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from calibration.camera_calibration import calibrate_camera
from calibration.camera_fit import PARAMETERS, parameters_of
from calibration.errors import CalibrationError
from calibration.wrong_board import explain_missing
from station.camera_commands import marker_refinement
from tests.benchmarks.arguments import each, parser, trials_of
from tests.board_sets import (
    BAD_SETS,
    BOARD,
    good_poses,
    rendered,
    shots_of,
    some_camera,
    true_parameters,
)


@dataclass(frozen=True)
class Run:
    """One calibration: errors and standard deviations of PARAMETERS, residuals, verdict, times."""

    error: np.ndarray
    std: np.ndarray
    rms_px: float
    held_out_px: float
    edge_shift_px: float
    edge_shift_std_px: float
    grade: str
    render_s: float
    find_s: float
    fit_s: float


def one_run(seed: int) -> Run:
    """A camera, its views, its calibration."""
    rng = np.random.default_rng(seed)
    optics = some_camera(rng)
    start_s = time.perf_counter()
    images = rendered(optics, good_poses(optics, rng), seed)
    rendered_s = time.perf_counter()
    shots = shots_of(images)
    found_s = time.perf_counter()
    done = calibrate_camera(shots, BOARD, marker_refinement(BOARD))
    end_s = time.perf_counter()
    return Run(
        error=parameters_of(done.camera) - true_parameters(optics),
        std=done.fit.std,
        rms_px=done.camera.rms_px or np.nan,
        held_out_px=np.nan if done.held_out is None else done.held_out.rms_px,
        edge_shift_px=np.nan if done.edge_shift is None else done.edge_shift.shift_px,
        edge_shift_std_px=np.nan if done.edge_shift is None else done.edge_shift.std_px,
        grade=done.verdict.grade.word,
        render_s=rendered_s - start_s,
        find_s=found_s - rendered_s,
        fit_s=end_s - found_s,
    )


def show_good(runs: list[Run]) -> None:
    """The table of the good sets."""
    z = np.array([run.error / run.std for run in runs])
    std = np.median([run.std for run in runs], axis=0)
    print(f"{'':>4}  {'std':>9}  {'in 1':>5}  {'in 2':>5}  {'in 3':>5}  mean square of error / std")
    for k, name in enumerate(PARAMETERS):
        shares = [float(np.mean(np.abs(z[:, k]) < n)) for n in (1, 2, 3)]
        print(f"{name:>4}  {std[k]:9.5f}  " + "  ".join(f"{s:5.0%}" for s in shares) + f"  {np.mean(z[:, k] ** 2):.2f}")
    print(f"f and c all within 3: {np.mean(np.all(np.abs(z[:, :4]) < 3, axis=1)):.0%} of {len(runs)} runs")
    shift = np.array([(run.edge_shift_px, run.edge_shift_std_px) for run in runs])
    for what, values in (
        ("RMS [px]", [run.rms_px for run in runs]),
        ("RMS held out [px]", [run.held_out_px for run in runs]),
        ("edge shift [px]", shift[:, 0].tolist()),
        ("its std [px]", shift[:, 1].tolist()),
        ("rendering [s]", [run.render_s for run in runs]),
        ("finding the board in 15 views [s]", [run.find_s for run in runs]),
        ("fit, held-out folds, edge shift [s]", [run.fit_s for run in runs]),
    ):
        low, middle, high = np.nanpercentile(values, (5, 50, 95))
        print(f"{what:<36} {middle:7.3f}  (5 to 95 %: {low:.3f} to {high:.3f})")
    grades = [run.grade for run in runs]
    print("verdicts: " + ", ".join(f"{word} {grades.count(word)}" for word in ("good", "usable", "bad")))


def show_bad(seed: int) -> None:
    """What each bad set is called, and why."""
    for name, make in BAD_SETS.items():
        rng = np.random.default_rng(seed)
        board, images = make(some_camera(rng), rng)
        shots = shots_of(images, board)
        if len(shots) < 3:
            print(f"{name:<36} refused: {explain_missing(images, board).splitlines()[0]}")
            continue
        try:
            done = calibrate_camera(shots, board, marker_refinement(board))
        except CalibrationError as error:
            print(f"{name:<36} refused: {str(error).splitlines()[0]}")
            continue
        remark = done.verdict.remarks[0].what if done.verdict.remarks else ""
        print(f"{name:<36} {done.verdict.grade.word}: {remark}")


def main() -> None:
    """Print both tables."""
    chosen = parser(__doc__, trials=100, quick=8).parse_args()
    start_s = time.perf_counter()
    runs = each(one_run, range(chosen.seed, chosen.seed + trials_of(chosen)), chosen.workers)
    show_good(runs)
    print()
    show_bad(chosen.seed)
    print(f"\n{time.perf_counter() - start_s:.0f} s")


if __name__ == "__main__":
    main()
