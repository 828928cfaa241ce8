"""Claims of labels in drawings: they keep clear of what stands there already."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from station.report.labels import APART_PT, FONT_PT, place_labels


def test_a_label_is_not_read_with_what_was_written_before():
    figure = Figure(figsize=(4, 3))
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    scale = axes.text(0.5, 0.5, "100 mm", fontsize=FONT_PT, ha="center", va="center")
    place_labels(axes, [(np.array([0.5, 0.398]), "base", "black")], [])
    canvas.draw()
    written = np.array(scale.get_window_extent(canvas.get_renderer()).extents)
    label = np.array(axes.texts[-1].get_window_extent(canvas.get_renderer()).extents)
    gaps = np.concatenate([label[:2] - written[2:], written[:2] - label[2:]])  # right, above, left, below
    assert axes.texts[-1].get_text() == "base"
    assert gaps.max() >= APART_PT * figure.dpi / 72
