"""Time of the learner on simulated objects; `python tests/benchmarks/fit_speed.py`."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "fit"))

from simulated import noisy_log, simulated_tree

from station.fit.learner import learn

CASES = ((5, 300), (10, 300), (10, 600), (10, 1200), (20, 1000))


def main() -> None:
    """Print one row for each number of trackers and frames."""
    print("trackers  pairs  frames  joints  seconds")
    for trackers, frames in CASES:
        rng = np.random.default_rng(0)
        truth = simulated_tree(rng, bodies=trackers // 2, frames=frames, trackers=(2, 2))
        log = noisy_log(rng, truth, sigma_m=0.002, sigma_rad=0.02)
        start = time.perf_counter()
        fit = learn(log)
        seconds = time.perf_counter() - start
        parts = len(log.parts)
        print(f"{parts:8d} {parts * (parts - 1) // 2:6d} {frames:7d} {len(fit.tree.joints):7d} {seconds:8.2f}")


if __name__ == "__main__":
    main()
