"""Where further trackers of a body sit: found by the fit, kept in trees and files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from station.builder import edits
from station.builder.documents import from_text, to_text
from station.errors import InvalidData
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.formats.urdf import from_urdf, to_urdf
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.kinematics.tree_json import from_json, to_json
from station.logs import PoseLog
from station.simulate import SimulationOptions, simulate
from station.simulate.noise import GaussianNoise

HANDLE = se3.exp(np.array([0.1, 0.02, -0.05, 0.3, 1.2, -0.4]))
PLATE = se3.exp(np.array([-0.08, 0.0, 0.04, 0.0, -0.5, 0.2]))
NOISE_M, NOISE_RAD = 0.001, 0.005


def door(**changes: object) -> KinematicTree:
    """A wall and a leaf on a hinge; a plate on the wall and a handle on the leaf are tracked besides."""
    hinge = Joint(
        "hinge", "revolute", "wall", "leaf", np.array([0.0, 0.0, 1.0]), np.zeros(3), se3.translation([0.4, 0, 0])
    )
    values: dict = {
        "root": "wall",
        "parts": ("wall", "leaf", "plate", "handle"),
        "rigid_groups": (("wall", "plate"), ("leaf", "handle")),
        "trees": (("wall", "leaf"),),
        "joints": (replace(hinge, limits=(0.0, 1.5)),),
        "mounts": {"plate": PLATE, "handle": HANDLE},
    }
    return KinematicTree(**(values | changes))


def watched(root: str, seed: int = 3, *, noise: float = 1.0) -> PoseLog:
    noisy = GaussianNoise(noise * NOISE_M, noise * NOISE_RAD)
    return simulate(door(), SimulationOptions(frames=150, noise=noisy, root=root), seed=seed).log


@pytest.mark.parametrize("root", ["static", "moving"])
@pytest.mark.parametrize(("method", "noise"), [("station", 1.0), ("paper", 0.0)])  # AIC finds nothing rigid in noise
def test_a_fit_finds_where_further_trackers_sit_on_their_bodies(method: str, noise: float, root: str) -> None:
    tree = learn(watched(root, noise=noise), FitOptions(method=method, root="wall")).tree
    assert set(tree.mounts) == {"plate", "handle"}
    for part, truth in door().mounts.items():
        error = se3.log(se3.inverse(truth) @ tree.mounts[part])
        assert np.linalg.norm(error[:3]) < NOISE_M
        assert np.linalg.norm(error[3:]) < NOISE_RAD


def test_a_body_that_no_joint_holds_has_its_mounts_too() -> None:
    log = watched("moving")
    parts = [log.parts.index(name) for name in ("leaf", "handle")]
    tree = learn(PoseLog(log.t_s, log.reference, ("leaf", "handle"), log.T_ref_part[:, parts])).tree
    error = se3.log(se3.inverse(HANDLE) @ tree.mounts["handle"])
    assert np.linalg.norm(error[3:]) < NOISE_RAD


def test_a_copy_of_a_tracker_is_mounted_where_it_repeats_it() -> None:
    log = watched("static")
    offset = se3.exp(np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.7]))
    handle = log.T_ref_part[:, log.parts.index("handle")]
    T = np.concatenate([log.T_ref_part, (handle @ offset)[:, None]], axis=1)
    tree = learn(PoseLog(log.t_s, log.reference, (*log.parts, "again"), T), FitOptions(root="wall")).tree
    np.testing.assert_allclose(tree.mounts["again"], tree.mounts["handle"] @ offset, atol=1e-9)


def test_mounts_read_back_and_a_file_without_them_is_read() -> None:
    again = from_json(to_json(door()), "kinematics.json")
    for part, T in door().mounts.items():
        np.testing.assert_array_equal(again.mounts[part], T)
    values = json.loads(to_json(door()))
    del values["mounts"]
    assert from_json(json.dumps(values), "old.json").mounts == {}


def test_a_tree_without_mounts_has_no_such_key() -> None:
    assert "mounts" not in json.loads(to_json(door(mounts={})))


@pytest.mark.parametrize(
    ("mounts", "message"),
    [
        ({"leaf": np.eye(4)}, "'leaf', which is no further tracker of a body; have plate, handle"),
        ({"knob": np.eye(4)}, "'knob', which is no further tracker"),
        ({"plate": 2 * np.eye(4)}, "mount of 'plate' is no rigid motion"),
    ],
)
def test_mounts_that_can_be_none_are_refused(mounts: dict, message: str) -> None:
    with pytest.raises(InvalidData, match=message):
        door(mounts=mounts)


def test_a_urdf_has_the_trackers_where_they_are() -> None:
    again = from_urdf(to_urdf(door(), "door"), "door.urdf")
    assert set(again.mounts) == {"plate", "handle"}
    for part, T in door().mounts.items():
        np.testing.assert_allclose(again.mounts[part], T, atol=1e-9)


def test_mounts_follow_their_parts_through_the_builder() -> None:
    draft = from_text(to_json(door()), "door.json")
    renamed = edits.rename_part(draft, "leaf", "flap").tree
    np.testing.assert_array_equal(renamed.mounts["handle"], HANDLE)
    assert set(edits.delete_part(draft, "leaf").tree.mounts) == {"plate"}
    assert set(from_text(to_text(draft), "door.json").tree.mounts) == {"plate", "handle"}
