"""The kinematic graph that a fit found, beside its joints' states over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE
from station.logs import JointLog
from station.report.curves import draw_detected
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import own_name, range_text, shortened, type_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from station.kinematics.tree import Joint, KinematicTree

ROW_IN = 0.78
PANEL_IN = 1.2
INDENT_IN = 0.42
# What a joint's label needs right of the deepest indent.
LABEL_IN = 2.2
# Of a ball's rotation vector.
COMPONENT_COLOURS = {"x": LIGHT.detected, "y": LIGHT.viewing, "z": LIGHT.measured}


def tree_figure(tree: KinematicTree, states: JointLog) -> Figure:
    """The kinematic graph beside its joints' states over time.

    Left, a box for each body with its trackers, each below its parent and indented by its depth; on the way from the
    parent the joint with its type and observed range. Right, the state of each movable joint [deg or mm], of a ball the
    three of its rotation vector, with a band of +-2 standard deviations.
    """
    from matplotlib.figure import Figure

    placed = list(_placed(tree))
    shown = [joint for joint in tree.movable if set(joint.columns) <= set(states.joints)]
    height_in = 0.75 + max(ROW_IN * len(placed), PANEL_IN * max(len(shown), 1))
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        top, bottom = 1 - 0.3 / height_in, 0.45 / height_in
        _draw_graph(figure.add_axes((0.01, bottom, 0.38, top - bottom)), tree, placed)
        grid = figure.add_gridspec(max(len(shown), 1), 1, left=0.465, right=0.985, top=top, bottom=bottom, hspace=0.42)
        if not shown:
            axes = figure.add_subplot(grid[0, 0])
            axes.set_axis_off()
            axes.text(0.5, 0.5, "no joint that moves", ha="center", va="center")
            return figure
        axes = [figure.add_subplot(grid[0, 0])]
        axes += [figure.add_subplot(grid[row, 0], sharex=axes[0]) for row in range(1, len(shown))]
        for panel, joint in zip(axes, shown, strict=True):
            _draw_joint_states(panel, joint, states)
            panel.tick_params(labelbottom=panel is axes[-1])
        axes[0].margins(x=0)
        axes[-1].set_xlabel("time [s]")
        figure.align_ylabels(axes)
        return figure


def _placed(tree: KinematicTree) -> Iterator[tuple[str, int, Joint | None]]:
    """Each body with its depth and the joint to its parent, depth first, the root's tree first."""

    def below(body: str, depth: int, joint: Joint | None) -> Iterator[tuple[str, int, Joint | None]]:
        yield body, depth, joint
        for next_joint in tree.joints:
            if next_joint.parent == body:
                yield from below(next_joint.child, depth + 1, next_joint)

    for root in sorted(tree.tree_roots, key=lambda name: name != tree.root):
        yield from below(root, 0, None)


def _draw_graph(axes: Axes, tree: KinematicTree, placed: Sequence[tuple[str, int, Joint | None]]) -> None:
    """In inches, down from the top left corner; a child's label is above its box, right of the line to its parent."""
    axes.set_axis_off()
    extent = axes.get_window_extent()
    width_in, height_in = extent.width / axes.figure.dpi, extent.height / axes.figure.dpi
    axes.set_xlim(0, width_in)
    axes.set_ylim(-height_in, 0)
    deepest = max(depth for _, depth, _ in placed)
    indent_in = min(INDENT_IN, (width_in - LABEL_IN) / max(deepest, 1))
    row_of = {body: row for row, (body, _, _) in enumerate(placed)}
    for row, (body, depth, joint) in enumerate(placed):
        x, y = 0.12 + indent_in * depth, -(row + 0.4) * ROW_IN
        if joint is not None:
            line_x, parent_y = x - 0.6 * indent_in, -(row_of[joint.parent] + 0.4) * ROW_IN
            axes.plot([line_x, line_x, x], [parent_y, y, y], color=LIGHT.commanded, lw=1.4, zorder=1)
            label_y = y + 0.5 * ROW_IN
            axes.text(line_x + 0.08, label_y, _joint_label(joint), fontsize=8, va="center", color=LIGHT.detected)
        axes.text(
            x,
            y,
            _body_label(tree, body),
            fontsize=8.5,
            va="center",
            linespacing=1.25,
            bbox={"boxstyle": "round,pad=0.35", "fc": LIGHT.paper, "ec": LIGHT.measured, "lw": 1.4},
            zorder=2,
        )


def _body_label(tree: KinematicTree, body: str) -> str:
    group = next((group for group in tree.rigid_groups if body in group), (body,))
    others = [part for part in group if part != body]
    return shortened(body, 26) + (f"\nwith {shortened(', '.join(others), 30)}" if others else "")


def _joint_label(joint: Joint) -> str:
    name, extent = own_name(joint), range_text(joint)
    return (f"{shortened(name, 16)}: " if name else "") + type_text(joint) + (f", {extent}" if extent else "")


def _draw_joint_states(axes: Axes, joint: Joint, states: JointLog) -> None:
    scale, unit = UNIT_SCALE[joint.unit], UNIT_NAME[joint.unit]
    several = len(joint.columns) > 1
    for name, (component, colour) in zip(joint.columns, COMPONENT_COLOURS.items(), strict=False):
        std = np.full(len(states.t_s), np.nan)
        if states.std is not None:
            std = scale * states.std[:, states.joints.index(name)]
        look = {"colour": colour, "label": component} if several else {}
        draw_detected(axes, states.t_s, scale * states.state(name), std, **look)
    if several:
        lines = [line for line in axes.get_lines() if line.get_label() in COMPONENT_COLOURS]
        axes.legend(handles=lines, loc="lower right", bbox_to_anchor=(1, 0.97), ncols=3, frameon=False, fontsize=8)
    axes.set_ylabel(f"[{unit}]")
    axes.set_title(f"{joint.name} ({joint.type})", loc="left", fontsize=8.5, pad=3)
