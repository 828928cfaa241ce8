"""How often a sweep's fits find the structure and the types, against noise, for each inflation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from station.experiments import Row, Sweep
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.sweep_levels import conditions, label_levels, method_colour, rows_of, shifts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT_IN = 3.5


def structure_figure(sweep: Sweep) -> Figure:
    """The share of all trees' fits that are right, a panel for each inflation.

    Solid: the structure is right, trackers told apart into the true bodies and joints between those that have one.
    Dashed: all joints' types are right, too. A fit that failed counts as wrong. Methods stand a little beside each
    other, so that neither hides the other.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    grid = sweep.grid
    with styled():
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
        cells = figure.add_gridspec(1, len(grid.inflation), left=0.065, right=0.99, top=0.81, bottom=0.275, wspace=0.1)
        first = None
        for column, inflation in enumerate(grid.inflation):
            axes = figure.add_subplot(cells[0, column], sharey=first)
            first = first or axes
            _draw_panel(axes, sweep, inflation)
            axes.tick_params(labelleft=column == 0)
        if first is not None:
            first.set_ylabel("fits that are right [%]")
            first.set_ylim(-5, 105)
        looks = [Line2D([], [], color=method_colour(name), lw=2.0, label=f"method {name}") for name in grid.methods]
        looks += [Line2D([], [], color=LIGHT.ink, marker="o", ms=4, label="structure")]
        looks += [
            Line2D([], [], color=LIGHT.ink, ls="--", marker="s", mfc=LIGHT.paper, ms=4, label="structure and types")
        ]
        figure.legend(handles=looks, loc="upper left", bbox_to_anchor=(0.06, 1.0), ncols=4, frameon=False, fontsize=8.5)
        figure.text(0.99, 0.02, conditions(sweep), ha="right", va="bottom", fontsize=7.5)
        return figure


def _draw_panel(axes: Axes, sweep: Sweep, inflation: int) -> None:
    levels, beside = sweep.grid.noise, shifts(sweep.grid.methods)
    counts: set[int] = set()
    for method in sweep.grid.methods:
        by_level = [rows_of(sweep, method, level=level, inflation=inflation) for level in levels]
        counts |= {len(rows) for rows in by_level}
        x = [i + beside[method] for i in range(len(levels))]
        colour = method_colour(method)
        solid = [_share(rows, [row.structure_correct for row in rows]) for rows in by_level]
        dashed = [_share(rows, [row.types_correct for row in rows]) for rows in by_level]
        axes.plot(x, solid, color=colour, marker="o", ms=4, lw=1.8)
        axes.plot(x, dashed, color=colour, marker="s", mfc=LIGHT.paper, ms=4, lw=1.2, ls="--")
    label_levels(axes, levels)
    fits = str(min(counts)) if len(counts) == 1 else f"{min(counts)} to {max(counts)}"
    axes.set_title(f"inflation {inflation}: {fits} fits a point", fontsize=9, loc="left")


def _share(rows: Sequence[Row], right: Sequence[bool]) -> float:
    """Percent; NaN of none."""
    return 100 * sum(right) / len(rows) if rows else float("nan")
