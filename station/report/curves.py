"""Curves that all figures share: a state with its gaps, its band of standard deviations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from station.logs import FloatArray
from station.report import thinning
from station.report.style import LIGHT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Half width of the bands, in standard deviations.
BAND_SIGMAS = 2.0
DETECTED = "detected by the camera"
BAND = f"±{BAND_SIGMAS:.0f} std of the detection alone"


def draw_detected(
    axes: Axes,
    t_s: FloatArray,
    state: FloatArray,
    std: FloatArray,
    *,
    colour: str = LIGHT.detected,
    label: str = DETECTED,
) -> None:
    """A detected state over time with its band; NaN where it was not seen."""
    draw_line(axes, t_s, state, colour, width=1.2, label=label)
    draw_band(axes, t_s, state, BAND_SIGMAS * std, colour=colour)


def draw_line(axes: Axes, t_s: FloatArray, state: FloatArray, colour: str, *, width: float, label: str) -> None:
    """A line, and dots for the frames that stand alone between gaps."""
    t_s, state = thinning.line(t_s, state)
    seen = np.isfinite(state)
    alone = seen & ~np.concatenate(([False], seen[:-1])) & ~np.concatenate((seen[1:], [False]))
    axes.plot(t_s, state, color=colour, lw=width, label=label)
    axes.plot(t_s[alone], state[alone], ".", color=colour, ms=1.5)


def draw_band(
    axes: Axes, t_s: FloatArray, middle: FloatArray, reach: FloatArray, *, colour: str = LIGHT.detected
) -> None:
    """A band of +-reach about the middle; nothing where the reach is unknown."""
    if np.any(np.isfinite(reach)):
        t_s, low, high = thinning.band(t_s, middle - reach, middle + reach)
        axes.fill_between(t_s, low, high, color=colour, alpha=0.3, lw=0, label=BAND)
