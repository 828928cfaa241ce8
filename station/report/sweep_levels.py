"""What all figures of a sweep share: how noise levels are told, the methods' colours, which rows are of a level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from station.report.style import LIGHT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from station.experiments import NoiseLevel, Row, Sweep

METHOD_COLOURS = {"paper": LIGHT.detected, "station": LIGHT.viewing}
# Of the distance between two levels: how far the methods stand from each other, so that neither hides the other.
METHOD_SHIFT = 0.12
# What a label of two lines needs.
LEAST_LABEL_IN = 0.5


def level_text(level: NoiseLevel) -> str:
    """Magnitudes of a noise level."""
    return f"{_rounded(1e3 * level.translation_m)} mm, {_rounded(math.degrees(level.rotation_rad))}°"


def _rounded(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def method_colour(method: str) -> str:
    """Colour of a method in all figures."""
    return METHOD_COLOURS.get(method, LIGHT.commanded)


def shifts(methods: Sequence[str]) -> dict[str, float]:
    """By method, how far from its level it stands."""
    return {name: METHOD_SHIFT * (i - (len(methods) - 1) / 2) for i, name in enumerate(methods)}


def rows_of(sweep: Sweep, method: str, *, level: NoiseLevel | None = None, inflation: int | None = None) -> list[Row]:
    """Rows of a method, at one noise level or all, at one inflation or all."""
    return [
        row
        for row in sweep.rows
        if row.cell.method == method
        and (level is None or row.cell.noise == level)
        and (inflation is None or row.cell.options.inflation == inflation)
    ]


def label_levels(axes: Axes, levels: Sequence[NoiseLevel]) -> None:
    """The noise levels along x, evenly, each told in two lines, or aslant in one where there is no room."""
    figure = axes.get_figure(root=True)
    width_in = axes.get_window_extent().width / (figure.dpi if figure else 1.0)
    texts = [level_text(level) for level in levels]
    if width_in / len(levels) >= LEAST_LABEL_IN:
        axes.set_xticks(range(len(levels)), [text.replace(", ", "\n") for text in texts])
    else:
        axes.set_xticks(range(len(levels)), texts, rotation=50, ha="right", rotation_mode="anchor", fontsize=7.0)
    axes.set_xlim(-0.5, len(levels) - 0.5)


def conditions(sweep: Sweep) -> str:
    """One line of what all fits share."""
    grid, options = sweep.grid, sweep.grid.options
    trees = ", ".join(named.name for named in grid.trees)
    told = [f"{options.frames} frames", options.motion, f"{options.root} root", f"{grid.noise_model} noise"]
    told += ["known to the fit"] if options.known_noise else []
    told += ["planar"] if options.planar else []
    told += [f"{100 * options.outliers:g} % outliers"] if options.outliers else []
    told += [f"{100 * options.missing:g} % not seen"] if options.missing else []
    return f"{trees}; {', '.join(told)}"
