"""Errors that repeat with the pose are no joints; motions of the same size are, and what was made simpler is judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.image import refinement
from station.fit.image.at_rest import AtRest
from station.fit.image.seeming_motion import seem_to_move
from station.fit.image.simpler import explains_as_well
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.tree_solver import refined
from station.kinematics.joints import JOINT_TYPES
from station.tree_scores import score_tree
from tests.fit.image.seen_objects import Course, Scene, seen_object
from tests.fit.image.simulated_views import Seeing, Watched, watch, watched
from tests.fit.image.test_corner_data import problem_of
from tests.rendered_markers import webcam

TWO_ON_EACH = Scene(joints=2, kinds=("revolute",), frames=150, trackers=(2, 2))
# In-plane travel to both sides that corners tell by hundredths of a pixel.
SLIGHT_M = 4e-5


def slid_slightly(seed: int, *, as_the_hinge_turns: bool) -> Watched:
    """Three bodies, one of which slides in another by hundredths of a pixel: at its own pace, or by a hinge's angle."""
    scene = Scene(joints=2, kinds=("revolute", "prismatic"), frames=200)
    seen = seen_object(np.random.default_rng(seed), scene, webcam())
    slide = [joint.type for joint in seen.joints].index("prismatic")
    ((own, _),), ((turning, half_rad),) = seen.courses[slide], seen.courses[1 - slide]
    course: Course = (lambda t_s: np.sin(4 * half_rad * turning(t_s))) if as_the_hinge_turns else own
    courses = list(seen.courses)
    courses[slide] = ((course, SLIGHT_M),)
    return watch(np.random.default_rng([seed, 1]), replace(seen, courses=tuple(courses)), Seeing(sigma_px=0.01))


@pytest.mark.parametrize("seed", [4, 10])
def test_trackers_that_errors_by_pose_move_in_each_other_are_found_to_be_one_body(seed: int) -> None:
    w = watched([seed], TWO_ON_EACH, Seeing(sigma_px=0.02, uneven_px=0.03))
    assert not score_tree(learn(w.poses).tree, w.tree).groups_correct  # else this seed shows nothing
    assert score_tree(learn(w.poses, FitOptions(), w.views).tree, w.tree).types_correct


@pytest.mark.parametrize("as_the_hinge_turns", [False, True])
def test_a_slight_motion_is_one_unless_it_goes_with_the_bodys_pose(*, as_the_hinge_turns: bool) -> None:
    w = slid_slightly(9, as_the_hinge_turns=as_the_hinge_turns)
    problem, model = problem_of(w)
    slide = next(joint for joint in problem.skeleton.joints if joint.type is JOINT_TYPES["prismatic"])
    none = ((slide.near, slide.far),) if as_the_hinge_turns else ()
    assert seem_to_move(problem, refined(problem, model)) == none


def test_a_joint_that_moves_is_kept_though_it_was_said_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    w = watched(31, Scene(joints=2, kinds=("revolute",), frames=100))
    asked = learn(w.poses, FitOptions(), w.views)
    monkeypatch.setattr(refinement, "at_rest", lambda *_: AtRest((0,), ()))
    told = learn(w.poses, FitOptions(), w.views)
    assert [joint.name for joint in told.tree.joints] == [joint.name for joint in asked.tree.joints]


def test_a_simpler_tree_that_leaves_noise_or_doubts_explains_less() -> None:
    image = learn((w := watched(31, Scene(joints=2, frames=60))).poses, FitOptions(), w.views).image
    assert image is not None
    noisier = image.scale.copy()
    noisier[0] *= 1.5
    doubted = np.arange(len(image.views)) % 20 == 0
    assert explains_as_well(image, image)
    assert not explains_as_well(replace(image, scale=noisier), image)
    assert not explains_as_well(replace(image, doubtful=doubted), image)
    assert not explains_as_well(None, image)
