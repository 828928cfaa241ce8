"""A picture of what the four motions for any rig command on a packaged one, joint by joint: docs/motions.png.

Run: python -m tests.benchmarks.motion_pictures [--rig NAME] [--out FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from station.commands.planning import plan
from tests.benchmarks.packaged_motions import MOTIONS

COLOURS = ("#0b62a8", "#c2571a", "#2a7d4f", "#8a3fa0", "#5b5b5b", "#a8323e", "#7a6a00")


def picture(rig: str) -> Figure:
    """Four panels, one above the other, over the same times."""
    plans = {name: plan(rig, name) for name in MOTIONS}
    longest_s = max(each.duration_s for each in plans.values())
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    panels = figure.subplots(len(plans), 1, sharex=True)
    for axes, (name, planned) in zip(panels, plans.items(), strict=True):
        t_s = np.arange(0.0, planned.duration_s, 0.02)
        for joint, states, colour in zip(planned.joints, planned.commanded(t_s).T, COLOURS, strict=False):
            shown = np.degrees(states) if joint.unit == "rad" else 1e3 * states
            axes.plot(t_s, shown, colour, linewidth=1.4, label=joint.name)
        axes.set_title(f"{name}, {planned.duration_s:.0f} s", loc="left", fontsize=10)
        axes.set_ylabel("deg")
        axes.grid(visible=True, color="#dddddd", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0.0, longest_s)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=7, frameon=False)
    return figure


def main() -> None:
    """Draw it."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rig", default="demo", help="name of a packaged rig whose joints are all revolute")
    options.add_argument("--out", type=Path, default=Path("docs/motions.png"), help="file of the picture")
    chosen = options.parse_args()
    figure = picture(chosen.rig)
    FigureCanvasAgg(figure).print_png(chosen.out, metadata={"Software": None})


if __name__ == "__main__":
    main()
