"""Trees that poses on wrong branches hide are found; what needs no second look has none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from station.fit.image.pose_choices import two_poses
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.result import Fit
from station.fit.second_looks import is_doubtful, looked_again, numbers_of, square_of
from station.kinematics import se3
from station.logs import FloatArray, PoseLog
from station.tree_scores import score_tree
from tests.fit.image.seen_objects import Scene
from tests.fit.image.simulated_views import Seeing, Watched, watched

HINGES = FitOptions(joint_types=("rigid", "revolute"))


def far_hinges(seed: int) -> Watched:
    """Two hinges whose markers of 25 px are seen nearly from their fronts, with 0.2 px of noise."""
    kinds = ("revolute",)
    scene = Scene(joints=2, frames=50, kinds=kinds, distance_m=(0.9, 1.4), tilt_deg=(0.0, 40.0))
    return watched([72, seed], scene, Seeing(sigma_px=0.2))


@cache
def looked_at() -> tuple[Watched, Fit]:
    """One of these, with its fit."""
    seen = far_hinges(35)
    return seen, learn(seen.poses, HINGES, seen.views)


def without_questions(fit: Fit, seen: Watched, other: Fit) -> Fit:
    """What a second look makes of a fit, if every other log tells the same other fit."""

    def learned(log: PoseLog) -> Iterator[None]:
        return other
        yield

    looking = looked_again(fit, seen.poses, seen.views, learned)
    with pytest.raises(StopIteration) as end:
        next(looking)
    return end.value.value


def test_a_tree_is_found_that_poses_on_wrong_branches_hide() -> None:
    seen, fit = looked_at()
    assert not score_tree(learn(seen.poses, HINGES).tree, seen.tree).structure_correct  # else this seed shows nothing
    assert score_tree(fit.tree, seen.tree).types_correct
    assert not is_doubtful(fit)


def test_of_two_trees_the_likelier_is_kept_and_one_that_is_as_likely_is_told() -> None:
    seen, right = looked_at()
    assert right.image is not None
    alone = tuple((part,) for part in right.tree.parts)
    free = replace(right, tree=replace(right.tree, trees=alone, joints=()), image=None)
    of_right, of_free = ([f(fit, seen.poses, seen.views) for f in (square_of, numbers_of)] for fit in (right, free))
    assert of_right[0] > of_free[0]  # more freedom explains more
    assert of_right[1] < of_free[1]
    assert of_right[0] + of_right[1] < of_free[0] + of_free[1]  # but no more than chance has it
    assert without_questions(free, seen, right) is right
    assert without_questions(right, seen, free) is right  # nothing in doubt, nothing asked
    doubted = replace(right, image=replace(right.image, inlier=np.zeros(len(right.image.inlier))))
    last, body = right.tree.joints[-1], right.tree.joints[0].parent
    elsewhere = replace(last, parent=body if last.parent != body else right.tree.joints[0].child)
    alike = replace(doubted, tree=replace(right.tree, joints=(right.tree.joints[0], elsewhere)))
    told = without_questions(doubted, seen, alike)
    assert told.tree.joints == doubted.tree.joints
    (warning,) = set(told.tree.warnings) - set(doubted.tree.warnings)
    assert warning.startswith("another tree explains the corners nearly as well (revolute ")
    assert "the odds are 1.0 to 1" in warning


def test_poses_are_chosen_where_there_are_two() -> None:
    seen, _ = looked_at()
    poses, log = two_poses(seen.poses, seen.views), seen.poses
    at = poses.frame, poses.part
    assert 0.5 < poses.share <= 1
    assert np.all((poses.probability >= 0) & (poses.probability <= 0.5 + 1e-9))
    np.testing.assert_array_equal(poses.likelier().T_ref_part[at], poses.T_ref_part[:, 0])
    assert log.covariance is not None
    for other in (poses.between(), poses.wider()):
        assert other.covariance is not None
        more = other.covariance[at] - log.covariance[at]
        assert np.linalg.eigvalsh(more).min() > -1e-9 * np.abs(more).max()
        untouched = np.ones(log.seen.shape, dtype=bool)
        untouched[at] = False
        np.testing.assert_array_equal(other.T_ref_part[untouched], log.T_ref_part[untouched])
    between = poses.between().T_ref_part[at]
    apart = turned(poses.T_ref_part[:, 0], poses.T_ref_part[:, 1])
    np.testing.assert_allclose(
        turned(poses.T_ref_part[:, 0], between) + turned(between, poses.T_ref_part[:, 1]), apart, atol=1e-6
    )


def test_of_two_poses_those_are_taken_that_a_tree_tells() -> None:
    seen, fit = looked_at()
    poses, image = two_poses(seen.poses, seen.views), fit.image
    assert image is not None
    where = image.T_ref_part[:, [image.views.parts.index(part) for part in seen.poses.parts]][poses.frame, poses.part]
    off = np.stack([turned(where, poses.T_ref_part[:, i]) for i in (0, 1)], axis=-1)
    with_it = poses.as_told(image).T_ref_part[poses.frame, poses.part]
    np.testing.assert_allclose(turned(where, with_it), off.min(axis=-1), atol=1e-9)
    part = seen.poses.parts[0]
    against = poses.as_told(image, frozenset({part})).T_ref_part[poses.frame, poses.part]
    np.testing.assert_allclose(
        turned(where, against), np.where(poses.part == 0, off.max(axis=-1), off.min(axis=-1)), atol=1e-9
    )


@pytest.mark.parametrize("root_moves", [False, True])
def test_a_clean_session_is_not_looked_at_again(root_moves: bool) -> None:
    scene = Scene(joints=3, frames=60, tilt_deg=(0.0, 25.0), root_moves=root_moves)
    seen = watched([71, 0], scene, Seeing(sigma_px=0.1, missing=0.1, outliers=0.03, stated=0.5))
    fit = learn(seen.poses, views=seen.views)
    assert score_tree(fit.tree, seen.tree).types_correct
    assert not is_doubtful(fit)


def turned(T: FloatArray, other: FloatArray) -> FloatArray:
    """(n,) [rad] between poses."""
    return se3.angle((se3.inverse(T) @ other)[..., :3, :3])
