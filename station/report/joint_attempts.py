"""What a fit of a sweep made of one joint, drawn in the frame of the joint's parent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from station.experiments import JointRow, Row, Sweep, fitted, simulated
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, PoseLog
from station.report.style import LIGHT
from station.report.view_direction import view_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MEASURED, TRUE, FITTED = LIGHT.measured, LIGHT.ink, LIGHT.detected
UP = np.array([0.0, 1.0, 0.0])
# Of the longest side of what was measured: a fitted axis to either side, orientations, the margin.
AXIS_SHARE, TICK_SHARE, MARGIN_SHARE = 0.22, 0.07, 0.12
# Positions beyond these percentiles don't widen a panel, and frames whose orientation is drawn.
PERCENTILES = (1.0, 99.0)
TICKS = 12
LEAST_REACH_M = 0.005
# Radii beyond so many times the panel's reach are as good as straight: the whole circle would be no help.
LARGEST_CIRCLE = 1.5
SCALES_M = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
TICK_COLOURS = ("#e69f00", "#00795a", "#56b4e9")


@dataclass(frozen=True, eq=False)
class Attempt:
    """One fit's joint beside what was measured and what was true, in the frame of its parent part.

    Attributes:
        row: of the sweep.
        told: what of the row is about the joint.
        measured: (T, 4, 4) poses of the child part as the fit was given them.
        true: (T, 4, 4).
        joint: as it was fitted, from the true joint's parent to its child; None where none was.
    """

    row: Row
    told: JointRow
    measured: FloatArray
    true: FloatArray
    joint: Joint | None


def best_row(rows: Sequence[Row], joint: str) -> Row | None:
    """The repeat that made the best of a joint: of its type, with the least error of the axis.

    Where none is of its type: one with the right structure, else one in which something joins its two bodies; of equals
    the first. None if no fit succeeded.
    """

    def badness(row: Row) -> tuple[bool, float, bool, bool, int]:
        told = joint_row(row, joint)
        error = told.axis_error_deg
        joined = told.found_joint is not None
        off = np.inf if error is None else error
        return told.found_type != told.true_type, off, not row.structure_correct, not joined, row.cell.repeat

    return min((row for row in rows if row.joints), key=badness, default=None)


def joint_row(row: Row, joint: str) -> JointRow:
    """What a row says about a joint."""
    return next(told for told in row.joints if told.joint == joint)


def attempt_of(sweep: Sweep, row: Row, joint: str) -> Attempt:
    """Simulates a row's log again, and takes its fit from the sweep's folder, or fits again."""
    made = simulated(row.cell, sweep.grid.tree(row.cell.tree))
    true, told = made.tree.joint(joint), joint_row(row, joint)
    parent, child, found = true.parent, true.child, None
    if told.found_joint is not None:
        tree = sweep.found_tree(row.cell) or fitted(row.cell, made).tree
        found = _outward(tree.joint(told.found_joint), true, made.tree)
        parent, child = found.parent, found.child
    return Attempt(row, told, _relative(made.log, parent, child), _relative(made.truth, parent, child), found)


def _outward(found: Joint, true: Joint, tree: KinematicTree) -> Joint:
    """The found joint as it hangs from the true one's parent."""
    return found if tree.body_of(found.parent) == tree.body_of(true.parent) else found.reversed()


def _relative(log: PoseLog, parent: str, child: str) -> FloatArray:
    """(T', 4, 4) poses of one part in another where both were seen."""
    a, b = (log.T_ref_part[:, log.parts.index(part)] for part in (parent, child))
    T_parent_child = se3.inverse(a) @ b
    return T_parent_child[np.isfinite(T_parent_child[:, 0, 0])]


def attempt_text(attempt: Attempt) -> str:
    """What the joint was taken for."""
    told, found = attempt.told, attempt.told.found_type
    if found is None:
        return "no joint between its bodies"
    if found == "rigid":
        return "rigid, one body of both"
    return found if told.axis_error_deg is None else f"{found}, axis {told.axis_error_deg:.2g}° off"


def joints_text(attempt: Attempt) -> str:
    """What all joints of the tree were taken for, in the true tree's order."""
    return ", ".join(joint.found_type or "none" for joint in attempt.row.joints)


def draw_attempt(axes: Axes, attempt: Attempt, true: Joint) -> None:
    """Draw where the child was measured and where it truly was, and the way and axis of the fitted joint.

    The panel's limits are those of what was measured; circles and axes may leave it.
    """
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(visible=True, color=LIGHT.faint)
    view = _view(true)
    points = attempt.measured[:, :3, 3] @ view[:2].T
    low, high = np.percentile(np.concatenate([points, attempt.true[:, :3, 3] @ view[:2].T]), PERCENTILES, axis=0)
    reach_m = max(float(np.max(high - low)), LEAST_REACH_M)
    _set_limits(axes, (low + high) / 2, reach_m)
    axes.plot(*points.T, "o", color=MEASURED, ms=2.4, alpha=0.75, mew=0, zorder=2)
    _draw_orientations(axes, attempt.measured, view, TICK_SHARE * reach_m)
    axes.plot(*(attempt.true[:, :3, 3] @ view[:2].T).T, color=TRUE, lw=1.0, zorder=3)
    if attempt.joint is not None and attempt.joint.kind.states == 1:
        _draw_joint(axes, attempt.joint, view, reach_m)
    _draw_scale(axes, reach_m)


def _view(true: Joint) -> FloatArray:
    """(3, 3) as `view_axes`: the true axis and two directions across it are seen from aside."""
    axis = UP if true.axis_parent is None else true.axis_parent
    return view_axes(np.array([axis, axis, *np.linalg.svd(axis[None])[2][1:]]), UP, None)


def _set_limits(axes: Axes, centre: FloatArray, reach_m: float) -> None:
    panel = axes.get_window_extent()
    per_px = reach_m * (1 + 2 * MARGIN_SHARE) / min(panel.width, panel.height)
    for at, size, limit in ((centre[0], panel.width, axes.set_xlim), (centre[1], panel.height, axes.set_ylim)):
        limit(at - per_px * size / 2, at + per_px * size / 2)


def _draw_orientations(axes: Axes, poses: FloatArray, view: FloatArray, length_m: float) -> None:
    """The axes of the child in some frames, evenly spaced: x orange, y green, z blue."""
    for T in poses[:: max(1, len(poses) // TICKS)]:
        for column, colour in enumerate(TICK_COLOURS):
            ends = np.array([T[:3, 3], T[:3, 3] + length_m * T[:3, column]]) @ view[:2].T
            axes.plot(*ends.T, color=colour, lw=0.8, alpha=0.9, zorder=2.5)


def _draw_joint(axes: Axes, joint: Joint, view: FloatArray, reach_m: float) -> None:
    """The way of the child over the observed states in a thick line, the rest of its circle dashed, the axis dotted."""
    low, high = joint.state_min or 0.0, joint.state_max or 0.0
    way = joint.forward(np.linspace(low, high, 181))[:, :3, 3]
    axes.plot(*(way @ view[:2].T).T, color=FITTED, lw=2.4, alpha=0.9, zorder=4, solid_capstyle="round")
    if joint.point_parent_m is None or joint.axis_parent is None:
        return
    centre = joint.point_parent_m + joint.axis_parent * (joint.axis_parent @ (way[0] - joint.point_parent_m))
    if np.linalg.norm(way[0] - centre) < LARGEST_CIRCLE * reach_m and joint.type == "revolute":
        circle = joint.forward(np.linspace(0, 2 * np.pi, 181))[:, :3, 3]
        axes.plot(*(circle @ view[:2].T).T, color=FITTED, lw=0.9, ls=(0, (4, 2)), zorder=3.5)
    ends = np.array(
        [centre - AXIS_SHARE * reach_m * joint.axis_parent, centre + AXIS_SHARE * reach_m * joint.axis_parent]
    )
    axes.plot(*(ends @ view[:2].T).T, color=FITTED, lw=1.4, ls=(0, (1, 1)), zorder=4)
    axes.plot(*(centre @ view[:2].T), "+", color=FITTED, ms=7, mew=1.4, zorder=4)


def _draw_scale(axes: Axes, reach_m: float) -> None:
    length_m = min(SCALES_M, key=lambda each: abs(np.log(each / (0.2 * reach_m))))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = left + 0.03 * (right - left), bottom + 0.04 * (top - bottom)
    axes.plot([x, x + length_m], [y, y], color=LIGHT.ink, lw=2.0, zorder=8)
    axes.text(x + length_m + 0.015 * (right - left), y, f"{1e3 * length_m:g} mm", fontsize=8, va="center", zorder=8)
