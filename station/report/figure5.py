"""The paper's Figure 5: the tree that makes the motions, and what fits make of its prismatic joint as noise grows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from station.errors import InvalidData
from station.experiments import NoiseLevel, Sweep, simulated
from station.kinematics.tree import Joint, KinematicTree
from station.report.axis_error_figure import axis_error_figure
from station.report.drawings import png, svg
from station.report.joint_attempts import (
    FITTED,
    MEASURED,
    TRUE,
    attempt_of,
    attempt_text,
    best_row,
    draw_attempt,
    joint_row,
    joints_text,
)
from station.report.space_figure import draw_space
from station.report.structure_figure import structure_figure
from station.report.style import WIDTH_IN, styled
from station.report.sweep_levels import conditions, level_text, method_colour, rows_of
from station.report.types_figure import types_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEAD_IN, TREE_IN, TITLE_IN, ROW_IN, TEXT_IN, FOOT_IN = 0.4, 2.9, 0.22, 2.95, 0.5, 0.5
LEFT, RIGHT, GAP = 0.045, 0.99, 0.015
WORDS = ("low noise", "middle noise", "high noise")
FIGURES: dict[str, Callable[[Sweep], Figure]] = {
    "structure": structure_figure,
    "types": types_figure,
    "axes": axis_error_figure,
}


def write_figure5(sweep: Sweep, folder: Path) -> tuple[Path, ...]:
    """Write figure5.png and .svg, then structure, types and axes likewise; returns the files.

    Args:
        sweep: done or under way.
        folder: made if it isn't there.

    Raises:
        InvalidData: if the sweep has no rows yet.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for name, draw in {"figure5": figure5, **FIGURES}.items():
        figure = draw(sweep)
        for ending, drawn in ((".png", png), (".svg", svg)):
            path = folder / f"{name}{ending}"
            path.write_bytes(drawn(figure))
            written.append(path)
    return tuple(written)


def figure5(sweep: Sweep) -> Figure:
    """The paper's Figure 5 for the first tree that has a prismatic joint.

    Above, the tree at a typical moment with the ways of its bodies. Below, for each method a row: at low, middle and
    high noise the repeat that made the best of the prismatic joint (`best_row`), in the frame of its parent: where the
    child was measured and truly was, and the fitted joint with the way that it gives the child. Without inflation, or
    with the least that was swept, as in the paper.

    Raises:
        InvalidData: if the sweep has no rows yet.
    """
    from matplotlib.figure import Figure

    methods = [method for method in sweep.grid.methods if rows_of(sweep, method)]
    if not methods:
        raise InvalidData(f"the sweep in {sweep.folder.name} has no rows yet; nothing to draw")
    name, tree, joint = drawn_joint(sweep)
    levels = three_levels(sweep.grid.noise)
    height_in = HEAD_IN + TREE_IN + TITLE_IN + ROW_IN * len(methods) + FOOT_IN
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        figure.text(LEFT, 1 - 0.14 / height_in, f"The tree that makes the motions: {name}", va="top", weight="bold")
        box = (LEFT, 1 - (HEAD_IN + TREE_IN) / height_in, RIGHT - LEFT, TREE_IN / height_in)
        _draw_tree(figure.add_axes(box), sweep, name, tree)
        width = (RIGHT - LEFT - GAP * (len(levels) - 1)) / len(levels)
        for column, (word, level) in enumerate(levels):
            top = 1 - (HEAD_IN + TREE_IN + 0.1) / height_in
            left = LEFT + column * (width + GAP)
            figure.text(left, top, f"{word}: {level_text(level)}", va="top", weight="bold")
        for row, method in enumerate(methods):
            bottom = (FOOT_IN + ROW_IN * (len(methods) - 1 - row)) / height_in
            for column, (_, level) in enumerate(levels):
                place = (LEFT + column * (width + GAP), bottom, width, (ROW_IN - TEXT_IN) / height_in)
                _draw_panel(figure.add_axes(place), sweep, method, level, (name, joint))
            middle = bottom + (ROW_IN - TEXT_IN) / 2 / height_in
            named = {"rotation": 90, "ha": "center", "va": "center", "weight": "bold"}
            figure.text(LEFT / 2, middle, f"method {method}", color=method_colour(method), **named)
        _legend(figure, height_in)
        figure.text(LEFT, 0.08 / height_in, conditions(sweep), ha="left", va="bottom", fontsize=7.5)
        return figure


def drawn_joint(sweep: Sweep) -> tuple[str, KinematicTree, Joint]:
    """The first tree with a prismatic joint, and that joint; else the first tree and its first joint."""
    trees = [(named.name, named.tree) for named in sweep.grid.trees if named.tree.movable]
    if not trees:
        raise InvalidData("no tree of the sweep has a joint that moves; nothing to draw")
    for name, tree in trees:
        for joint in tree.movable:
            if joint.type == "prismatic":
                return name, tree, joint
    return *trees[0], trees[0][1].movable[0]


def three_levels(levels: Sequence[NoiseLevel]) -> list[tuple[str, NoiseLevel]]:
    """The lowest, a middle and the highest of the noise levels, each with its word; fewer where there are fewer."""
    if len(levels) < 3:
        return list(zip((WORDS[0], WORDS[2]), levels, strict=False))
    return list(zip(WORDS, (levels[0], levels[len(levels) // 2], levels[-1]), strict=True))


def _draw_tree(axes: Axes, sweep: Sweep, name: str, tree: KinematicTree) -> None:
    """As the first simulation of that tree moves it, without virtual trackers."""
    cell = next(cell for cell in sweep.grid.cells() if cell.tree == name)
    made = simulated(cell, tree)
    draw_space(axes, made.tree, made.states, made.tree.root)


def _draw_panel(axes: Axes, sweep: Sweep, method: str, level: NoiseLevel, of: tuple[str, Joint]) -> None:
    name, joint = of
    inflation = min(sweep.grid.inflation)
    rows = [row for row in rows_of(sweep, method, level=level, inflation=inflation) if row.cell.tree == name]
    row = best_row(rows, joint.name)
    if row is None:
        axes.set_axis_off()
        text = "no fit succeeded" if rows else "not fitted yet"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
        return
    attempt = attempt_of(sweep, row, joint.name)
    draw_attempt(axes, attempt, joint)
    found = sum(bool(each.joints) and joint_row(each, joint.name).found_type == joint.type for each in rows)
    text = (
        f"{attempt_text(attempt)}; {joint.type} in {found} of {len(rows)} repeats\nall joints: {joints_text(attempt)}"
    )
    axes.set_title(text, fontsize=8, loc="left", pad=3, linespacing=1.25)


def _legend(figure: Figure, height_in: float) -> None:
    from matplotlib.lines import Line2D

    drawn = [
        Line2D([], [], color=MEASURED, marker="o", ls="", ms=4, label="measured, in the parent's frame"),
        Line2D([], [], color=TRUE, lw=1.2, label="true way"),
        Line2D([], [], color=FITTED, lw=2.4, label="fitted: the way over its states"),
        Line2D([], [], color=FITTED, lw=0.9, ls=(0, (4, 2)), label="the whole circle"),
        Line2D([], [], color=FITTED, lw=1.4, ls=(0, (1, 1)), marker="+", label="axis of rotation"),
    ]
    figure.legend(handles=drawn, loc="lower left", bbox_to_anchor=(LEFT, 0.24 / height_in), ncols=5, frameon=False,
                  fontsize=8, borderaxespad=0, borderpad=0, columnspacing=1.6, handlelength=2.2)  # fmt: skip
