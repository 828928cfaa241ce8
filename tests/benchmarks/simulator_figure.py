"""The figure of docs/simulator.md: how states move, and how each model of noise errs.

Run: python -m tests.benchmarks.simulator_figure [--seed N] [--out FOLDER]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from station.formats.trees import load_tree
from station.kinematics import se3
from station.logs import FloatArray
from station.report.style import LIGHT, WIDTH_IN, styled
from station.simulate import NOISE_MODELS, SimulationOptions, make_noise, simulate

DPI = 130
TREE, JOINT = "lamp", "bend"
FRAMES, POSES, SHOWN = 200, 200_000, 1500
EPS_M, EPS_RAD = 0.001, 0.01
COLOURS = dict(zip(NOISE_MODELS, (LIGHT.commanded, LIGHT.viewing, LIGHT.oblique, LIGHT.detected), strict=True))
LINES = dict(zip(NOISE_MODELS, ("-", "--", "-.", ":"), strict=True))


def draw_motions(axes: Axes, seed: int) -> None:
    """A joint's state over time, in both motions, within its limits."""
    tree = load_tree(TREE)
    low, high = np.degrees(tree.joint(JOINT).limits or (0.0, 0.0))
    axes.axhspan(low, high, color=LIGHT.commanded, alpha=0.08, linewidth=0)
    for motion, style, colour in (("walk", "-", LIGHT.detected), ("smooth", "--", LIGHT.viewing)):
        states = simulate(tree, SimulationOptions(frames=FRAMES, motion=motion), seed).states
        axes.plot(states.t_s, np.degrees(states.state(JOINT)), style, color=colour, label=motion)
    axes.set(xlabel="time [s]", ylabel=f"{JOINT} of {TREE} [deg]", ylim=(low - 12, high + 36), title="motions")
    axes.legend(loc="upper center", ncols=2)


def errors(name: str, count: int, seed: int) -> FloatArray:
    """(N, 3) errors of position in units of the magnitude, at 1 m before a camera, z along the line of sight."""
    T = se3.translation(np.tile([0.0, 0.0, 1.0], (count, 1)))
    seen = make_noise(name, EPS_M, EPS_RAD).perturbed(T, np.random.default_rng(seed))
    return (seen - T)[:, :3, 3] / EPS_M


def draw_clouds(axes: Axes, seed: int) -> None:
    """Errors across and along the line of sight, of the paper's noise and of a camera's."""
    for name, size in (("camera", 1.5), ("uniform", 1.0)):
        x, _, z = errors(name, SHOWN, seed).T
        axes.plot(x, z, ".", markersize=size, color=COLOURS[name], label=name)
    axes.set(xlabel="error across the line of sight", ylabel="error along it", title="position, in magnitudes")
    axes.set(xlim=(-16, 16), ylim=(-16, 16), aspect="equal")
    axes.legend(loc="upper right", markerscale=5)


def draw_tails(axes: Axes, seed: int) -> None:
    """Share of errors across the line of sight beyond so many magnitudes."""
    share = np.arange(POSES, 0, -1) / POSES
    for name in NOISE_MODELS:
        x = np.sort(np.abs(errors(name, POSES, seed)[:, 0]))
        axes.semilogy(x, share, LINES[name], color=COLOURS[name], label=name)
    axes.set(xlabel="error across the line of sight", ylabel="share beyond", title="tails, in magnitudes")
    axes.set(xlim=(0, 10), ylim=(1e-4, 1.5))
    axes.legend(loc="upper right")


def main() -> None:
    """Write simulator.png."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seed", type=int, default=4)
    options.add_argument("--out", type=Path, default=Path("docs"))
    chosen = options.parse_args()
    matplotlib.use("Agg")
    with styled():
        figure, (left, middle, right) = plt.subplots(1, 3, figsize=(WIDTH_IN, 0.36 * WIDTH_IN), layout="constrained")
        draw_motions(left, chosen.seed)
        draw_clouds(middle, chosen.seed)
        draw_tails(right, chosen.seed)
        figure.savefig(chosen.out / "simulator.png", dpi=DPI)
        plt.close(figure)


if __name__ == "__main__":
    main()
