"""Time and memory of the tree from corners: 5 markers on 5 bodies with 4 joints, before a simulated camera.

300 frames: wanted at most 2 s; 9,000 frames: at most 45 s and 1.5 GB, on 2 cores, and linear in frames. Each fit is one
of a process of its own, which loads poses and corners and learns the tree; what it takes longer than a fit to the poses
alone is told apart. The least of several runs counts; other programs disturb processor time less than the wall clock.
The peak is that of the process, of which so much was there before the fit: imports and data.

Run: python -m tests.benchmarks.image_speed [--seed N] [--trials N] [--quick]
"""

from __future__ import annotations

import argparse
import pickle
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from station.fit.learner import learn
from station.fit.options import FitOptions
from tests.benchmarks.arguments import parser, trials_of
from tests.benchmarks.fit_speed import KIBIBYTE, exponent
from tests.fit.image.simulated_views import Scene, Seeing, watched

SCENE, SEEING = Scene(joints=4), Seeing(sigma_px=0.1)
FRAMES, QUICK_FRAMES = (300, 1000, 3000, 9000), (300, 1000)
WANTED_S, WANTED_GB = {300: 2.0, 9000: 45.0}, {9000: 1.5}


def make(file: Path, frames: int, seed: int) -> None:
    """Write what a fit takes."""
    found = watched([seed], replace(SCENE, frames=frames), SEEING)
    file.write_bytes(pickle.dumps((found.poses, found.views, found.tree.root)))


def fit(file: Path, refine: str) -> None:
    """Learn, and print wall and processor time [s], and the process's peak before and after [GB]."""
    poses, views, root = pickle.loads(file.read_bytes())
    options = FitOptions(root=root, refine=refine)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start_s = time.perf_counter(), time.process_time()
    learn(poses, options, views if refine == "image" else None)
    wall_s, processor_s = time.perf_counter() - start_s[0], time.process_time() - start_s[1]
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(wall_s, processor_s, before * KIBIBYTE / 1e9, after * KIBIBYTE / 1e9)


def in_child(*arguments: object) -> list[float]:
    """The numbers that this module prints when it is run with these arguments."""
    module = (sys.executable, "-m", "tests.benchmarks.image_speed", *map(str, arguments))
    done = subprocess.run(module, check=True, capture_output=True, text=True)
    return [float(word) for word in done.stdout.split()]


def row(folder: Path, frames: int, seed: int, runs: int) -> float:
    """Print one line; returns processor time of the whole fit [s]."""
    file = folder / f"{frames}.pickle"
    in_child("--seed", seed, "--make", file, frames)
    image, pose = (
        np.min([in_child("--child", file, refine) for _ in range(runs)], axis=0) for refine in ("image", "pose")
    )
    wall_s, processor_s, before, peak = image
    late = "<" if wall_s > WANTED_S.get(frames, np.inf) else " "
    large = "<" if peak > WANTED_GB.get(frames, np.inf) else " "
    print(
        f"{frames:7d} | {wall_s:8.2f}{late} {processor_s:8.2f} | {wall_s - pose[0]:8.2f} {processor_s - pose[1]:8.2f} |"
        f" {peak:7.2f}{large} {before:6.2f}",
        flush=True,
    )
    return float(processor_s)


def main() -> None:
    """Print a row for each number of frames."""
    options = parser(__doc__, trials=3, quick=1)
    options.add_argument("--make", nargs=2, metavar=("FILE", "FRAMES"), help=argparse.SUPPRESS)
    options.add_argument("--child", nargs=2, metavar=("FILE", "REFINE"), help=argparse.SUPPRESS)
    chosen = options.parse_args()
    if chosen.make:
        make(Path(chosen.make[0]), int(chosen.make[1]), chosen.seed)
        return
    if chosen.child:
        fit(Path(chosen.child[0]), chosen.child[1])
        return
    print(f"{'':7} | {'whole fit [s]':^18} | {'of it corners [s]':^17} | {'peak [GB]':^15}")
    print(f"{'frames':>7} | {'wall':>8}  {'proc.':>8} | {'wall':>8} {'proc.':>8} | {'all':>7}  {'before':>6}")
    counts = QUICK_FRAMES if chosen.quick else FRAMES
    with TemporaryDirectory() as folder:
        times_s = [row(Path(folder), frames, chosen.seed, trials_of(chosen)) for frames in counts]
    print(f"processor time grows with frames to the power {exponent(counts, times_s):.2f}; wanted at most 1")


if __name__ == "__main__":
    main()
