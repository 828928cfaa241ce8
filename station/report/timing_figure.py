"""When frames came and servos were read: intervals over time and as histograms, replies of the bus, frames lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from station.logs import FloatArray
from station.report import thinning
from station.report.material import Timing
from station.report.style import LIGHT, WIDTH_IN, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_IN = 1.55
BINS = 60
MS_PER_S = 1e3
# Bars of frames lost over time.
LOST_BINS = 120


def timing_figure(timing: Timing) -> Figure:
    """A row each for the frames' intervals, the readings' intervals and the bus's replies [ms], where there are any.

    Left over time, right how often (of their logarithm, so that the rare ones show). Below, frames lost over time.
    """
    from matplotlib.figure import Figure

    rows = [
        ("frames: interval", timing.frame_s[1:], np.diff(timing.frame_s), LIGHT.viewing),
        ("readings: interval", timing.reading_s[1:], np.diff(timing.reading_s), LIGHT.measured),
        ("readings: request to reply", timing.reading_s, timing.reply_s - timing.request_s, LIGHT.measured),
    ]
    rows = [row for row in rows if len(row[1])]
    lost = bool(timing.lost.any())
    count = max(len(rows) + lost, 1)
    height_in = 0.6 + ROW_IN * count
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        grid = figure.add_gridspec(
            count,
            2,
            width_ratios=[2.4, 1],
            left=0.075,
            right=0.985,
            top=1 - 0.25 / height_in,
            bottom=0.48 / height_in,
            hspace=0.55,
            wspace=0.16,
        )
        first: Axes | None = None
        for row, (title, t_s, interval_s, colour) in enumerate(rows):
            left = figure.add_subplot(grid[row, 0], sharex=first)
            first = first or left
            _draw_times(left, title, t_s, interval_s, colour)
            _draw_histogram(figure.add_subplot(grid[row, 1]), interval_s, colour)
        if lost:
            last = figure.add_subplot(grid[len(rows), 0], sharex=first)
            first = first or last
            _draw_lost(last, timing)
        if first is not None:
            first.margins(x=0)
            bottom = [axes for axes in figure.axes if axes.get_subplotspec().colspan.start == 0][-1]  # type: ignore[union-attr]
            bottom.set_xlabel("time [s]")
        return figure


def _draw_times(axes: Axes, title: str, t_s: FloatArray, interval_s: FloatArray, colour: str) -> None:
    axes.set_title(title, loc="left", fontsize=8.5, pad=3)
    axes.plot(*thinning.line(t_s, MS_PER_S * interval_s), color=colour, lw=0.7)
    axes.set_ylabel("[ms]")
    axes.set_ylim(0, 1.1 * MS_PER_S * max(float(interval_s.max()), 1e-6))


def _draw_histogram(axes: Axes, interval_s: FloatArray, colour: str) -> None:
    """Equal bins from least to most; a clock that never varies has one bar."""
    ms = MS_PER_S * interval_s
    low, high = float(ms.min()), float(ms.max())
    if high - low < 1e-3 * max(high, 1e-6):
        low, high = 0.9 * low, 1.1 * high + 1e-6
    counts, edges = np.histogram(ms, bins=BINS, range=(low, high))
    axes.bar(edges[:-1], counts, np.diff(edges), align="edge", color=colour)
    axes.set_yscale("log")
    axes.set_ylim(0.7, 1.5 * max(int(counts.max()), 2))
    axes.set_title("how often, by length [ms]", loc="left", fontsize=8.5, pad=3)


def _draw_lost(axes: Axes, timing: Timing) -> None:
    edges = np.linspace(timing.frame_s[0], timing.frame_s[-1], LOST_BINS + 1)
    counts, _ = np.histogram(timing.frame_s, bins=edges, weights=timing.lost)
    axes.bar(edges[:-1], counts, np.diff(edges), align="edge", color=LIGHT.oblique)
    axes.set_title("frames lost before", loc="left", fontsize=8.5, pad=3)
    axes.set_ylim(0, 1.1 * max(float(counts.max()), 1.0))
