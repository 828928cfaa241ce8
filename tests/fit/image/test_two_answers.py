"""Frames that corners tell in two ways are decided where anything decides them, and told where nothing does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.image.camera_numbers import unknowns
from station.fit.image.corner_data import corner_data
from station.fit.image.doubts import remarks_on_corners
from station.fit.image.refinement import Refined, refine_image
from station.fit.image.two_answers import other_answers, turned_over
from station.fit.learner import learn
from station.kinematics import se3
from station.logs import FloatArray
from tests.benchmarks.made_joints import MadeJoint, inverse, poses, random_rotations
from tests.fit.image.seen_objects import FPS, SIZE_M, Course, Scene, SeenObject
from tests.fit.image.simulated_views import Seeing, Watched, watch, watched
from tests.fit.true_trees import true_tree
from tests.rendered_markers import facing

FRAMES = 90
HALF_RAD = 0.35
# Errors that are no noise, in radians: the two answers are up to 0.7 apart.
WRONG_RAD = 0.15


def frontal_hinge(course: Course, *, sigma_px: float, far_m: float = 2.0) -> Watched:
    """A hinge across the line of sight through the middle of a marker that turns to both sides of its front."""
    base = facing(np.radians(45), 0.3, 0.2, far_m * np.array([-0.08, 0.05, 1.0]))
    child = facing(0.0, 0.0, 0.0, far_m * np.array([0.0, 0.0, 1.0]))
    T_base_child = inverse(base) @ child
    joint = MadeJoint("revolute", 0, 1, base[:3, :3].T @ [1.0, 0.0, 0.0], T_base_child[:3, 3], T_base_child, 0.0)
    both = np.stack([np.eye(4)] * 2)
    scene = Scene(joints=1, frames=FRAMES)
    seen = SeenObject(scene, (joint,), (((course, HALF_RAD),),), base, (), (0, 1), both, (0, 1), both)
    return watch(np.random.default_rng(61), seen, Seeing(sigma_px=sigma_px))


def swinging(t_s: FloatArray) -> FloatArray:
    return np.cos(2 * np.pi * np.asarray(t_s) * FPS / FRAMES)


def jumping(t_s: FloatArray) -> FloatArray:
    """Anywhere in each frame: those around tell nothing."""
    return np.random.default_rng(62).uniform(-1, 1, FRAMES)[np.round(np.asarray(t_s) * FPS).astype(int)]


def refined(seen: Watched) -> Refined:
    skeleton, model = true_tree(seen.made)
    return refine_image(skeleton, model, seen.made.parts, seen.views, unknowns(seen.views.camera, 0.0))


def errors(seen: Watched, found: Refined) -> FloatArray:
    """(T,) [rad]; zero is arbitrary."""
    off = found.fit.model.q[:, 0] - seen.made.q[0][:, 0]
    return off - np.median(off)


def test_frames_with_two_answers_are_told_and_their_deviations_are_honest() -> None:
    seen = frontal_hinge(jumping, sigma_px=0.1)
    found = refined(seen)
    off, std = errors(seen, found), np.sqrt(found.fit.state_covariance[0][:, 0, 0])
    wrong, told = np.abs(off) > WRONG_RAD, found.image.two_answers[:, 1]
    assert 5 < wrong.sum() < FRAMES / 2
    assert np.sum(wrong & ~told) <= 1  # noise of three deviations, near the front, is as large
    assert not found.image.two_answers[:, 0].any()
    assert np.all(np.abs(off) < 5 * std)
    assert np.array_equal(found.image.doubtful, told[seen.views.frame] & (seen.views.marker == 1))
    (remark,) = remarks_on_corners(found.image)
    assert remark.startswith(f"{told.sum()} frames may have the other of two answers")
    assert f"{told.sum()} of p1_b1" in remark


def test_frames_around_decide_between_two_answers() -> None:
    seen = frontal_hinge(swinging, sigma_px=0.1, far_m=1.0)
    found = refined(seen)
    skeleton, model = true_tree(seen.made)
    skeleton, model = replace(skeleton, shared=1), replace(model, shared=np.zeros(1))
    data = corner_data(seen.views, seen.made.parts, unknowns(seen.views.camera, 0.0))
    alike = other_answers(skeleton, model, data)
    assert len(alike.frame) > 10
    assert found.image.two_answers[:, 1].sum() < len(alike.frame) / 2
    assert np.abs(errors(seen, found)).max() < WRONG_RAD


def test_the_likelier_of_two_answers_is_offered() -> None:
    """Every third frame is at the worse one, which is a minimum too."""
    seen = frontal_hinge(jumping, sigma_px=0.03, far_m=1.0)
    skeleton, true = true_tree(seen.made)
    skeleton, worse = replace(skeleton, shared=1), np.arange(FRAMES) % 3 == 0
    model = replace(true, shared=np.zeros(1), q=np.where(worse[:, None], -true.q, true.q))
    data = corner_data(seen.views, seen.made.parts, unknowns(seen.views.camera, 0.0))
    likelier = other_answers(skeleton, model, data).likelier()
    clearly = worse & (np.abs(true.q[:, 0]) > WRONG_RAD)
    assert np.isin(np.flatnonzero(clearly), likelier.frame).all()
    assert worse[likelier.frame].all()
    np.testing.assert_allclose(likelier.model.q, true.q[likelier.frame], atol=0.1)  # rad, near the front


def test_a_marker_turned_over_is_tilted_as_much_the_other_way() -> None:
    rng = np.random.default_rng(63)
    points_m = SIZE_M / 2 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) + rng.normal(size=3)
    place = rng.normal(size=(50, 3)) + np.array([0, 0, 9.0])
    T = se3.pose(poses(random_rotations(rng, 50), np.zeros(3))[:, :3, :3], place)
    other = turned_over(T, points_m)
    centre, other_centre = (X[:, :3, :3] @ points_m.mean(axis=0) + X[:, :3, 3] for X in (T, other))
    np.testing.assert_allclose(other_centre, centre, atol=1e-12)
    sight = centre / np.linalg.norm(centre, axis=-1, keepdims=True)
    n, m = T[:, :3, 2], other[:, :3, 2]
    np.testing.assert_allclose(m, 2 * np.sum(n * sight, axis=-1, keepdims=True) * sight - n, atol=1e-12)
    across = np.cross(n, sight)
    np.testing.assert_allclose(
        np.swapaxes(T[:, :3, :3], 1, 2) @ across[..., None],
        np.swapaxes(other[:, :3, :3], 1, 2) @ across[..., None],
        atol=1e-12,
    )
    np.testing.assert_allclose(turned_over(other, points_m), T, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_clean_sessions_have_no_doubts(seed: int) -> None:
    """Not one sighting, and no remark."""
    seen = watched([64, seed], Scene(joints=3, frames=60, root_moves=bool(seed % 2)), Seeing(sigma_px=0.05))
    fit = learn(seen.poses, views=seen.views)
    assert fit.image is not None
    assert not fit.image.doubtful.any()
    assert remarks_on_corners(fit.image) == []


def test_sightings_that_fit_nowhere_are_told() -> None:
    seen = watched(65, Scene(joints=3, frames=60), Seeing(outliers=0.03))
    found = refined(seen)
    assert np.array_equal(found.image.doubtful, seen.outlier)
    (remark,) = remarks_on_corners(found.image)
    assert remark.startswith(f"{seen.outlier.sum()} of {len(seen.outlier)} sightings fit the tree nowhere")


@pytest.mark.parametrize(
    ("frames", "sigma_px", "why"),
    [
        (
            60,
            0.05,
            "in each frame otherwise: there is more noise than stated; or a joint is a wrong one, and its states",
        ),
        (100, 3.0, "alike from frame to frame: the tree may be wrong there, and states of its joints"),
    ],
)
def test_a_marker_that_moves_otherwise_than_its_joint_is_told(frames: int, sigma_px: float, why: str) -> None:
    """A hinge taken for a slide. Where it moves fast, frames one after the other differ; with much noise it is off by
    less than twice that.
    """
    seen = watched(66, Scene(joints=3, frames=frames, kinds=("revolute",)), Seeing(sigma_px=sigma_px))
    slides = tuple(replace(joint, type="prismatic") if j == 2 else joint for j, joint in enumerate(seen.made.joints))
    image = refined(replace(seen, made=replace(seen.made, joints=slides))).image
    assert image.misfit[3]
    assert image.in_doubt[image.views.marker == 3].all()
    (remark,) = [remark for remark in remarks_on_corners(image) if "times as far off" in remark]
    assert "3 (p3_b3)" in remark.partition(" are ")[0]
    assert why in remark


def test_more_noise_than_stated_is_no_wrong_tree() -> None:
    """Of one marker four times as much, of all others twice."""
    seen = watched(66, Scene(joints=3, frames=60, kinds=("revolute",)), Seeing(sigma_px=0.05, stated=0.5))
    more = np.where(seen.views.marker == 3, 1.0, 0.0)[:, None, None] * seen.error_px.reshape(-1, 4, 2)
    noisier = replace(seen.views, corners_px=seen.views.corners_px + more)
    image = refined(replace(seen, views=noisier)).image
    assert np.abs(image.alike).max() < 0.3
    assert not image.misfit.any()
    assert not any("tree may be wrong" in remark for remark in remarks_on_corners(image))


def test_a_marker_of_which_much_fits_nowhere_is_doubtful_as_a_whole() -> None:
    seen = watched(65, Scene(joints=3, frames=60), Seeing())
    gone = (seen.views.marker == 2) & (seen.views.frame % 3 == 0)
    elsewhere = replace(seen.views, corners_px=seen.views.corners_px + 40.0 * gone[:, None, None])
    image = refined(replace(seen, views=elsewhere)).image
    assert np.array_equal(image.in_doubt, seen.views.marker == 2)
    _, remark = remarks_on_corners(image)
    assert remark.startswith("so many are left out of marker 2 (p2_b2) that the tree may be wrong there")
