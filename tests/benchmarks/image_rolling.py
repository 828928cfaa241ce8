"""A rolling shutter on rendered pictures: joint angles without it, with its readout known, ignored, and estimated.

The demo's arm in smooth motion, each seed rendered twice: with all rows exposed at once, and one after another in
25 ms. Frames last a thirtieth of a second: with the exposure of 8 ms that is the longest readout there can be. Ratios
are to the RMSE of the same seed without the shutter, over the frames in which both have a state.

Run: python -m tests.benchmarks.image_rolling [--trials N] [--seed N] [--workers N] [--quick]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.result import Fit
from station.tracking import track_parts, views_of
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.rendered_arm import RANGES_DEG, RenderedArm, rendered_arm
from tests.benchmarks.rendered_truth import StateErrors, part_bodies, state_errors

JOINTS = tuple(RANGES_DEG)
READOUT_S = 0.025
# What is told of the readout where it is to be estimated: another one, as far off as data sheets are.
TOLD_S = 0.020
WANTED_RATIO, WANTED_MS = 1.3, 1.0
NUMBERS = ("edge_shift_px",)
QUICK_FRAMES, FRAMES = 150, 300


@dataclass(frozen=True)
class Run:
    """One seed: RMSE [deg] by way and joint, without and with the shutter over the same frames; readout as estimated.

    `without` has of each way and joint the RMSE of the seed without a shutter in the frames of that way.
    """

    seed: int
    rmse_deg: dict[tuple[str, str], float]
    without_deg: dict[tuple[str, str], float]
    readout_ms: float
    readout_std_ms: float


WAYS = ("known, poses", "known", "estimated", "ignored")
WITHOUT = "no shutter"


def fitted(arm: RenderedArm, *, readout_s: float, estimated: bool = False, refine: str = "image") -> Fit:
    """The pictures, fitted by somebody who is told of a readout."""
    camera = arm.truth.camera
    poses = track_parts(arm.observations, arm.table, camera, readout_s=readout_s).poses
    views = views_of(arm.observations, arm.table, camera, readout_s=readout_s)
    numbers = (*NUMBERS, "readout_s") if estimated else NUMBERS
    options = FitOptions(refine=refine, camera_numbers=numbers)
    return learn(poses, options, views if refine == "image" else None)


def run_seed(job: tuple[int, int]) -> Run:
    """Render without and with the shutter, and fit each way."""
    seed, frames = job
    plain, rolling = (rendered_arm(seed, frames=frames, readout_s=s) for s in (0.0, READOUT_S))
    estimated = fitted(rolling, readout_s=TOLD_S, estimated=True)
    fits = {
        "known, poses": fitted(rolling, readout_s=READOUT_S, refine="pose"),
        "known": fitted(rolling, readout_s=READOUT_S),
        "estimated": estimated,
        "ignored": fitted(rolling, readout_s=0.0),
    }
    bodies = part_bodies(plain.truth, plain.table)
    without = state_errors(fitted(plain, readout_s=0.0), plain.truth, bodies)
    rmse: dict[tuple[str, str], float] = {}
    beside: dict[tuple[str, str], float] = {}
    for way, fit in fits.items():
        for name, errors in state_errors(fit, rolling.truth, bodies).items():
            if name in without:
                rmse[way, name], beside[way, name] = _in_common(errors, without[name])
    image = estimated.image
    assert image is not None
    found, std = image.numbers.readout_s, image.numbers_std.readout_s
    return Run(seed, rmse, beside, 1e3 * found, 1e3 * std)


def _in_common(one: StateErrors, other: StateErrors) -> tuple[float, float]:
    both = np.isfinite(one.error_rad) & np.isfinite(other.error_rad)
    of_both = (replace(errors, error_rad=np.where(both, errors.error_rad, np.nan)) for errors in (one, other))
    first, second = (errors.rmse_deg for errors in of_both)
    return first, second


def show(runs: Sequence[Run]) -> None:
    """Print rows of seeds, then medians by joint and way."""
    print(f"readout {1e3 * READOUT_S:.0f} ms; told {1e3 * TOLD_S:.0f} ms where it is estimated, "
          f"wanted within {WANTED_MS:g} ms")  # fmt: skip
    print(f"{'seed':>4}  {'readout [ms]':>12}  {'std':>6}   RMSE with it known / without")
    for run in runs:
        ratios = [run.rmse_deg.get(("known", n), np.nan) / run.without_deg.get(("known", n), np.nan) for n in JOINTS]
        print(f"{run.seed:4}  {run.readout_ms:12.3f}  {run.readout_std_ms:6.3f}   "
              + "  ".join(f"{name} {ratio:.2f}" for name, ratio in zip(JOINTS, ratios, strict=True)))  # fmt: skip
    off_ms = np.abs([run.readout_ms - 1e3 * READOUT_S for run in runs])
    print(f"error of the readout: median {np.median(off_ms):.3f} ms, most {off_ms.max():.3f} ms")
    print(f"\n{'':9}  {'':12}  medians over seeds [deg]  ratio to none")
    print(f"{'joint':9}  {'readout':12}  {'RMSE':>10}  {WITHOUT:>12}  {'median':>7} {'most':>7}")
    for name in JOINTS:
        for way in WAYS:
            these = [
                (run.rmse_deg[way, name], run.without_deg[way, name]) for run in runs if (way, name) in run.rmse_deg
            ]
            if not these:
                print(f"{name:9}  {way:12}  never found")
                continue
            rmse, without = np.array(these).T
            ratio = rmse / without
            said = "" if way != "known" else "  within" if np.median(ratio) <= WANTED_RATIO else "  ABOVE"
            print(f"{name:9}  {way:12}  {np.median(rmse):10.4f}  {np.median(without):12.4f}  "
                  f"{np.median(ratio):7.2f} {ratio.max():7.2f}{said}")  # fmt: skip


def main() -> None:
    """Print the tables."""
    chosen = parser(__doc__, trials=10, quick=2).parse_args()
    frames = QUICK_FRAMES if chosen.quick else FRAMES
    seeds = range(chosen.seed, chosen.seed + trials_of(chosen))
    show(each(run_seed, [(seed, frames) for seed in seeds], chosen.workers))


if __name__ == "__main__":
    main()
