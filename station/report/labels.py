"""Labels beside points that keep clear of each other and of lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from station.logs import FloatArray
from station.report.style import LIGHT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FONT_PT = 8.0
# Points from the labelled place, tried nearest first, in each of the directions.
DISTANCES_PT = (5.0, 9.0, 16.0, 26.0, 38.0, 52.0, 70.0)
DIRECTIONS = 16
# Farther than this from its place, a label has a line to it.
LINE_PT = 12.0
# From what was written before, such as a scale's length: nearer it would read as one.
APART_PT = 8.0


def place_labels(axes: Axes, labels: Sequence[tuple[FloatArray, str, str]], lines: Sequence[FloatArray]) -> None:
    """Draw texts (place in data, text, colour) clear of each other, of labelled places, lines and earlier texts.

    Nearest places first; where none is free the label goes where it overlaps least. The axes' limits must be set.

    Args:
        lines: polylines (N, 2) in data.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = axes.get_figure(root=True)
    if figure is None or not labels:
        return
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    px_per_pt = figure.dpi / 72
    places = [axes.transData.transform(at) for at, _, _ in labels]
    taken = [np.array([*(at - 5 * px_per_pt), *(at + 5 * px_per_pt)]) for at in places]
    for line in lines:
        taken += [np.array([*(at - px_per_pt), *(at + px_per_pt)]) for at in _sampled(axes, line, 3 * px_per_pt)]
    clear = APART_PT * px_per_pt * np.array([-1, -1, 1, 1])
    taken += [clear + text.get_window_extent(renderer).extents for text in axes.texts if text.get_text()]
    whole = np.array(axes.get_window_extent(renderer).extents)
    for (data, text, colour), at in zip(labels, places, strict=True):
        drawn = axes.text(
            float(data[0]), float(data[1]), text, fontsize=FONT_PT, color=colour, ha="center", va="center", zorder=6
        )
        extent = drawn.get_window_extent(renderer)
        half = np.array([extent.width, extent.height]) / 2 + 1.5 * px_per_pt
        offset = min(_offsets(half, px_per_pt), key=lambda move: _cost(at + move, half, taken, whole, move))
        taken.append(np.concatenate([at + offset - half, at + offset + half]))
        middle = axes.transData.inverted().transform(at + offset)
        drawn.set_position(tuple(middle))
        if np.linalg.norm(np.maximum(np.abs(offset) - half, 0)) > LINE_PT * px_per_pt:
            axes.plot(*np.transpose([data, middle]), color=LIGHT.faint, lw=0.8, zorder=1)


def _sampled(axes: Axes, line: FloatArray, step_px: float) -> FloatArray:
    """(M, 2) places [px] along a polyline (N, 2) in data, about a step apart."""
    corners = np.asarray(axes.transData.transform(line))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.arange(0.0, along[-1], step_px)
    return np.stack([np.interp(at, along, corners[:, column]) for column in range(2)], axis=-1)


def _offsets(half: FloatArray, px_per_pt: float) -> list[FloatArray]:
    """(2,) each: how far the middle of a label of this half size may be from its place [px]."""
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    rays = np.stack([np.cos(angles), np.sin(angles)], -1)
    return [ray * (half + distance * px_per_pt) for distance in DISTANCES_PT for ray in rays]


def _cost(
    middle: FloatArray, half: FloatArray, taken: Sequence[FloatArray], whole: FloatArray, move: FloatArray
) -> tuple[float, float]:
    """What a label there would cover or leave of its panel [px^2], then its distance."""
    low, high = middle - half, middle + half
    boxes = np.array(taken)
    over = np.clip(np.minimum(high, boxes[:, 2:]) - np.maximum(low, boxes[:, :2]), 0, None).prod(axis=1).sum()
    inside = np.clip(np.minimum(high, whole[2:]) - np.maximum(low, whole[:2]), 0, None).prod()
    return float(over + (high - low).prod() - inside), float(np.linalg.norm(move))
