"""The camera's latency on the emulated station: set, found, stated deviation and error, for several seeds and rigs.

    python -m tests.benchmarks.latency [--seeds 3] [--rigs demo,openmanipulator_x] [--joints wrist]

What is to be found is what the rig's simulation sets (from the end of the exposure to the stamp) and half the exposure.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from station.commands.arms import capture_swings, latency_of
from station.formats.toml_edit import set_numbers
from station.rig_reading import packaged, read_rig

SET_MS = (0, 5, 10, 20, 33, 50, 80, 120)


def measure(folder: Path, rig: str, set_s: float, seed: int, joints: list[str]) -> tuple[float, float, float]:
    """Truth, what is found, and its stated deviation, s."""
    text = packaged("rigs", rig).read_text("utf-8")
    path, out = folder / f"{rig}.toml", folder / "session"
    path.write_text(set_numbers(text, {("simulation", "camera", "latency_s"): set_s}, rig), encoding="utf-8")
    capture_swings(str(path), out, joints=joints, seed=seed, force=True)
    simulation = read_rig(str(path))[0].simulation
    assert simulation is not None
    found = latency_of(out).found
    return set_s + simulation.camera.exposure_s / 2, found.latency_s, found.std_s


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--rigs", default="demo,openmanipulator_x")
    parser.add_argument("--joints", default="", help="all revolute ones if left out")
    given = parser.parse_args()
    joints = [name for name in given.joints.split(",") if name]
    print(f"{'rig':20} {'set':>5} {'truth':>7} {'found':>8} {'std':>6} {'mean error':>11} {'worst error':>12}   [ms]")
    worst_ms = 0.0
    for rig in given.rigs.split(","):
        for set_ms in SET_MS:
            with tempfile.TemporaryDirectory() as folder:
                runs = [measure(Path(folder), rig, set_ms * 1e-3, seed, joints) for seed in range(given.seeds)]
            truth, found, std = 1e3 * np.array(runs).T
            error = found - truth
            worst_ms = max(worst_ms, float(np.abs(error).max()))
            print(
                f"{rig:20} {set_ms:5d} {truth[0]:7.2f} {found.mean():8.2f} {std.mean():6.2f} {error.mean():+11.2f} "
                f"{error[np.argmax(np.abs(error))]:+12.2f}",
                flush=True,
            )
    print(f"worst error {worst_ms:.2f} ms; 2 ms are asked for")


if __name__ == "__main__":
    main()
