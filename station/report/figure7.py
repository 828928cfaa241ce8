"""The paper's Figure 7: commanded, read-back and detected states of every joint, their error, the viewing angle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE, Comparison, JointComparison
from station.logs import FloatArray
from station.report import thinning
from station.report.curves import BAND, BAND_SIGMAS, DETECTED, draw_band, draw_detected, draw_line
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import session_lag_text, shortened, three_digits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

Viewing = Mapping[str, tuple[FloatArray, FloatArray]]
"""By joint: times (T,) [s] and the angle (T,) [deg] of the markers' normal off the line of sight; NaN where unseen."""

# Views more oblique than this are shaded: there the paper found the detection less accurate.
OBLIQUE_DEG = 60.0
# Deg or mm: the error's axis is never finer.
LEAST_ERROR_RANGE = 0.01
# Height of the line that tells the lag.
NOTE_IN = 0.22

COMMANDED = "commanded"
MEASURED = "servo read-back"
ERROR_TO_MEASURED = "error: detected - rounded read-back"
ERROR_TO_COMMAND = "error: detected - command"
VIEW = "markers' viewing angle"
OBLIQUE = f"oblique view, over {OBLIQUE_DEG:.0f} deg"
LEGEND = (COMMANDED, MEASURED, DETECTED, BAND, ERROR_TO_MEASURED, ERROR_TO_COMMAND, VIEW, OBLIQUE)


def figure7(comparison: Comparison, viewing_angles_deg: Viewing | None) -> Figure:
    """The paper's Figure 7 for every compared joint: two columns, one joint alone takes the width.

    Each joint: commanded (steps), read-back and detected states with the detection's band of +-2 standard deviations;
    below, the error detected - read-back (- command where there is no read-back) over a band of +-2 standard deviations
    about zero; below that, the markers' viewing angle, shaded throughout where over 60 deg. The band is of the
    detection alone: the error has the read-back's rounding to whole counts in it too. Where a lag was applied, commands
    and read-back are drawn that much later, and a panel tells its RMSE without it, too.

    Args:
        comparison: what to draw, in degrees or millimetres.
        viewing_angles_deg: by commanded joint; a joint without keeps an empty strip, None leaves the strips out.
    """
    from matplotlib.figure import Figure

    joints = comparison.joints
    columns = min(len(joints), 2) or 1
    rows = -(-len(joints) // columns) or 1
    top_in = 0.8 if comparison.lag.lag_s is None else 0.8 + NOTE_IN
    height_in = top_in + 0.2 + rows * (4.4 if columns == 1 else 3.7)
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        if not joints:
            figure.text(0.5, 0.5, "no detected joint follows a command or a read-back", ha="center", va="center")
            return figure
        grid = figure.add_gridspec(
            rows,
            columns,
            left=0.092,
            right=0.99,
            top=1 - top_in / height_in,
            bottom=0.5 / height_in,
            hspace=0.24,
            wspace=0.25,
        )
        panels = [
            _draw_joint(figure, grid[i // columns, i % columns], joint, viewing_angles_deg)
            for i, joint in enumerate(joints)
        ]
        for axes in panels[-columns:]:
            axes[-1].set_xlabel("time [s]")
        _draw_legend(figure, panels, height_in)
        if comparison.lag.lag_s is not None:
            at = 1 - (top_in - 0.28 - NOTE_IN / 2) / height_in
            figure.text(0.5, at, session_lag_text(comparison), ha="center", va="center", fontsize=8.5)
        for column in range(columns):
            figure.align_ylabels([panel for axes in panels[column::columns] for panel in axes])
        return figure


def _draw_joint(figure: Figure, cell: SubplotSpec, joint: JointComparison, viewing: Viewing | None) -> list[Axes]:
    ratios = [3.0, 1.5] if viewing is None else [3.0, 1.5, 0.85]
    inner = cell.subgridspec(len(ratios), 1, height_ratios=ratios, hspace=0.1)
    axes = [figure.add_subplot(inner[0, 0])]
    axes += [figure.add_subplot(inner[row, 0], sharex=axes[0]) for row in range(1, len(ratios))]
    for upper in axes[:-1]:
        upper.tick_params(labelbottom=False)
    _draw_states(axes[0], joint)
    _draw_error(axes[1], joint)
    if viewing is not None:
        _draw_viewing(axes, viewing.get(joint.joint))
    axes[0].margins(x=0)
    before = _before(joint)
    axes[0].set_title(_title(joint, 10 if before else 24), loc="left", fontsize=9.5, fontweight="bold", pad=5)
    axes[0].set_title(before, loc="right", fontsize=8, pad=5)
    return axes


def _draw_states(axes: Axes, joint: JointComparison) -> None:
    """The read-back is the widest and the detection covers the command: where they agree, all but that one show."""
    scale, unit = UNIT_SCALE[joint.unit], UNIT_NAME[joint.unit]
    if np.any(np.isfinite(joint.measured)):
        axes.plot(*thinning.line(joint.t_s, scale * joint.measured), color=LIGHT.measured, lw=3.6, label=MEASURED)
    if np.any(np.isfinite(joint.commanded)):
        commanded = thinning.line(joint.t_s, scale * joint.commanded)
        style = (0, (4, 1.5))
        axes.plot(*commanded, color=LIGHT.commanded, lw=1.0, ls=style, drawstyle="steps-post", label=COMMANDED)
    draw_detected(axes, joint.t_s, scale * joint.detected, scale * joint.detected_std)
    axes.set_ylabel(f"{'angle' if joint.unit == 'rad' else 'position'} [{unit}]")


def _draw_error(axes: Axes, joint: JointComparison) -> None:
    against_measured = joint.against_measured is not None
    reference = joint.measured if against_measured else joint.commanded
    scale = UNIT_SCALE[joint.unit]
    error, reach = scale * (joint.detected - reference), BAND_SIGMAS * scale * joint.detected_std
    axes.axhline(0.0, color=LIGHT.ink, lw=0.6)
    draw_band(axes, joint.t_s, np.zeros_like(reach), reach)
    label = ERROR_TO_MEASURED if against_measured else ERROR_TO_COMMAND
    draw_line(axes, joint.t_s, error, LIGHT.ink, width=0.5, label=label)
    greatest = max(_percentile(np.abs(error), 100.0), _percentile(reach, 95.0), LEAST_ERROR_RANGE)
    axes.set_ylim(-1.1 * greatest, 1.1 * greatest)
    axes.set_ylabel(f"error\n[{UNIT_NAME[joint.unit]}]")


def _draw_viewing(axes: Sequence[Axes], viewing: tuple[FloatArray, FloatArray] | None) -> None:
    strip = axes[-1]
    strip.set_ylim(0, 90)
    strip.set_yticks([0, OBLIQUE_DEG])
    strip.set_ylabel("view\n[deg]")
    strip.axhline(OBLIQUE_DEG, color=LIGHT.faint, lw=0.8)
    if viewing is None:
        strip.text(0.5, 0.5, "not known", transform=strip.transAxes, ha="center", va="center", fontsize=8)
        return
    t_s, angle_deg = viewing
    strip.plot(*thinning.line(t_s, angle_deg), color=LIGHT.viewing, lw=1.0, label=VIEW)
    with np.errstate(invalid="ignore"):
        t_s, oblique = thinning.flags(t_s, angle_deg > OBLIQUE_DEG)
    if np.any(oblique):
        for panel in axes:
            panel.fill_between(
                t_s,
                0,
                1,
                where=oblique.tolist(),
                transform=panel.get_xaxis_transform(),
                color=LIGHT.oblique,
                alpha=0.16,
                lw=0,
                zorder=0,
                label=OBLIQUE,
            )


def _draw_legend(figure: Figure, panels: Sequence[Sequence[Axes]], height_in: float) -> None:
    entries = {
        label: handle
        for axes in panels
        for panel in axes
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    labels = [label for label in LEGEND if label in entries]
    figure.legend(
        [entries[label] for label in labels],
        labels,
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - 0.03 / height_in),
        ncols=min(len(labels), 4),
        frameon=False,
        fontsize=9,
        columnspacing=2.2,
    )


def _title(joint: JointComparison, name_letters: int) -> str:
    name = "read-back" if joint.against_measured else "command"
    agreement = joint.against_measured or joint.against_commanded
    if agreement is None:
        return joint.joint
    rmse = f"{three_digits(UNIT_SCALE[joint.unit] * agreement.rmse)} {UNIT_NAME[joint.unit]}"
    return f"{shortened(joint.joint, name_letters)}: RMSE {rmse} to {name}"


def _before(joint: JointComparison) -> str:
    """The RMSE without the lag, where that is another number."""
    agreement = joint.against_measured
    if agreement is None or np.isnan(agreement.rmse_before_lag):
        return ""
    after, before = (
        three_digits(UNIT_SCALE[joint.unit] * rmse) for rmse in (agreement.rmse, agreement.rmse_before_lag)
    )
    return "" if before == after else f"{before} before lag"


def _percentile(values: FloatArray, percent: float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, percent)) if len(finite) else 0.0
