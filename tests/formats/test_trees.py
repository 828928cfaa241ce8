"""Claims of reading trees: packaged examples, kinematics.json, URDF."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from station.formats.trees import example_names, load_tree
from station.formats.urdf import to_urdf
from station.kinematics.tree_json import from_json, to_json
from station.simulate import simulate


def test_the_packaged_trees_are_there():
    assert {"demo_arm", "drawer_cabinet", "experiment1", "lamp", "swivel_chair"} <= set(example_names())


@pytest.mark.parametrize("name", example_names())
def test_every_packaged_tree_has_limits_and_is_the_same_by_every_way(name: str, tmp_path):
    tree = load_tree(name)
    assert all(joint.limits is not None for joint in tree.movable)
    (tmp_path / "kinematics.json").write_text(to_json(tree), encoding="utf-8")
    (tmp_path / "tree.urdf").write_text(to_urdf(tree, name), encoding="utf-8")
    assert to_json(load_tree(tmp_path)) == to_json(load_tree(tmp_path / "kinematics.json")) == to_json(tree)
    assert load_tree(tmp_path / "tree.urdf").parts == tree.parts


def test_the_tree_of_the_page_is_read_and_moves():
    page = Path(__file__).parents[2] / "docs" / "simulator.md"
    (text,) = re.findall(r"```json\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    assert simulate(from_json(text, "simulator.md")).states.joints == ("hinge", "slide")


def test_the_page_names_every_packaged_tree():
    page = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text("utf-8")
    for name in example_names():
        assert f"| `{name}` |" in page
