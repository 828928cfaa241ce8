"""kinematics.json: what is written, what is read back, and what is refused."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.errors import InvalidData, InvalidFile
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.kinematics.tree_json import from_json, to_json

examples = settings(max_examples=20, deadline=None)  # a loaded machine is no failure
HAND_DRAWN = """{"schema": "kinematics/1", "root": "base", "parts": ["base", "lid", "drawer", "knob"],
 "joints": [
  {"name": "hinge", "type": "revolute", "parent": "base", "child": "lid", "axis_parent": [0, 0, 1],
   "point_parent_m": [1, 0, 0], "T_parent_child_zero": [[1,0,0,0], [0,1,0,0], [0,0,1,0.5], [0,0,0,1]],
   "limits": {"min": 0, "max": 1.5}},
  {"name": "slide", "type": "prismatic", "parent": "base", "child": "drawer", "axis_parent": [1, 0, 0],
   "T_parent_child_zero": [[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,1]]}]}"""


def fitted_tree(seed: int = 0) -> KinematicTree:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    pan = Joint(
        name="base_pan",
        type="revolute",
        parent="base",
        child="link1",
        axis_parent=axis / np.linalg.norm(axis),
        point_parent_m=rng.normal(size=3),
        T_parent_child_zero=se3.exp(rng.normal(size=6)),
        state_min=-1.0,
        state_max=1.0,
        scores={"criterion": "evidence", "rigid": 9120.1, "prismatic": math.inf, "revolute": 1502.8},
        probability={"rigid": 0.0, "prismatic": 0.0, "revolute": 1.0},
        rms_rotation_rad=math.radians(0.2),
        rms_translation_m=0.0004,
        frames=600,
        outliers=3,
        axis_std_rad=math.radians(0.05),
        point_std_m=0.0003,
    )
    return KinematicTree(
        root="base",
        parts=("base", "base_b", "link1", "knob"),
        rigid_groups=(("base", "base_b"),),
        trees=(("base", "link1"), ("knob",)),
        joints=(pan,),
        method={"name": "station", "sigma": np.float64(0.5), "counts": (1, 2), "none": None, "bad": math.nan},
        warnings=("elbow moved only 2.1 deg: its axis is not identifiable",),
    )


def changed(change: object, *path: object) -> str:
    """The text of the fitted tree with one value replaced."""
    values = json.loads(to_json(fitted_tree()))
    place = values
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = change
    return json.dumps(values)


def test_the_file_has_the_fields_of_its_schema():
    values = json.loads(to_json(fitted_tree()))
    assert list(values) == ["schema", "root", "parts", "rigid_groups", "trees", "joints", "method", "warnings"]
    assert values["schema"] == "kinematics/1"
    assert values["trees"] == [["base", "link1"], ["knob"]]
    joint = values["joints"][0]
    assert list(joint) == [
        *("name", "type", "parent", "child", "axis_parent", "point_parent_m", "pitch_m_per_rad", "T_parent_child_zero"),
        *("state", "scores", "probability", "rms", "frames", "outliers", "std"),
    ]
    assert joint["state"] == {"unit": "rad", "min": -1.0, "max": 1.0}
    assert joint["rms"] == pytest.approx({"rotation_deg": 0.2, "translation_mm": 0.4})
    assert joint["std"] == pytest.approx({"axis_deg": 0.05, "point_mm": 0.3})
    assert np.array(joint["T_parent_child_zero"]).shape == (4, 4)


def test_numbers_that_are_not_finite_become_null():
    text = to_json(fitted_tree())
    values = json.loads(text, parse_constant=pytest.fail)
    assert values["joints"][0]["scores"]["prismatic"] is None
    assert values["method"] == {"name": "station", "sigma": 0.5, "counts": [1, 2], "none": None, "bad": None}


@given(st.integers(0, 2**32 - 1))
@examples
def test_a_tree_reads_back_as_it_was(seed: int):
    tree = fitted_tree(seed)
    again = from_json(to_json(tree), "kinematics.json")
    assert to_json(again) == to_json(tree)
    assert (again.root, again.parts, again.rigid_groups, again.trees) == (
        *(tree.root, tree.parts, tree.rigid_groups, tree.trees),
    )
    before, after = tree.joints[0], again.joints[0]
    for name in ("axis_parent", "point_parent_m", "T_parent_child_zero"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert after.rms_rotation_rad == pytest.approx(before.rms_rotation_rad, rel=1e-14)
    assert after.point_std_m == pytest.approx(before.point_std_m, rel=1e-14)
    assert after.scores["criterion"] == "evidence"
    assert math.isnan(after.scores["prismatic"])


def test_a_matrix_has_a_row_a_line():
    lines = to_json(fitted_tree()).splitlines()
    start = next(i for i, line in enumerate(lines) if "T_parent_child_zero" in line)
    assert lines[start + 4].strip() == "[0.0, 0.0, 0.0, 1.0]"
    assert max(map(len, lines)) <= 120


def test_a_tree_drawn_by_hand_needs_no_more_than_its_geometry():
    tree = from_json(HAND_DRAWN, "cupboard.json")
    assert tree.trees == (("base", "lid", "drawer"), ("knob",))
    assert tree.joint("hinge").limits == (0, 1.5)
    assert tree.joint("slide").scores is None
    np.testing.assert_allclose(tree.forward({"hinge": 0.0, "slide": 0.2})["drawer"][:3, 3], [0.2, 0, 0], atol=1e-15)
    assert from_json(to_json(tree), "again").joint("hinge").limits == (0, 1.5)


def test_a_rigid_group_drawn_by_hand_is_named_by_the_part_at_the_joint():
    values = json.loads(HAND_DRAWN) | {"rigid_groups": [["knob", "lid"]]}
    assert from_json(json.dumps(values), "cupboard.json").trees == (("base", "lid", "drawer"),)


def test_a_joint_that_has_no_axis_point_or_state_says_null():
    values = json.loads(HAND_DRAWN)
    values["joints"][1] |= {"type": "rigid", "axis_parent": None, "state": None}
    slide = json.loads(to_json(from_json(json.dumps(values), "x")))["joints"][1]
    assert (slide["axis_parent"], slide["point_parent_m"], slide["state"]) == (None, None, None)
    assert slide["std"] == {"axis_deg": None, "point_mm": None}


def test_a_screw_has_its_pitch_and_a_ball_no_axis_and_the_range_of_its_angle():
    rng = np.random.default_rng(1)
    zeros = [se3.exp(rng.normal(size=6)) for _ in range(2)]
    bolt = Joint(
        *("bolt", "screw", "base", "nut", np.array([0.0, 0.6, 0.8]), rng.normal(size=3), zeros[0]),
        pitch_m_per_rad=0.002,
        state_min=-3.0,
        state_max=20.0,
        pitch_std_m_per_rad=1e-5,
    )
    ball = Joint("ball", "spherical", "nut", "cap", None, rng.normal(size=3), zeros[1], state_min=0.0, state_max=1.5)
    bodies = ("base", "nut", "cap")
    tree = KinematicTree("base", bodies, (), (bodies,), (bolt, ball))
    first, second = json.loads(to_json(tree))["joints"]
    assert (first["pitch_m_per_rad"], first["state"]) == (0.002, {"unit": "rad", "min": -3.0, "max": 20.0})
    assert first["std"] == {"axis_deg": None, "point_mm": None, "pitch_mm_per_rad": pytest.approx(0.01)}
    assert (second["axis_parent"], second["pitch_m_per_rad"]) == (None, None)
    assert second["state"] == {"unit": "rad", "min": 0.0, "max": 1.5}
    assert list(second["std"]) == ["axis_deg", "point_mm"]
    again = from_json(to_json(tree), "kinematics.json")
    assert again.joint("bolt").pitch_std_m_per_rad == pytest.approx(1e-5)
    q = np.array([7.0, 0.1, -0.2, 0.3])
    np.testing.assert_array_equal(again.forward(q)["cap"], tree.forward(q)["cap"])


@pytest.mark.parametrize(
    ("text", "message"),
    (
        ("{", "is no JSON"),
        ("[1]", "holds no JSON object"),
        ("[" * 100_000, "brackets too deep"),
        ('{"schema": NaN}', "NaN is no JSON; want null"),
        ('{"schema": "kinematics/1", "root": "a", "root": "b"}', "key 'root' is there twice"),
        ('{"root": "a"}', 'schema is missing; this version reads "kinematics/1"'),
        ('{"schema": "kinematics/2", "novel": 1}', 'schema is "kinematics/2"; this version reads "kinematics/1"'),
        ('{"schema": "kinematics/1", "root": "a", "parts": ["a"]}', "no key 'joints'"),
        (changed(1, "novel"), "unknown key 'novel'; known there: schema, root, parts"),
        (changed(1, "joints", 0, "novel"), r"unknown key 'joints\[0\].novel'; known there: name, type"),
        (changed(1, "joints", 0, "state", "novel"), r"'joints\[0\].state.novel'; known there: unit, min, max"),
        (changed("a", "joints", 0, "rms", "rotation_deg"), r"joints\[0\].rms.rotation_deg: Input should be"),
        (changed("0.5", "joints", 0, "state", "min"), r"joints\[0\].state.min: Input should be"),
        (changed(True, "joints", 0, "frames"), r"joints\[0\].frames: Input should be"),
        (changed([0, 1], "joints", 0, "axis_parent"), r"joints\[0\].axis_parent: List should have at least 3"),
        (
            changed([0, 0, 2], "joints", 0, "axis_parent"),
            r"joint 'base_pan' \(revolute\).* length 2; want a unit vector",
        ),
        (changed(None, "joints", 0, "axis_parent"), "axis_parent is missing; the type needs it"),
        (changed("screwy", "joints", 0, "type"), "type 'screwy'; want one of rigid"),
        (changed("screw", "joints", 0, "type"), "pitch_m_per_rad is missing; the type needs it"),
        (changed("spherical", "joints", 0, "type"), "axis_parent is given; the type has none"),
        (changed("m", "joints", 0, "state", "unit"), "state in 'm'; want 'rad' for a revolute joint"),
        (changed(3, "joints", 0, "scores", "criterion"), "scores.criterion is 3.0; want a name"),
        (changed("best", "joints", 0, "scores", "rigid"), 'scores.rigid is "best"; want a number or null'),
        (changed(["base", "lid"], "parts"), "unknown part"),
        (changed("link1", "root"), "root 'link1' is no root"),
    ),
)
def test_what_is_no_tree_file_is_refused_by_name(text: str, message: str):
    with pytest.raises(InvalidFile, match="tree.json.*" + message):
        from_json(text, "tree.json")


def test_a_number_beyond_float64_is_refused():
    text = changed(7.25, "joints", 0, "point_parent_m", 1).replace("7.25", "1e999")
    with pytest.raises(InvalidFile, match="finite"):
        from_json(text, "tree.json")


def test_a_method_that_json_cannot_hold_is_refused():
    tree = fitted_tree()
    tree.method["by"] = {1, 2}  # type: ignore[index]
    with pytest.raises(InvalidData, match=r"kinematics\.method\.by is a set"):
        to_json(tree)
