"""The figures of docs/paper_and_station.md, from what paper_against_station.py measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from station.report.style import LIGHT, WIDTH_IN, styled
from tests.benchmarks import paper_corrections as corrections

if TYPE_CHECKING:
    from tests.benchmarks.paper_against_station import Comparison

DPI = 130
PAPER, STATION, OTHER, PLAIN = LIGHT.detected, LIGHT.viewing, LIGHT.oblique, LIGHT.commanded
# Curves that lie on each other stay readable: a ring around a square around a dot.
STYLES = {
    "station": {"color": STATION, "marker": "o", "markersize": 10, "fillstyle": "none", "label": "station"},
    "paper, true noise": {
        "color": PAPER,
        "marker": "s",
        "markersize": 5.5,
        "label": "paper, told the true noise, unsmoothed",
    },
    "paper": {"color": OTHER, "marker": ".", "markersize": 7, "linestyle": "--", "label": "paper, as it comes"},
}


def draw(folder: Path, found: Mapping[str, object], compared: Sequence[Comparison]) -> None:
    """Write a PNG for each measurement that there is."""
    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    with styled():
        if compared:
            _save(folder, "paper_comparison", _comparison(compared))
        for name, figure in (("metric", _metric), ("starts", _starts), ("aic", _aic), ("smoothing", _smoothing)):
            if name in found:
                _save(folder, f"paper_{name}", figure(found[name]))


def _save(folder: Path, name: str, figure: Figure) -> None:
    figure.savefig(folder / f"{name}.png", dpi=DPI)
    plt.close(figure)


def _panels(count: int, height_in: float = 3.3) -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(1, count, figsize=(WIDTH_IN, height_in), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.06, wspace=0.04)
    return figure, list(np.atleast_1d(axes))


def _title(axes: Axes, letter: str, text: str) -> None:
    axes.set_title(f"{letter}  {text}", loc="left", fontsize=9.5, fontweight="bold")


def _legend(axes: Axes, **where: object) -> None:
    axes.legend(frameon=True, framealpha=0.9, edgecolor="none", fontsize=8, **where)


def _ticks(axes: Axes, values: Sequence[float]) -> None:
    """Plain numbers on a logarithmic axis."""
    axes.set_xscale("log")
    axes.set_xticks(list(values), [f"{x:g}" for x in values])
    axes.minorticks_off()


def _comparison(compared: Sequence[Comparison]) -> Figure:
    from tests.benchmarks.paper_against_station import METHODS, NOISE_MM

    figure, panels = _panels(len(compared) + 1, 3.6)
    for letter, axes, found in zip("ab", panels, compared, strict=False):
        for method, style in STYLES.items():
            right = 100 * found.right[METHODS.index(method)]
            axes.plot(NOISE_MM, right, clip_on=False, zorder=3, **style)
        _title(axes, letter, f"All right, {found.case}")
        axes.set(ylim=(0, 105), ylabel=f"share of {found.objects} objects [%]")
    axes, found = panels[-1], compared[0]
    for method, style in STYLES.items():
        axes.plot(NOISE_MM, found.axis_deg[METHODS.index(method)], **style)
    axes.set(yscale="log", ylabel="median [deg]")
    decades = [0.01, 0.03, 0.1, 0.3, 1, 3, 10]
    axes.set_yticks(decades, [f"{x:g}" for x in decades])
    _title(axes, "abc"[len(compared)], f"Axis error, {found.case}")
    for axes in panels:
        _ticks(axes, NOISE_MM)
        axes.set_xlabel("noise of a tracker [mm]")
    handles, labels = panels[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _metric(found: object) -> Figure:
    invariance, gradients = found  # type: ignore[misc]
    figure, (left, right) = _panels(2, 3.6)
    low, middle, high = np.percentile(invariance.shifted, [5, 50, 95], axis=-1)
    lengths_mm = 1e3 * invariance.lengths_m
    left.fill_between(lengths_mm, low, high, color=PAPER, alpha=0.2, linewidth=0)
    left.plot(lengths_mm, middle, color=PAPER, label="translation on the right (5, 50, 95 %)")
    left.axhline(1, color=STATION, label="any motion on the left, rotation on the right")
    _title(left, "a", "Distance after both poses moved, over that before")
    left.set(xscale="log", yscale="log", xlabel="length of the translation [mm]", ylabel="ratio of distances (15)")
    left.set_yticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
    left.set_xticks([3, 10, 30, 100, 300, 1000], ["3", "10", "30", "100", "300", "1000"])
    left.minorticks_off()
    _legend(left, loc="upper left")
    limit = float(np.abs(gradients.numeric).max()) * 1.08
    right.plot(gradients.numeric.ravel(), gradients.printed.ravel(), ".", color=PAPER, markersize=3, alpha=0.6)
    right.plot(gradients.numeric.ravel(), gradients.corrected.ravel(), ".", color=STATION, markersize=3)
    right.plot([], [], ".", color=PAPER, markersize=8, label="(17) as printed")
    right.plot([], [], ".", color=STATION, markersize=8, label="corrected")
    _title(right, "b", "Rotation gradient of (16)")
    right.set(xlim=(-limit, limit), ylim=(-limit, limit), xlabel="central difference [1/rad]", ylabel="formula [1/rad]")
    right.set_aspect("equal")
    _legend(right, loc="upper center")
    return figure


def _starts(found: object) -> Figure:
    assert isinstance(found, corrections.Starts)
    figure, (left, right) = _panels(2, 3.6)
    colours = (PAPER, OTHER, STATION)
    # The axis is drawn at 1 mm: a logarithmic scale has no zero.
    at_mm = np.where(found.radii_m > 0, 1e3 * found.radii_m, 1.0)
    for s, kind in enumerate(corrections.START_KINDS):
        low, middle, high = np.percentile(found.at_start[:, s], [10, 50, 90], axis=-1)
        left.fill_between(at_mm, low, high, color=colours[s], alpha=0.18, linewidth=0)
        left.plot(at_mm, middle, color=colours[s], marker="os^"[s], markersize=4, label=kind)
        right.plot(at_mm, np.median(found.evaluations[:, s], axis=-1), color=colours[s], marker="os^"[s], markersize=4)
    end = np.percentile(found.at_end[:, 0], [10, 50, 90], axis=-1)
    left.plot(at_mm, end[1], color=PLAIN, linestyle=":", label="after the optimiser, from any of them")
    _title(left, "a", "Axis error of the start (10, 50, 90 %)")
    left.set(yscale="log", ylabel="[deg]", ylim=(0.1, 900))
    left.set_yticks([0.1, 1, 10, 90], ["0.1", "1", "10", "90"])
    _legend(left, loc="upper right", ncols=2)
    _title(right, "b", "What the optimiser needs from there")
    right.set(ylabel="median evaluations of the cost", ylim=(0, None))
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xticks(at_mm, ["on it", *(f"{1e3 * r:g}" for r in found.radii_m[1:])])
        axes.minorticks_off()
        axes.set_xlabel("distance of the child from the axis [mm]")
    return figure


def _aic(found: object) -> Figure:
    rates, overrated = found  # type: ignore[misc]
    figure, (left, right) = _panels(2, 3.6)
    ring = {"marker": "o", "markersize": 10, "fillstyle": "none"}
    left.plot(rates.frames, 100 * rates.station, color=STATION, **ring, label="station (states integrated out)")
    left.plot(rates.frames, 100 * rates.states_counted, color=PLAIN, marker="^", markersize=4, linestyle="--",
              label="AIC with the states counted")  # fmt: skip
    left.plot(rates.frames, 100 * rates.paper, color=PAPER, marker="s", label="AIC (24) with 6, 9, 12 parameters")
    _ticks(left, rates.frames)
    _title(left, "a", "Rigid pairs called rigid, weights of the true noise")
    left.set(ylim=(-4, 104), xlabel="frames", ylabel="[%]")
    _legend(left, loc="center right")
    shades = (PLAIN, LIGHT.measured, PAPER, OTHER)
    for k, travel in enumerate(overrated.travels_deg):
        label = "rigid" if travel == 0 else f"turns by {travel:g} deg"
        right.plot(overrated.factors, 100 * overrated.rigid[k], color=shades[k], linewidth=1.8, label=label)
    _ticks(right, (0.5, 1, 2, 4, 8, 16))
    _title(right, "b", "Called rigid by AIC (24), by the weights")
    right.set(ylim=(-4, 104), xlabel="noise that the weights stand for, over the true noise", ylabel="[%]")
    _legend(right, loc="upper left")
    return figure


def _smoothing(found: object) -> Figure:
    assert isinstance(found, corrections.Smoothed)
    figure, (left, right) = _panels(2, 3.3)
    shades = (STATION, LIGHT.measured, PAPER, OTHER)
    for k, share in enumerate(found.shares):
        label = "unsmoothed" if share == 0.5 else f"low-pass, {share:g} of the frame rate"
        left.plot(found.correlation[k], color=shades[k], marker=".", markersize=4, label=label)
    _title(left, "a", "Correlation of the noise between frames")
    left.set(xlabel="frames apart", ylim=(-0.2, 1.05))
    _legend(left, loc="upper right")
    bars = right.bar(range(len(found.shares)), found.ratio, color=shades, width=0.6)
    right.bar_label(bars, fmt="%.1f", padding=2)
    right.axhline(1, color=PLAIN, linewidth=0.8)
    right.set_xticks(range(len(found.shares)), ["none", *(f"{share:g}" for share in found.shares[1:])])
    right.grid(visible=False, axis="x")
    _title(right, "b", "Error of a rigid offset, over what the likelihood claims")
    right.set(xlabel="cut-off, as a share of the frame rate", ylim=(0, 1.15 * float(found.ratio.max())))
    return figure
