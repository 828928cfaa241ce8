"""What a sweep's fits take each type of joint for, by method and noise level."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from station.experiments import NoiseLevel, Sweep
from station.logs import FloatArray
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.sweep_levels import conditions, level_text, method_colour, rows_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NONE = "none"
# Above this percentage figures are written in white.
DARK_ABOVE = 55
CELL_IN, HEAD_IN, FOOT_IN = 0.42, 0.66, 0.95


def types_figure(sweep: Sweep) -> Figure:
    """Confusion of types: a matrix for each method and noise level, all trees and inflations together.

    A row a true type, a column what its joints were taken for, in percent of the row: "rigid" where both bodies were
    taken for one, "none" where no single joint stands between them, or the fit failed.
    """
    from matplotlib.figure import Figure

    grid = sweep.grid
    true, found = type_names(sweep)
    panel_in = CELL_IN * len(true)
    height_in = HEAD_IN + FOOT_IN + len(grid.methods) * panel_in + (len(grid.methods) - 1) * 0.35
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        cells = figure.add_gridspec(
            len(grid.methods),
            len(grid.noise),
            left=0.155,
            right=0.985,
            top=1 - HEAD_IN / height_in,
            bottom=FOOT_IN / height_in,
            wspace=0.08,
            hspace=0.35 / panel_in,
        )
        for row, method in enumerate(grid.methods):
            for column, level in enumerate(grid.noise):
                axes = figure.add_subplot(cells[row, column])
                _draw_matrix(axes, confusion(sweep, method, level), true, found)
                axes.tick_params(labelleft=column == 0, labelbottom=row == len(grid.methods) - 1)
                if row == 0:
                    axes.set_title(level_text(level), fontsize=9)
                if column == 0:
                    _name_row(axes, method)
        figure.text(0.57, 1 - 0.12 / height_in, "what joints of a true type (row) were taken for (column) [%]",
                    ha="center", va="top", weight="bold")  # fmt: skip
        inflation = ", ".join(str(each) for each in grid.inflation)
        text = f"{conditions(sweep)}; inflation {inflation}{' together' if len(grid.inflation) > 1 else ''}"
        figure.text(0.985, 0.06 / height_in, text, ha="right", va="bottom", fontsize=7.5)
        return figure


def type_names(sweep: Sweep) -> tuple[list[str], list[str]]:
    """The true types of all trees, and all that they were taken for; in the trees' order, then "rigid" and "none"."""
    true = list(dict.fromkeys(joint.type for named in sweep.grid.trees for joint in named.tree.movable))
    others = [told.found_type for row in sweep.rows for told in row.joints if told.found_type is not None]
    return true, [*dict.fromkeys([*true, *sorted({*others, "rigid"} - set(true))]), NONE]


def confusion(sweep: Sweep, method: str, level: NoiseLevel) -> FloatArray:
    """Counts (true, found), as `type_names` orders them; a failed fit counts as none for each of its tree's joints."""
    true, found = type_names(sweep)
    counts = np.zeros((len(true), len(found)))
    for row in rows_of(sweep, method, level=level):
        told = {each.joint: each.found_type for each in row.joints}
        for joint in sweep.grid.tree(row.cell.tree).movable:
            counts[true.index(joint.type), found.index(told.get(joint.name) or NONE)] += 1
    return counts


def _draw_matrix(axes: Axes, counts: FloatArray, true: list[str], found: list[str]) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    totals = counts.sum(axis=1, keepdims=True)
    percent = 100 * counts / np.where(totals > 0, totals, 1)
    shades = LinearSegmentedColormap.from_list("shades", [LIGHT.paper, "#1f4e79"])
    axes.imshow(percent, cmap=shades, vmin=0, vmax=100, aspect="auto")
    axes.grid(visible=False)
    axes.set_xticks(range(len(found)), found, rotation=40, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(true)), true)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set(visible=True, color=LIGHT.faint)
    for (i, j), value in np.ndenumerate(percent):
        right = true[i] == found[j]
        if counts[i, j] or (right and totals[i, 0]):
            colour = LIGHT.paper if value > DARK_ABOVE else LIGHT.ink
            weight = "bold" if right else "normal"
            axes.text(j, i, f"{value:.0f}", ha="center", va="center", fontsize=8.5, color=colour, weight=weight)


def _name_row(axes: Axes, method: str) -> None:
    axes.annotate(f"method {method}", (0, 0.5), (-78, 0), xycoords="axes fraction", textcoords="offset points",
                  rotation=90, ha="center", va="center", color=method_colour(method), weight="bold")  # fmt: skip
