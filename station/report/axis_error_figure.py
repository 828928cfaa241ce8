"""How far a sweep's fits have joints' axes off, against noise, for each inflation, beside the Cramer-Rao bound."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from station.experiments import Cell, NoiseLevel, Sweep
from station.experiments.bounds import cell_bounds, median_error
from station.fit.parallel import products_in_one_thread
from station.logs import FloatArray
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.sweep_levels import conditions, label_levels, method_colour, rows_of, shifts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Objects at each noise level and inflation that the bound is computed of: it differs little from one to the next.
BOUND_REPEATS = 8
ROW_IN, HEAD_IN, FOOT_IN = 2.3, 0.6, 0.96
LEAST_DEG = 1e-4
Bounds = Mapping[tuple[str, NoiseLevel, int], list[FloatArray]]


def axis_error_figure(sweep: Sweep) -> Figure:
    """Errors of the axes of joints that were found with their type, a row a type, a column an inflation.

    A dot a joint, a line through the medians; the bound is the median error of an estimate that attains the Cramer-Rao
    bound on the same objects (`station.tree_bounds`), all of them: fits that have another type are left out of the
    dots, not of it.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    grid = sweep.grid
    types = axis_types(sweep)
    least = bounds_by_type(sweep)
    height_in = HEAD_IN + ROW_IN * max(len(types), 1) + FOOT_IN
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        cells = figure.add_gridspec(
            max(len(types), 1), len(grid.inflation), left=0.075, right=0.99, top=1 - HEAD_IN / height_in,
            bottom=FOOT_IN / height_in, wspace=0.08, hspace=0.12,
        )  # fmt: skip
        for row, kind in enumerate(types):
            first = None
            for column, inflation in enumerate(grid.inflation):
                axes = figure.add_subplot(cells[row, column], sharey=first)
                first = first or axes
                _draw_panel(axes, sweep, kind, inflation, least)
                axes.tick_params(labelleft=column == 0, labelbottom=row == len(types) - 1)
                if row == 0:
                    axes.set_title(f"inflation {inflation}", fontsize=9, loc="left")
                if column == 0:
                    axes.set_ylabel(f"{kind}: axis error [deg]")
            if first is not None:
                _widen(first)
        looks = [
            Line2D([], [], color=method_colour(name), marker="o", ms=4, lw=1.8, label=f"method {name}: median")
            for name in grid.methods
        ]
        looks.append(Line2D([], [], color=LIGHT.ink, lw=1.4, ls="--", label=_bound_name(sweep)))
        figure.legend(handles=looks, loc="upper left", bbox_to_anchor=(0.07, 1.0), ncols=3, frameon=False, fontsize=8.5)
        figure.text(0.99, 0.06 / height_in, conditions(sweep), ha="right", va="bottom", fontsize=7.5)
        return figure


def axis_types(sweep: Sweep) -> list[str]:
    """The types of joints with an axis, in the trees' order."""
    joints = [joint for named in sweep.grid.trees for joint in named.tree.movable if joint.axis_parent is not None]
    return list(dict.fromkeys(joint.type for joint in joints))


def bounds_by_type(sweep: Sweep) -> Bounds:
    """Covariances (2, 2) of the axes at the bound [rad^2], by type, noise level and inflation."""
    found: dict[tuple[str, NoiseLevel, int], list[FloatArray]] = defaultdict(list)
    with products_in_one_thread():  # of matrices so small that more threads only wait for each other
        for cell in _distinct(sweep):
            tree = sweep.grid.tree(cell.tree)
            types = {joint.name: joint.type for joint in tree.movable}
            for bound in cell_bounds(cell, tree):
                if bound.axis.size:
                    found[types[bound.joint], cell.noise, cell.options.inflation].append(bound.axis)
    return found


def _distinct(sweep: Sweep) -> list[Cell]:
    """The cells of the first method, of the first repeats: all methods see the same logs."""
    return [cell for cell in sweep.grid.cells() if cell.method == sweep.grid.methods[0] and cell.repeat < BOUND_REPEATS]


def _bound_name(sweep: Sweep) -> str:
    """The bound is one of Gaussian noise; of another it is the best linear estimate's."""
    if sweep.grid.noise_model == "gaussian":
        return "Cramér-Rao bound: median of an efficient fit"
    return "Cramér-Rao bound of Gaussian noise with this covariance, median"


def _draw_panel(axes: Axes, sweep: Sweep, kind: str, inflation: int, least: Bounds) -> None:
    levels, beside = sweep.grid.noise, shifts(sweep.grid.methods)
    for method in sweep.grid.methods:
        errors = [axis_errors(sweep, method, kind, level, inflation) for level in levels]
        colour, x = method_colour(method), np.arange(len(levels)) + beside[method]
        for at, values in zip(x, errors, strict=True):
            axes.plot(np.full(len(values), at), values, "o", color=colour, ms=2.6, alpha=0.35, mew=0, zorder=2)
        medians = [float(np.median(values)) if len(values) else np.nan for values in errors]
        axes.plot(x, medians, color=colour, marker="o", ms=4, lw=1.8, zorder=4)
    bounds = [median_error(least.get((kind, level, inflation), [])) for level in levels]
    degrees = [np.nan if bound is None else np.degrees(bound) for bound in bounds]
    axes.plot(range(len(levels)), degrees, color=LIGHT.ink, lw=1.4, ls="--", zorder=3)
    axes.set_yscale("log")
    label_levels(axes, levels)


def _widen(axes: Axes) -> None:
    """At least a decade of errors, in plain numbers."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    low, high = axes.get_ylim()
    more = max(1.0, np.sqrt(10 * low / high))
    axes.set_ylim(low / more, high * more)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def axis_errors(sweep: Sweep, method: str, kind: str, level: NoiseLevel, inflation: int) -> FloatArray:
    """(N,) [deg] of joints of a type that were found with it."""
    rows = rows_of(sweep, method, level=level, inflation=inflation)
    told = [joint.axis_error_deg for row in rows for joint in row.joints if joint.true_type == kind]
    return np.array([max(error, LEAST_DEG) for error in told if error is not None])
