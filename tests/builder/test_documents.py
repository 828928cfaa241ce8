"""Drafts as files: what is kept, what other readers see, what is refused, and what survives a crash."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from station.builder.documents import (
    from_text,
    from_tree,
    left_out_of_urdf,
    markers_text,
    name_of,
    to_text,
    to_urdf_text,
)
from station.builder.draft import blank
from station.builder.edits import add_part, set_type
from station.builder.marking import add_marker
from station.builder.stored import aside, forget_aside, keep_aside, load_draft, recovered, save_draft
from station.errors import InvalidData, InvalidFile, StationError
from station.formats.markers import parse_markers
from station.formats.trees import example_names, load_tree
from station.kinematics.tree_json import from_json
from tests.drawn_objects import drawer_cabinet, swivel_chair


def test_a_strict_reader_of_trees_takes_a_draft_with_markers_and_boxes():
    draft = add_marker(swivel_chair(), "seat")
    tree = from_json(to_text(draft), "chair.json")
    assert tree.bodies == draft.parts
    assert tree.method["name"] == "drawn" and len(tree.method["markers"]) == 1


@pytest.mark.parametrize("name", example_names())
def test_every_packaged_tree_opens_and_moves_as_its_file_says(name: str):
    draft, tree = load_draft(name), load_tree(name)
    q = np.full(len(tree.columns), 0.05)
    want, have = tree.forward(q), draft.tree.forward(q)
    for body in tree.bodies:
        np.testing.assert_array_equal(have[body], want[body])
    assert to_text(from_text(to_text(draft), f"{name}.json")) == to_text(draft)


def test_another_program_reads_the_urdf_and_moves_it_alike():
    draft = drawer_cabinet()
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(io.BytesIO(to_urdf_text(draft).encode()), load_meshes=False, build_scene_graph=True)
    states = {"upper_joint": 0.1, "lower_joint": 0.03, "door_joint": 0.7}
    robot.update_cfg(states)
    for part, T in draft.poses(states).items():
        np.testing.assert_allclose(robot.get_transform(part, draft.tree.root), T, atol=1e-9)


def test_a_fitted_tree_can_be_drawn_on_and_its_seen_range_becomes_the_limits():
    text = json.loads(to_text(drawer_cabinet()))
    for joint in text["joints"]:
        joint.pop("limits")
        joint["state"] |= {"min": 0.01, "max": 0.11}
        joint["frames"] = 100
    text |= {"method": {"name": "station", "criterion": "evidence"}, "warnings": ["the door moved little"]}
    draft = from_text(json.dumps(text), "fit/kinematics.json")
    assert {joint.limits for joint in draft.joints} == {(0.01, 0.11)}
    assert draft.joints[0].frames is None and draft.markers == () and draft.name == "kinematics"


def test_a_hinge_without_limits_turns_a_whole_turn():
    text = json.loads(to_text(add_part(blank(), "door")))
    text["joints"][0]["limits"] = None
    assert from_text(json.dumps(text), "door.json").joints[0].limits == (-np.pi, np.pi)


def broken(**changes: object) -> str:
    text = json.loads(to_text(add_marker(add_part(add_part(blank(), "arm"), "hand", "arm"), "hand")))
    for key, value in changes.items():
        where: object = text
        *path, last = key.split("__")
        for step in path:
            where = where[int(step) if step.isdigit() else step]
        where[last] = value
    return json.dumps(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (broken(joints__1__child="arm"), "two parents|at both ends"),
        (broken(joints__1__parent="hand", joints__1__child="base"), "root 'base' is no root; have hand"),
        (broken(joints__0__parent="hand", trees=[["arm", "hand"], ["base"]], root="base"), "loop|roots"),
        (broken(joints__0__type="hinge"), "has the type 'hinge'; want one of rigid, prismatic"),
        (broken(joints__0__axis_parent=[0, 0, 0]), "want a unit vector"),
        (broken(joints__0__limits={"min": 1.0, "max": -1.0}), "limits from 1.0 to -1.0"),
        (broken(joints__0__name="hand_joint"), "named twice: hand_joint"),
        (broken(parts=["base", "arm", "arm"]), "named twice: arm"),
        (broken(trees=[["base", "arm"], ["hand"]]), "different trees"),
        (broken(joints=[], trees=[["base"], ["arm"], ["hand"]]), "nothing connects 3 trees"),
        (broken(method__markers__0__part="foot"), "there is no part 'foot'; have base, arm, hand"),
        (broken(method__markers__0__id=90), "marker 90 is not in DICT_4X4_50"),
        (broken(method__markers__0__size_m=-1), "size is -1 m"),
        (broken(method__markers__0__T_part_marker=[[1, 0], [0, 1]]), "method, markers, 0, T_part_marker"),
        (broken(method__markers__0__colour="red"), "method, markers, 0, colour"),
        (broken(method__dictionary="DICT_9X9"), "no marker dictionary 'DICT_9X9'"),
        (broken(schema="kinematics/9"), "kinematics/9"),
        ("{}", "schema is missing"),
        ("no tree at all", "bad.json"),
        ("<robot name='x'><link name='a'/><link name='b'/></robot>", "2 links have no joint above them"),
        ("<robot", "is no XML"),
    ],
)
def test_a_bad_tree_is_refused_with_the_files_name(text: str, said: str):
    with pytest.raises(InvalidFile, match=said) as error:
        from_text(text, "bad.json")
    assert str(error.value).startswith("bad.json") and len(str(error.value).splitlines()) <= 5


def test_what_a_urdf_can_not_hold_is_said():
    draft = add_marker(set_type(swivel_chair(), "recline", "spherical"), "seat")
    assert left_out_of_urdf(draft) == ("1 marker", "4 boxes", "limits of the ball joints recline")


def test_the_markers_of_a_draft_are_a_markers_file():
    table = parse_markers(markers_text(add_marker(swivel_chair(), "seat")), "markers.toml")
    assert table.markers[0].part == "seat" and table.markers[0].T_part_marker is not None
    with pytest.raises(InvalidData, match="at least one marker"):
        markers_text(swivel_chair())


@pytest.mark.parametrize(
    ("file", "name"),
    [("a/My Chair.json", "my_chair"), ("7.json", "draft_7"), ("Größe.urdf", "gr__e"), ("….json", "draft")],
)
def test_a_draft_is_named_after_its_file(file: str, name: str):
    assert name_of(file) == name


def test_what_is_saved_is_loaded_again(tmp_path: Path):
    draft = add_marker(swivel_chair(), "back")
    for ending in ("json", "urdf"):
        save_draft(draft, tmp_path / f"chair.{ending}")
    assert to_text(load_draft(tmp_path / "chair.json")) == to_text(draft)
    assert load_draft(tmp_path / "chair.urdf").parts == draft.parts
    with pytest.raises(InvalidData, match=r"want .json or .urdf"):
        save_draft(draft, tmp_path / "chair.txt")


def test_a_file_that_can_not_be_written_is_left_as_it_was(tmp_path: Path):
    (tmp_path / "chair.json").mkdir()
    with pytest.raises(StationError, match="can't write"):
        save_draft(swivel_chair(), tmp_path / "chair.json")
    assert [path.name for path in tmp_path.iterdir()] == ["chair.json"]


def test_what_was_not_saved_is_found_again_beside_the_file(tmp_path: Path):
    path = tmp_path / "chair.json"
    assert recovered(path) is None
    keep_aside(swivel_chair(), path)
    again = recovered(path)
    assert again is not None and to_text(again) == to_text(swivel_chair()) and again.name == "chair"
    aside(path).write_text("torn", encoding="utf-8")
    assert recovered(path) is None
    forget_aside(path)
    forget_aside(path)
    assert not aside(path).exists()


def test_a_forest_is_no_draft():
    tree = from_json(broken(joints=[], trees=[["base"], ["arm"], ["hand"]], method={}), "forest.json")
    with pytest.raises(InvalidData, match="nothing connects 3 trees"):
        from_tree(tree)
