"""Whether the root stands still can be told; what was found of it stands in the file."""

import numpy as np
import pytest

from station.errors import InvalidData
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.kinematics import se3
from station.logs import PoseLog
from station.simulate import SimulationOptions, simulate
from station.simulate.noise import GaussianNoise
from tests.fit.test_mounts import door

NOISE_M, NOISE_RAD = 0.001, 0.005


def watched(root: str, seed: int = 3) -> PoseLog:
    """A door, its wall still or moving; its parts have one tracker each."""
    made = simulate(
        door(rigid_groups=(), parts=("wall", "leaf"), mounts={}),
        SimulationOptions(frames=150, noise=GaussianNoise(NOISE_M, NOISE_RAD), root=root),
        seed=seed,
    )
    return made.log


@pytest.mark.parametrize(("root", "told"), [("static", "static"), ("moving", "moving")])
def test_a_fit_finds_whether_the_root_stands_still_and_says_so(root: str, told: str) -> None:
    assert learn(watched(root)).tree.method["root"] == told


def test_a_root_that_is_told_to_move_has_a_pose_in_each_frame() -> None:
    """The wall's marker errs anew in each frame: states are then less well known."""
    log = watched("static")
    still, moving = learn(log), learn(log, FitOptions(root_static=False, root="wall"))
    assert (still.tree.method["root"], moving.tree.method["root"]) == ("static", "moving")
    assert [joint.type for joint in moving.tree.joints] == ["revolute"]
    assert np.nanmedian(moving.states.std) > 1.2 * np.nanmedian(still.states.std)


@pytest.mark.parametrize("root", ["wall", None])
def test_a_root_that_is_told_to_stand_still_does_so_though_its_poses_wander(root: str | None) -> None:
    log = watched("static")
    t = np.linspace(0.0, 1.0, len(log.t_s))
    drift = se3.exp(np.stack([0.03 * t, *(0 * t for _ in range(4)), 0.05 * t], axis=-1))  # the camera sags
    sagging = PoseLog(log.t_s, log.reference, log.parts, drift[:, None] @ log.T_ref_part)
    assert learn(sagging).tree.method["root"] == "moving"
    tree = learn(sagging, FitOptions(root_static=True, root=root)).tree
    assert tree.root == "wall"
    assert tree.method["root"] == "static"


def test_the_reference_as_a_part_cannot_be_told_to_move() -> None:
    with pytest.raises(InvalidData, match="'world' is a part of the tree and stands still"):
        learn(watched("static"), FitOptions(root_static=False, include_reference=True))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (FitOptions(refine="corners"), "choose one of image, pose, none"),
        (FitOptions(camera_numbers=("zoom",)), "no number 'zoom'; choose of edge_shift_px, focal, readout_s"),
        (FitOptions(method="paper", refine="image"), "method 'paper' can't refine on 'image'"),
        (FitOptions(method="paper", refine="pose"), "want 'none', or method 'station'"),
        (FitOptions(method="paper", root_static=True), "method 'paper' can't be told"),
    ],
)
def test_what_can_not_be_asked_for_is_refused_with_the_choices(options: FitOptions, message: str) -> None:
    with pytest.raises(InvalidData, match=message):
        learn(watched("static"), options)
