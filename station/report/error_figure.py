"""How large the errors are at which viewing angle, and when: with what the fit predicts of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE, Comparison, JointComparison
from station.logs import FloatArray
from station.report.binned import Binned, binned, errors_of
from station.report.figure7 import OBLIQUE_DEG, Viewing
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import shortened

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_IN = 1.75
ANGLES_DEG = np.arange(0.0, 91.0, 5.0)
TIME_BINS = 60

ERROR, PREDICTED = "RMS error", "predicted: the detection alone"
ROUNDED = "predicted, with the read-back's rounding"
FRAMES = "share of the frames"


def error_figure(comparison: Comparison, viewing: Viewing | None, steps: Mapping[str, float]) -> Figure:
    """A row a joint: RMS errors in bins of 5 deg of the viewing angle, and in 60 bins of time.

    Beside them the RMS of the stated standard deviations, alone and with the rounding of a read-back whose counts are
    `steps` [rad or m], by joint: `sqrt(std^2 + step^2 / 12)`. Behind, where the frames are.
    """
    from matplotlib.figure import Figure

    joints = comparison.joints
    height_in = 0.95 + ROW_IN * len(joints)
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        grid = figure.add_gridspec(
            len(joints),
            2,
            left=0.075,
            right=0.985,
            top=1 - 0.62 / height_in,
            bottom=0.48 / height_in,
            hspace=0.55,
            wspace=0.16,
        )
        for row, joint in enumerate(joints):
            left, right = (figure.add_subplot(grid[row, column]) for column in range(2))
            step = steps.get(joint.joint, 0.0)
            _draw_angles(left, joint, None if viewing is None else viewing.get(joint.joint), step)
            _draw_times(right, joint, step)
            if row == len(joints) - 1:
                left.set_xlabel("markers' viewing angle [deg]")
                right.set_xlabel("time [s]")
        _draw_legend(figure, height_in)
        return figure


def _draw_angles(
    axes: Axes, joint: JointComparison, viewing: tuple[FloatArray, FloatArray] | None, step: float
) -> None:
    unit = UNIT_NAME[joint.unit]
    axes.set_title(shortened(joint.joint, 24), loc="left", fontsize=9.5, fontweight="bold", pad=4)
    axes.set_ylabel(f"[{unit}]")
    axes.set_xlim(0, 90)
    axes.axvspan(OBLIQUE_DEG, 90, color=LIGHT.oblique, alpha=0.12, lw=0)
    if viewing is None:
        axes.text(0.5, 0.5, "viewing angle not known", transform=axes.transAxes, ha="center", va="center", fontsize=8)
        return
    t_s, angle_deg = viewing
    at_deg = np.interp(joint.t_s, t_s, angle_deg) if len(t_s) else np.full(len(joint.t_s), np.nan)
    _draw(axes, binned(at_deg, errors_of(joint), joint.detected_std, ANGLES_DEG), joint.unit, step)


def _draw_times(axes: Axes, joint: JointComparison, step: float) -> None:
    if len(joint.t_s) < 2:
        return
    edges = np.linspace(joint.t_s[0], joint.t_s[-1], TIME_BINS + 1)
    _draw(axes, binned(joint.t_s, errors_of(joint), joint.detected_std, edges), joint.unit, step)
    axes.set_xlim(edges[0], edges[-1])


def _draw(axes: Axes, bins: Binned, unit: str, step: float) -> None:
    scale = UNIT_SCALE[unit]
    error, predicted = scale * bins.error, scale * bins.predicted
    rounded = np.hypot(predicted, scale * step / np.sqrt(12))
    axes.plot(bins.centres, predicted, color=LIGHT.detected, lw=1.1, label=PREDICTED)
    if step > 0:
        axes.plot(bins.centres, rounded, color=LIGHT.measured, lw=1.4, ls=(0, (4, 1.5)), label=ROUNDED)
    axes.plot(bins.centres, error, color=LIGHT.ink, lw=0.9, marker="o", ms=2.6, label=ERROR)
    shown = np.concatenate([error, predicted, rounded if step > 0 else []])
    top = float(np.nanmax(shown)) if np.any(np.isfinite(shown)) else 1.0
    axes.set_ylim(0, 1.15 * top if top > 0 else 1.0)
    share = bins.frames / max(int(bins.frames.max(initial=0)), 1)
    width = np.diff(bins.edges)
    transform = axes.get_xaxis_transform()
    axes.bar(bins.centres, 0.3 * share, width, transform=transform, color=LIGHT.faint, zorder=0, label=FRAMES)


def _draw_legend(figure: Figure, height_in: float) -> None:
    entries = {
        label: handle for axes in figure.axes for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    labels = [label for label in (ERROR, PREDICTED, ROUNDED, FRAMES) if label in entries]
    figure.legend(
        [entries[label] for label in labels],
        labels,
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - 0.02 / height_in),
        ncols=4,
        frameon=False,
        fontsize=9,
        columnspacing=2.2,
    )
