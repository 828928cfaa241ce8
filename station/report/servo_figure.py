"""What the servos said of themselves over time: temperature, voltage, load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from station.report import thinning
from station.report.material import Servos
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import shortened

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROW_IN = 1.75
# By servo; told apart by their dashes where the colours come round.
COLOURS = (LIGHT.detected, LIGHT.viewing, LIGHT.measured, LIGHT.oblique, LIGHT.commanded)
DASHES = ("solid", (0, (4, 1.5)), (0, (1, 1.2)))


def servo_figure(servos: Servos) -> Figure:
    """Three rows over time, a line a servo."""
    from matplotlib.figure import Figure

    rows = (
        ("temperature [°C]", servos.temperature_c),
        ("voltage [V]", servos.voltage_v),
        ("load [% of the most]", 100 * servos.load),
    )
    legend_rows = -(-len(servos.names) // 6)
    top_in = 0.15 + 0.2 * legend_rows
    height_in = top_in + 0.5 + ROW_IN * len(rows)
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        grid = figure.add_gridspec(
            len(rows), 1, left=0.075, right=0.985, top=1 - top_in / height_in, bottom=0.48 / height_in, hspace=0.18
        )
        axes = [figure.add_subplot(grid[0, 0])]
        axes += [figure.add_subplot(grid[row, 0], sharex=axes[0]) for row in range(1, len(rows))]
        for panel, (name, values) in zip(axes, rows, strict=True):
            for column in range(len(servos.names)):
                if np.any(np.isfinite(values[:, column])):
                    look = {"color": COLOURS[column % len(COLOURS)], "ls": DASHES[column // len(COLOURS) % len(DASHES)]}
                    panel.plot(*thinning.line(servos.t_s, values[:, column]), lw=1.0, **look)
            panel.set_ylabel(name)
            panel.tick_params(labelbottom=panel is axes[-1])
        axes[0].margins(x=0)
        axes[-1].set_xlabel("time [s]")
        figure.align_ylabels(axes)
        _draw_legend(figure, servos, height_in)
        return figure


def _draw_legend(figure: Figure, servos: Servos, height_in: float) -> None:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=COLOURS[k % len(COLOURS)], ls=DASHES[k // len(COLOURS) % len(DASHES)])
        for k in range(len(servos.names))
    ]
    figure.legend(
        lines,
        [shortened(name, 18) for name in servos.names],
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - 0.02 / height_in),
        ncols=6,
        frameon=False,
        fontsize=8,
    )
