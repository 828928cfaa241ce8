"""The tree that was found: as a graph, in space, and the states of its joints."""

from __future__ import annotations

from station.report.blocks import Block, Drawing, Section, Table, Text
from station.report.drawings import svg
from station.report.material import Material
from station.report.space_figure import space_figure
from station.report.tables import tree_rows_with
from station.report.tree_figure import tree_figure

# Letters of a name in the page's tables, which scroll.
NAME_LETTERS = 64
# Of the terminal's table, the rest is in the section on the fit's numbers.
COLUMNS = 5
GRAPH = "The kinematic tree, and the state of each joint over time"
SPACE = "The tree in space: the tracked parts, the ways they went, the joints' axes and the camera"
IN_SPACE = (
    "In the root's frame, at a typical moment, seen without perspective from near the camera. Squares: the parts that "
    "name their bodies, with their axes (x orange, y green, z blue). Orange arrows: the joints' axes; dashed, what "
    "slides. Grey: the ways that the parts went."
)


def tree_section(material: Material) -> Section:
    """Says so where nothing was fitted."""
    title = "The tree that was found"
    if material.fit is None:
        return Section(
            "tree", "Tree", title, [Text("Nothing was fitted: without poses of marked parts there is no tree.")]
        )
    tree, states = material.fit.tree, material.fit.states
    blocks: list[Block] = [Drawing("tree", svg(tree_figure(tree, states)), GRAPH)]
    if tree.joints:
        blocks += [Drawing("space", svg(space_figure(tree, states, material.T_root_camera)), SPACE)]
        blocks += [Text(IN_SPACE, soft=True)]
        head, *rows = [row[:COLUMNS] for row in tree_rows_with(tree, NAME_LETTERS)]
        blocks.append(Table("the tree's joints", head, rows, frozenset({1, 2, 3})))
    if tree.rigid_groups:
        groups = "; ".join(" = ".join(group) for group in tree.rigid_groups)
        blocks.append(Text(f"Parts found to be one body: {groups}."))
    if len(tree.trees) > 1:
        blocks.append(Text(f"{len(tree.trees)} separate trees: no joint was found between them."))
    return Section("tree", "Tree", title, blocks)
