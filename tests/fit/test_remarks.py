"""What is uncertain about a fit is said in a sentence, and what is certain is not."""

from __future__ import annotations

import numpy as np
import pytest

from station.fit.learner import Fit, learn
from station.fit.options import FitOptions
from tests.benchmarks.made_joints import SOUND, Faults, single_joint, watch
from tests.benchmarks.read_fits import ALL_TYPES, found_type

STD_M, STD_RAD = 0.003, 0.02


def fitted(
    kind: str, travel: float, *, arm_m: float = 0.3, faults: Faults = SOUND, std_m: float = STD_M, frames: int = 200
) -> Fit:
    rng = np.random.default_rng(160)
    made = single_joint(rng, kind, frames=frames, travel=travel, arm_m=arm_m)
    types = FitOptions().joint_types if kind in FitOptions().joint_types else ALL_TYPES
    return learn(watch(rng, made.T_ref_part, std_m, STD_RAD, faults).log, FitOptions(joint_types=types))


@pytest.mark.parametrize(
    ("kind", "travel"), [("prismatic", 0.2), ("revolute", 1.5), ("screw", 5.0), ("spherical", 1.0)]
)
def test_of_a_joint_that_moved_well_nothing_is_said(kind: str, travel: float) -> None:
    fit = fitted(kind, travel)
    assert found_type(fit.tree) == kind and fit.tree.warnings == ()


@pytest.mark.parametrize(("kind", "travel", "said"), [("prismatic", 0.012, "mm"), ("revolute", 0.06, "deg")])
def test_an_axis_of_a_small_motion_is_said_not_to_be_identifiable(kind: str, travel: float, said: str) -> None:
    fit = fitted(kind, travel, frames=100)
    assert len(fit.tree.joints) == 1
    assert any("moved only" in w and said in w and "axis is not identifiable" in w for w in fit.tree.warnings)


def test_an_axis_that_is_lost_in_noise_is_said_to_be_known_roughly() -> None:
    fit = fitted("prismatic", 0.3, std_m=0.05, frames=60)
    assert found_type(fit.tree) == "prismatic"
    assert any("its axis is known to" in warning and "deg only" in warning for warning in fit.tree.warnings)


def test_a_type_that_is_no_more_than_likely_is_told_with_the_next_one() -> None:
    fit = fitted("revolute", np.radians(1.3), arm_m=1.0, frames=150)
    (joint,) = fit.tree.joints
    assert joint.probability is not None and joint.probability[joint.type] < 0.9
    (told,) = [warning for warning in fit.tree.warnings if "with a probability of" in warning]
    other = "prismatic" if joint.type == "revolute" else "revolute"
    assert f"{other} has {joint.probability[other]:.2f}" in told


def test_positions_alone_of_a_ball_say_nothing_of_the_turn_about_its_arm() -> None:
    """No state has a deviation there: none is warned about, and numpy warns of nothing."""
    fit = fitted("spherical", 1.5, faults=Faults(positions_only=True))
    assert found_type(fit.tree) == "spherical" and fit.tree.warnings == ()


def test_where_nothing_moved_that_is_said() -> None:
    rng = np.random.default_rng(161)
    made = single_joint(rng, "rigid", frames=100, travel=0.0, arm_m=0.3, parent_tracked=True)
    fit = learn(watch(rng, made.T_ref_part, STD_M, STD_RAD).log)
    assert fit.tree.warnings == ("no part moved against another: the tree has no joints",)


@pytest.mark.parametrize(("share", "said"), [(0.1, False), (0.35, True)])
def test_many_outliers_are_said_as_they_may_be_a_motion_that_is_left_unexplained(share: float, said: bool) -> None:
    fit = fitted("revolute", 1.5, faults=Faults(outliers=share))
    assert any("many frames are outliers" in warning for warning in fit.tree.warnings) == said
