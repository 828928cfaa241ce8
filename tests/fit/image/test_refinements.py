"""What a tree is refined on: corners, poses, or nothing."""

from __future__ import annotations

import numpy as np
import pytest

from station.errors import InvalidData
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.result import Fit
from station.logs import FloatArray
from tests.fit.image.seen_objects import Scene
from tests.fit.image.simulated_views import Seeing, Watched, watched


@pytest.fixture(scope="module")
def seen() -> Watched:
    scene = Scene(joints=3, kinds=("revolute", "prismatic"), frames=150, tilt_deg=(0, 60))
    return watched(21, scene, Seeing(sigma_px=0.1, edge_shift_px=0.15, missing=0.1))


def worst_errors(fit: Fit, w: Watched) -> list[float]:
    """Of each true joint, the RMS error of the found state that follows it best, but for sign and zero."""
    found = []
    for true in w.states.q.T:
        errors = [sign * q - true for q in fit.states.q.T for sign in (1, -1)]
        found.append(min(float(np.nanstd(e)) for e in errors))
    return found


def errors_by(refinements: tuple[str, ...], w: Watched) -> list[FloatArray]:
    return [np.array(worst_errors(learn(w.poses, FitOptions(refine=name), w.views), w)) for name in refinements]


def test_corners_tell_states_better_than_poses_where_nobody_told_of_an_edge_shift(seen: Watched) -> None:
    image, pose = errors_by(("image", "pose"), seen)
    assert np.all(image < 1.02 * pose)
    assert np.sum(np.log(image / pose)) < np.log(0.75)


def test_a_whole_tree_tells_states_better_than_its_pairs(seen: Watched) -> None:
    pose, none = errors_by(("pose", "none"), watched(21, seen.seen.scene, Seeing(sigma_px=0.1)))
    assert np.sum(np.log(pose / none)) < np.log(0.5)


def test_the_edge_shift_is_found_with_its_deviation(seen: Watched) -> None:
    image = learn(seen.poses, FitOptions(), seen.views).image
    assert image is not None
    assert abs(image.numbers.edge_shift_px - 0.15) < 3 * image.numbers_std.edge_shift_px
    assert 0.001 < image.numbers_std.edge_shift_px < 0.1
    assert image.numbers.focal == 1.0
    assert np.isnan(image.numbers_std.focal)


def test_corners_are_the_default_where_there_are_any(seen: Watched) -> None:
    assert learn(seen.poses, FitOptions(), seen.views).image is not None
    assert learn(seen.poses, FitOptions()).image is None
    assert learn(seen.poses, FitOptions(refine="pose"), seen.views).image is None


@pytest.mark.parametrize(("refine", "told"), [("image", "no corners"), ("pixels", "choose one of image, pose, none")])
def test_what_cannot_be_refined_on_is_refused(seen: Watched, refine: str, told: str) -> None:
    with pytest.raises(InvalidData, match=told):
        learn(seen.poses, FitOptions(refine=refine))


def test_views_of_other_times_or_parts_are_refused(seen: Watched) -> None:
    with pytest.raises(InvalidData, match="part"):
        learn(seen.poses, FitOptions(), seen.views.of_parts(seen.views.parts[:2]))
    shorter = watched(21, Scene(joints=3, frames=50), seen.seeing)
    with pytest.raises(InvalidData, match="other times"):
        learn(seen.poses, FitOptions(), shorter.views)
