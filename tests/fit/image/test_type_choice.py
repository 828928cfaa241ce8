"""A joint is of the simplest type that explains its corners, and of no simpler one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.learner import learn
from station.fit.options import FitOptions
from station.tree_scores import score_tree
from tests.fit.image.seen_objects import Scene, seen_object
from tests.fit.image.simulated_views import Seeing, Watched, watch, watched
from tests.rendered_markers import webcam

ALL = FitOptions(joint_types=("rigid", "prismatic", "revolute", "screw", "spherical"))
HINGES = Scene(joints=2, kinds=("revolute",), frames=100, root_moves=True)
# Turns to both sides.
FAR_RAD = 0.3


def nearly_a_hinge(slight_rad: float) -> Watched:
    """A ball that turns far about one axis, and by so much about the others."""
    seen = seen_object(np.random.default_rng(5), Scene(joints=1, kinds=("spherical",), frames=120), webcam())
    (courses,) = seen.courses
    halves = (FAR_RAD, slight_rad, slight_rad)
    slight = tuple((course, half) for (course, _), half in zip(courses, halves, strict=True))
    return watch(np.random.default_rng(6), replace(seen, courses=(slight,)), Seeing(sigma_px=0.05))


@pytest.mark.parametrize(("seed", "by_poses"), [(7, "screw"), (25, "spherical")])
def test_hinges_that_poses_call_a_screw_or_a_ball_are_hinges_by_their_corners(seed: int, by_poses: str) -> None:
    w = watched([seed, 0], HINGES)
    assert by_poses in {joint.type for joint in learn(w.poses, ALL).tree.joints}  # else it shows nothing
    tree = learn(w.poses, ALL, w.views).tree
    assert score_tree(tree, w.tree).types_correct
    for joint in tree.joints:
        assert joint.probability is not None
        assert joint.type == max(joint.probability, key=joint.probability.__getitem__)
        assert sum(joint.probability.values()) == pytest.approx(1.0)


def test_a_ball_that_hardly_turns_but_about_one_axis_is_a_ball() -> None:
    w = nearly_a_hinge(np.radians(1.0))
    assert [joint.type for joint in learn(w.poses, ALL, w.views).tree.joints] == ["spherical"]
