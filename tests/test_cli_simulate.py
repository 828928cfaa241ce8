"""`station simulate`: what is written, that a fit finds it again, and what is said when it can't be."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from station.commands import simulating
from station.errors import OutputExists
from station.fit_files import read_tree
from station.formats.joint_csv import parse_joint_states
from station.formats.read import read_pose_log
from station.formats.trees import load_tree
from station.formats.urdf import to_urdf
from station.kinematics import se3
from station.simulate import SimulationOptions, simulate
from tests.test_cli_export import is_one_clear_error

BEFORE = {
    "schema": "kinematics/1",
    "root": "frame",
    "parts": ["frame", "door", "handle"],
    "joints": [
        {
            "name": "hinge",
            "type": "revolute",
            "parent": "frame",
            "child": "door",
            "axis_parent": [0, 0, 1],
            "point_parent_m": [0, 0, 0],
            "T_parent_child_zero": np.eye(4).tolist(),
            "limits": {"min": 0.0, "max": 1.5},
        },
        {
            "name": "turn",
            "type": "revolute",
            "parent": "door",
            "child": "handle",
            "axis_parent": [1, 0, 0],
            "point_parent_m": [0.5, 0, 0],
            "T_parent_child_zero": np.eye(4).tolist(),
            "limits": {"min": -1.0, "max": 1.0},
        },
    ],
}


def test_the_poses_are_those_of_the_simulation_with_that_seed(station, tmp_path: Path):
    out = tmp_path / "new" / "poses.csv"
    options = ("--frames", 40, "--noise-translation-m", 0.002, "--noise-rotation-rad", 0.03, "--inflation", 2)
    code, said, err = station("simulate", "lamp", *options, "--seed", 7, "--out", out)
    assert (code, said) == (0, f"{out}\n") and f"station fit {out}" in err
    log = read_pose_log(out)
    from station.simulate import UniformNoise

    made = simulate(load_tree("lamp"), SimulationOptions(40, 2, UniformNoise(0.002, 0.03)), 7)
    assert log.parts == made.log.parts
    np.testing.assert_array_equal(log.t_s, made.log.t_s)
    # Rounding of quaternions of rotations and back.
    np.testing.assert_allclose(log.T_ref_part, made.log.T_ref_part, atol=1e-12)
    again = tmp_path / "again.csv"
    assert station("simulate", "lamp", *options, "--seed", 7, "--out", again)[0] == 0
    assert again.read_bytes() == out.read_bytes()
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".csv"] == ["new"]


def test_the_truth_is_written_beside_the_poses_when_it_is_asked_for(station, tmp_path: Path):
    out = tmp_path / "poses.csv"
    code, said, _ = station("simulate", "all_joints", "--out", out, "--truth", "--inflation", 1, "--json")
    assert code == 0
    told = json.loads(said)
    names = ["poses.csv", "poses_truth.csv", "poses_states.csv", "poses_tree.json"]
    assert [Path(path).name for path in told["files"]] == names and all((tmp_path / name).exists() for name in names)
    tree = read_tree(tmp_path / "poses_tree.json")
    states = parse_joint_states((tmp_path / "poses_states.csv").read_text("utf-8"), "states", tree.units)
    truth = read_pose_log(tmp_path / "poses_truth.csv")
    assert told["parts"] == list(truth.parts) == list(tree.parts) and told["poses"] == 100 * 12
    T = truth.T_ref_part
    stick = se3.inverse(T[:, truth.parts.index("block")]) @ T[:, truth.parts.index("stick")]
    np.testing.assert_allclose(stick, tree.forward(states.q)["stick"], atol=1e-9)


def test_every_option_reaches_the_simulation(station, tmp_path: Path):
    out = tmp_path / "poses.csv"
    more = ("--noise", "camera", "--flips", 0.5, "--motion", "smooth", "--root", "static", "--outliers", 0.1)
    rest = ("--missing", 0.3, "--rate-hz", 10, "--known-noise", "--json")
    code, said, _ = station("simulate", "lamp", "--out", out, *more, *rest)
    told = json.loads(said)
    assert code == 0 and told["reference"] == "camera" and told["poses"] < 0.8 * 400
    log = read_pose_log(out)
    assert log.t_s[1] == 0.1 and log.covariance is not None
    options = ("--noise", "student", "--freedom", 1, "--planar", "--planar-noise", "--force")
    assert station("simulate", "planar_linkage", "--out", out, *options)[0] == 0
    np.testing.assert_allclose(read_pose_log(out).T_ref_part[..., 2, 3], 0, atol=1e-12)


def test_a_urdf_and_a_folder_of_a_fit_are_trees_too(station, tmp_path: Path):
    (tmp_path / "lamp.urdf").write_text(to_urdf(load_tree("lamp"), "lamp"), encoding="utf-8")
    out = tmp_path / "poses.csv"
    assert station("simulate", tmp_path / "lamp.urdf", "--out", out)[0] == 0
    assert station("simulate", "lamp", "--out", tmp_path / "same.csv")[0] == 0
    same, log = (read_pose_log(path).T_ref_part for path in (tmp_path / "same.csv", out))
    np.testing.assert_allclose(log, same, atol=1e-12)
    assert station("fit", out, "--out", tmp_path / "fit")[0] == 0
    assert station("simulate", tmp_path / "fit", "--out", tmp_path / "of_fit.csv")[0] == 0


def test_a_file_that_is_there_is_kept_unless_forced(station, tmp_path: Path):
    out = tmp_path / "poses.csv"
    out.write_text("mine")
    code, said, err = station("simulate", "lamp", "--out", out)
    assert code == 1 and not said and is_one_clear_error(err) and "--force" in err and out.read_text() == "mine"
    (tmp_path / "other_tree.json").write_text("mine")
    with pytest.raises(OutputExists, match=r"other_tree\.json exists"):
        simulating.simulate("lamp", tmp_path / "other.csv", truth=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other_tree.json", "poses.csv"]
    assert station("simulate", "lamp", "--out", out, "--force")[0] == 0 and out.read_text().startswith("t_s,part,")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--frames", 0), "frames: have 0; want a whole number, 1 or more"),
        (("--noise-translation-m", "nan"), "noise of translation is nan m"),
        (("--noise-rotation-rad", "-0.1"), "noise of rotation is -0.1 rad; want a finite number, 0 or more"),
        (("--noise", "pink"), "choose one of uniform, gaussian, student, camera"),
        (("--flips", 0.1), "uniform noise has no flips; camera noise has one"),
        (("--motion", "jump"), "choose one of walk, smooth"),
        (("--root", "flying"), "choose one of moving, static"),
        (("--outliers", "1.5"), "share of outliers is 1.5"),
        (("--missing", "-1"), "share of missing poses is -1.0"),
        (("--seed", "-3"), "seed: have -3; want a whole number, 0 or more"),
        (("--inflation", "-3"), "inflation: have -3"),
        (("--planar",), "lamp: joint 'lean' (revolute): its axis is 0 1 0; want one along z"),
        (("--frames", 1_000_000), "poses at once"),
    ],
)
def test_what_can_not_be_is_one_clear_error_and_nothing_is_written(station, tmp_path: Path, arguments, said: str):
    code, out, err = station("simulate", "lamp", "--out", tmp_path / "poses.csv", *arguments)
    assert code == 1 and not out and is_one_clear_error(err) and said in err
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_can_not_be_written_is_one_clear_error(station, tmp_path: Path):
    (tmp_path / "file").write_text("")
    for out, said in (
        (tmp_path / "file" / "poses.csv", "can't write"),
        (tmp_path / "poses.txt", "want a file ending in .csv"),
        (tmp_path / "folder.csv", "is a folder; name a file in it"),
    ):
        (tmp_path / "folder.csv").mkdir(exist_ok=True)
        code, _, err = station("simulate", "lamp", "--out", out)
        assert code == 1 and is_one_clear_error(err) and said in err


def test_what_is_no_option_or_no_number_is_a_wrong_usage(station, tmp_path: Path):
    for arguments in (("lamp",), ("--out", "poses.csv"), ("lamp", "--out", "poses.csv", "--frames", "many")):
        assert station("simulate", *arguments)[0] == 2


def test_too_few_poses_for_a_fit_are_warned_of(station, tmp_path: Path):
    code, _, err = station("simulate", "lamp", "--out", tmp_path / "poses.csv", "--frames", 3)
    assert code == 0 and "warning: fewer than 10 poses to fit of foot (3)" in err


def changed(**joint: object) -> dict[str, object]:
    """The tree with one thing wrong about its second joint."""
    second = {key: value for key, value in (BEFORE["joints"][1] | joint).items() if value is not None}
    return BEFORE | {"joints": [BEFORE["joints"][0], second]}


WRONG_TREES = {
    "a cycle": (
        BEFORE
        | {"parts": ["frame", "door", "handle", "knob"], "root": "knob"}
        | {"joints": [BEFORE["joints"][0] | {"parent": "handle"}, BEFORE["joints"][1]]},
        "a loop",
    ),
    "two parents": (changed(parent="frame", child="door"), "'door' has two parents: frame and frame"),
    "an unknown type": (changed(type="hinge"), "joint 'turn' has the type 'hinge'; want one of rigid, prismatic"),
    "a zero axis": (changed(axis_parent=[0, 0, 0]), "joint 'turn' (revolute): a joint axis has length 0"),
    "limits reversed": (changed(limits={"min": 1.0, "max": -1.0}), "joint 'turn': limits from 1.0 to -1.0; want"),
    "a joint named twice": (changed(name="hinge"), "joint named twice: hinge"),
    "a part named twice": (BEFORE | {"parts": ["frame", "door", "handle", "door"]}, "part named twice: door"),
    "an unknown part": (changed(child="knob"), "joint 'turn' at 'knob', which is no body"),
    "one joint's ends": (changed(child="door"), "joint 'turn' has 'door' at both ends"),
    "a drawer without limits": (
        changed(type="prismatic", point_parent_m=None, limits=None),
        "joint 'turn' (prismatic) has no limits: how far may it move?",
    ),
    "NaN": (changed(axis_parent=[0, 0, float("nan")]), "NaN is no JSON"),
    "a reflection": (changed(T_parent_child_zero=np.diag([1.0, 1, -1, 1]).tolist()), "no rigid motion"),
    "an unknown key": (changed(colour="red"), "unknown key 'joints[1].colour'"),
    "another schema": (BEFORE | {"schema": "kinematics/2"}, 'schema is "kinematics/2"; this version reads'),
}


@pytest.mark.parametrize("what", WRONG_TREES)
def test_a_wrong_tree_file_is_one_clear_error_with_its_name(station, tmp_path: Path, what: str):
    values, said = WRONG_TREES[what]
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    code, out, err = station("simulate", path, "--out", tmp_path / "poses.csv")
    assert code == 1 and not out and is_one_clear_error(err)
    assert said in err and "mine.json" in err
    assert [file.name for file in tmp_path.iterdir()] == ["mine.json"]


LINKS = '<link name="frame"/><link name="door"/><link name="handle"/>'


def urdf_joint(name: str, parent: str, child: str, type_: str = "revolute", inside: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    limit = '<limit lower="0" upper="1" effort="1" velocity="1"/>' if "limit" not in inside else ""
    return f'<joint name="{name}" type="{type_}">{ends}{limit}{inside}</joint>'


GOOD_HINGE = urdf_joint("hinge", "frame", "door")
WRONG_URDFS = {
    "a cycle": (urdf_joint("a", "door", "handle") + urdf_joint("b", "handle", "door"), "want one"),
    "two parents": (
        GOOD_HINGE + urdf_joint("b", "handle", "door") + urdf_joint("c", "frame", "handle"),
        "'door' has two parents: frame and handle",
    ),
    "an unknown type": (urdf_joint("a", "frame", "door", "hinge"), "joint 'a' is hinge; can read revolute"),
    "a zero axis": (
        urdf_joint("a", "frame", "door", inside='<axis xyz="0 0 0"/>'),
        "joint 'a': the axis has no direction",
    ),
    "limits reversed": (
        urdf_joint("a", "frame", "door", inside='<limit lower="1" upper="-1"/>') + urdf_joint("b", "door", "handle"),
        "joint 'a': limits from 1.0 to -1.0",
    ),
    "names that collide": (
        '<link name="Door"/>' + GOOD_HINGE + urdf_joint("b", "door", "handle") + urdf_joint("c", "frame", "Door"),
        "named 'door' here, and so is another",
    ),
    "a link apart": (GOOD_HINGE, "2 links have no joint above them (frame, handle); want one"),
    "no XML": ("<joint", "is no XML"),
}


@pytest.mark.parametrize("what", WRONG_URDFS)
def test_a_wrong_urdf_is_one_clear_error_with_its_name(station, tmp_path: Path, what: str):
    body, said = WRONG_URDFS[what]
    path = tmp_path / "mine.urdf"
    path.write_text(f'<robot name="mine">{LINKS}{body}</robot>', encoding="utf-8")
    code, out, err = station("simulate", path, "--out", tmp_path / "poses.csv")
    assert code == 1 and not out and is_one_clear_error(err)
    assert said in err and "mine.urdf" in err
    assert [file.name for file in tmp_path.iterdir()] == ["mine.urdf"]


def test_a_tree_that_is_not_there_is_told_with_those_that_come_with_the_package(station, tmp_path: Path):
    code, _, err = station("simulate", "swivelchair", "--out", tmp_path / "poses.csv")
    assert code == 1 and is_one_clear_error(err) and "no tree 'swivelchair'" in err and "swivel_chair" in err
    code, _, err = station("simulate", tmp_path, "--out", tmp_path / "poses.csv")
    assert code == 1 and is_one_clear_error(err) and "kinematics.json" in err


def test_the_page_tells_every_option_that_there_is(station):
    page = (Path(__file__).parents[1] / "docs" / "simulator.md").read_text("utf-8")
    code, said, _ = station("simulate", "--help")
    options = set(re.findall(r"^  (--[a-z-]+)", said, re.MULTILINE))
    assert code == 0 and len(options) > 15
    assert options <= set(re.findall(r"--[a-z-]+", page))
