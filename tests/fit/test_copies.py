"""Parts that repeat another one count once, are said to, and stay in the tree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.copies import without_copies
from station.fit.learner import Fit, FitOptions, learn
from station.logs import PoseLog
from tests.benchmarks.made_joints import inverse, random_poses, single_joint, watch

FRAMES, STD_M, STD_RAD = 120, 0.003, 0.02


def hinge() -> PoseLog:
    """Two tracked parts that move anyhow, a hinge between them."""
    rng = np.random.default_rng(110)
    made = single_joint(rng, "revolute", frames=FRAMES, travel=1.5, arm_m=0.3, parent_tracked=True)
    return replace(watch(rng, made.T_ref_part, STD_M, STD_RAD).log, parts=("base", "lid"))


def with_part(log: PoseLog, name: str, poses: np.ndarray) -> PoseLog:
    return replace(log, parts=(*log.parts, name), T_ref_part=np.concatenate([log.T_ref_part, poses[:, None]], axis=1))


def with_copy(log: PoseLog, *, digits: int = 15) -> PoseLog:
    """The log with a third part at a fixed offset from the second, its positions written with so many digits."""
    copy = log.T_ref_part[:, 1] @ random_poses(np.random.default_rng(111), 0.1)
    copy[:, :3, 3] = copy[:, :3, 3].round(digits)
    return with_part(log, "lid_b", copy)


def is_same(one: Fit, other: Fit, tolerance: float) -> bool:
    """The same states and deviations, to a relative tolerance."""
    assert one.states.std is not None and other.states.std is not None
    return np.allclose(one.states.q, other.states.q, atol=tolerance) and np.allclose(
        one.states.std, other.states.std, rtol=tolerance
    )


@pytest.mark.parametrize(("digits", "tolerance"), [(15, 1e-12), (6, 1e-5)])
def test_a_copy_changes_neither_states_nor_deviations_and_is_said_to_be_one(digits: int, tolerance: float) -> None:
    log = hinge()
    plain, fit = learn(log), learn(with_copy(log, digits=digits))
    assert is_same(plain, fit, tolerance)
    assert fit.tree.parts == ("base", "lid", "lid_b") and fit.tree.rigid_groups == (("lid", "lid_b"),)
    assert any("lid_b repeats lid" in warning for warning in fit.tree.warnings)


def test_a_root_may_be_a_copy_and_covariances_may_be_given() -> None:
    log = with_copy(hinge())
    covariance = np.tile(np.diag(np.repeat([STD_M**2, STD_RAD**2], 3)), (FRAMES, 3, 1, 1))
    fit = learn(replace(log, covariance=covariance), FitOptions(root="lid_b"))
    assert fit.tree.root == "lid" and [(j.parent, j.child) for j in fit.tree.joints] == [("lid", "base")]


def test_copies_fill_frames_in_which_the_other_was_not_seen() -> None:
    whole, log = hinge(), with_copy(hinge())
    poses, covariance = log.T_ref_part.copy(), np.tile(np.diag([1.0, 2, 3, 4, 5, 6]), (FRAMES, 3, 1, 1))
    poses[20:50, 1] = np.nan
    copies = without_copies(replace(log, T_ref_part=poses, covariance=covariance))
    assert copies.log.parts == ("base", "lid") and copies.repeats == {"lid_b": "lid"}
    np.testing.assert_allclose(copies.log.T_ref_part, whole.T_ref_part, atol=1e-12)
    T = inverse(log.T_ref_part[0, 2]) @ log.T_ref_part[0, 1]  # an error xi of the copy moves the other by Ad(T^-1) xi
    R, p_cross = T[:3, :3], np.cross(np.eye(3), T[:3, 3])
    Ad = np.block([[R.T, -R.T @ p_cross], [np.zeros((3, 3)), R.T]])
    assert copies.log.covariance is not None
    np.testing.assert_allclose(copies.log.covariance[30, 1], Ad @ covariance[30, 2] @ Ad.T, atol=1e-9)
    np.testing.assert_array_equal(copies.log.covariance[10, 1], covariance[10, 1])


def test_trackers_of_one_body_with_errors_of_their_own_are_no_copies() -> None:
    """Nor are exact parts that stand still, of which nothing tells that one repeats the other."""
    rng, log = np.random.default_rng(112), hinge()
    other = watch(rng, log.T_ref_part[:, 1:], 1e-4, 1e-3).log.T_ref_part[:, 0]
    assert not without_copies(with_part(log, "lid_b", other)).repeats
    still = np.tile(random_poses(rng, 0.5, 2), (FRAMES, 1, 1, 1))
    assert not without_copies(replace(log, T_ref_part=still)).repeats


def test_a_slide_of_a_few_micrometres_is_one() -> None:
    """Exact poses of a tiny thing: an offset that changes as much as the poses do is none."""
    still = np.tile(random_poses(np.random.default_rng(113), 0.5, 2), (FRAMES, 1, 1, 1))
    still[:, 1, 0, 3] += np.linspace(0, 2e-5, FRAMES)
    assert not without_copies(replace(hinge(), T_ref_part=still)).repeats
