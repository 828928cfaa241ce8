"""A rolling shutter of 25 ms against none: the errors of states from corners, and the readout estimated.

The same objects with the same noise, seen at once and row by row: 3 to 5 joints, 300 frames, 0.1 px. First the root
mean square error of each joint's states with the shutter, its readout known, over that without: wanted at most 1.3.
Then the same with the readout ignored, where the fit is told that there is none, and with it estimated, from nothing
and from 5 ms too little: how far off it is (median and most), wanted within 1 ms where the motion allows, how far it
says that it may be (median of its standard deviations), and how often its 95 % interval holds the truth. `motion` is
the speed of corners [px/s], root mean square.

Run: python -m tests.benchmarks.image_shutter [--seed N] [--trials N] [--quick] [--only TEXT] [--workers N]
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from station.fit.options import FitOptions
from tests.benchmarks.arguments import each, parser, trials_of
from tests.fit.image.held_fits import fitted, held
from tests.fit.image.seen_objects import FPS
from tests.fit.image.simulated_views import Scene, Seeing, Watched, corners_px, watched

READOUT_S, SHORT_S = 0.025, 0.020
WANTED_RATIO, WANTED_S = 1.3, 0.001
JOINTS = (3, 5)
SEEING = Seeing(sigma_px=0.1)
ROWS = {
    "static root, smooth": Scene(),
    "moving root, smooth": Scene(root_moves=True),
    "static root, steps": Scene(course="steps"),
    "moving root, steps": Scene(root_moves=True, course="steps"),
}


@dataclass(frozen=True)
class Trial:
    """Of one object: ratios by joint with the readout known and ignored, and what was estimated (error, std) [s]."""

    known: list[float]
    ignored: list[float]
    from_nothing: tuple[float, float]
    from_short: tuple[float, float]
    motion_px_s: float


def run(job: tuple[str, int, int]) -> Trial | None:
    """(row, seed, trial); None where the tree was not found in one of them."""
    name, seed, trial = job
    seeds = [seed, list(ROWS).index(name), trial]
    scene = replace(ROWS[name], joints=int(np.random.default_rng(seeds).integers(JOINTS[0], JOINTS[1] + 1)))
    by_rows = replace(SEEING, readout_s=READOUT_S)
    without = errors(watched(seeds, scene, SEEING))
    known = errors(watched(seeds, scene, by_rows))
    ignored = errors(watched(seeds, scene, replace(by_rows, told_readout_s=0.0)))
    if not without or not known:
        return None
    px = corners_px(watched(seeds, scene, SEEING).seen, watched(seeds, scene, SEEING).true_camera, scene.t_s)
    return Trial(
        [a / b for a, b in zip(known, without, strict=True)],
        [a / b for a, b in zip(ignored, without, strict=True)] if ignored else [],
        estimated(watched(seeds, scene, replace(by_rows, told_readout_s=0.0))),
        estimated(watched(seeds, scene, replace(by_rows, told_readout_s=SHORT_S))),
        float(np.sqrt(np.mean((np.diff(px, axis=0) * FPS) ** 2) * 2)),
    )


def errors(found: Watched) -> list[float]:
    """Root mean square errors of the joints' states; none for a wrong tree."""
    return [joint.state_rms for joint in held(found, fitted(found)).joints]


def estimated(found: Watched) -> tuple[float, float]:
    """Error of the readout and its standard deviation [s]."""
    options = FitOptions(root=found.tree.root, camera_numbers=("edge_shift_px", "readout_s"))
    image = fitted(found, options).image
    if image is None:
        return np.nan, np.nan
    return image.numbers.readout_s - READOUT_S, image.numbers_std.readout_s


def ratio_text(values: list[float], wanted: float) -> str:
    """Median and most, with a mark where the median misses."""
    if not values:
        return f"{'-':>6}  {'-':>5}"
    median = float(np.median(values))
    return f"{median:6.2f}{'<' if median > wanted else ' '} {max(values):5.2f}"


def readout_text(told: list[tuple[float, float]]) -> str:
    """Errors [ms], median and most, with a mark where one misses."""
    off = 1e3 * np.abs(np.array(told)[:, 0])
    return f"{np.median(off):6.3f} {np.max(off):6.3f}{'<' if np.max(off) > 1e3 * WANTED_S else ' '}"


def stated_text(told: list[tuple[float, float]]) -> str:
    """Median standard deviation [ms], and the share of 95 % intervals that hold the truth."""
    error, std = np.array(told).T
    return f"{1e3 * np.median(std):5.3f} {100 * np.mean(np.abs(error) < norm.ppf(0.975) * std):5.0f}"


def row(name: str, tried: list[Trial | None]) -> str:
    """One line of the table."""
    found = [trial for trial in tried if trial is not None]
    line = f"{name:20} {len(tried):4d} {len(tried) - len(found):5d} |"
    if not found:
        return line
    known = ratio_text([x for trial in found for x in trial.known], WANTED_RATIO)
    ignored = ratio_text([x for trial in found for x in trial.ignored], np.inf)
    nothing, short = [trial.from_nothing for trial in found], [trial.from_short for trial in found]
    motion = np.median([trial.motion_px_s for trial in found])
    estimates = f"{readout_text(nothing)} {stated_text(nothing)} | {readout_text(short)}"
    return f"{line} {motion:6.0f} | {known} | {ignored} | {estimates}"


HEAD = """\
                          wrong | motion | 25 ms, known  |    ignored    | estimated from 0 [ms]      | from 20 [ms]
scene                runs trees |   px/s | median   most | median   most |  error   most    std  in % |  error   most"""


def main() -> None:
    """Print a row for each kind of motion."""
    options = parser(__doc__, trials=20, quick=3)
    options.add_argument("--only", default="", help="rows whose name has this in it")
    chosen = options.parse_args()
    print(HEAD)
    for name in ROWS:
        if chosen.only in name:
            jobs = [(name, chosen.seed, trial) for trial in range(trials_of(chosen))]
            print(row(name, each(run, jobs, chosen.workers)), flush=True)


if __name__ == "__main__":
    main()
