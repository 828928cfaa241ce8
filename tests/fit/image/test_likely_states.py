"""States that least squares alone would not find: flipped starts, frames without poses, frames amid fast motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.image.camera_numbers import unknowns
from station.fit.image.carried_states import carried
from station.fit.image.corner_data import CornerData, corner_data
from station.fit.image.frame_search import chi2_of, state_equations
from station.fit.image.likely_states import Told, is_odd, with_likely_states
from station.fit.image.refinement import refine_image
from station.fit.image.views import Views
from station.fit.learner import learn
from station.fit.skeleton import Skeleton, TreeModel, with_moved_states
from station.fit.tree_motion import tree_poses
from station.kinematics import se3
from station.logs import FloatArray
from tests.fit.image.seen_objects import Scene
from tests.fit.image.simulated_views import Seeing, Watched, watched
from tests.fit.true_trees import true_tree

FRAMES = 80
# Tilted by so much a marker has two poses that are far apart.
TILTED_DEG = (25.0, 60.0)


def seen_tree(seed: int, *, root_moves: bool, seeing: Seeing | None = None) -> tuple[Watched, Skeleton, TreeModel]:
    scene = Scene(joints=3, frames=FRAMES, tilt_deg=TILTED_DEG, root_moves=root_moves)
    found = watched(seed, scene, Seeing() if seeing is None else seeing)
    return found, *true_tree(found.made)


def refined_poses(views: Views, skeleton: Skeleton, model: TreeModel, parts: tuple[str, ...]) -> FloatArray:
    return refine_image(skeleton, model, parts, views, unknowns(views.camera, 0.0)).image.T_ref_part


def turned_by(T: FloatArray, other: FloatArray) -> FloatArray:
    """(...) [rad] between two poses."""
    return np.linalg.norm(se3.log(se3.inverse(T) @ other)[..., 3:], axis=-1)


def data_of(seen: Watched) -> CornerData:
    return corner_data(seen.views, seen.made.parts, unknowns(seen.views.camera, 0.0))


@pytest.mark.parametrize("root_moves", [False, True])
def test_states_that_start_at_flipped_poses_are_found(root_moves: bool) -> None:
    """In every fourth frame all states are two radians or 0.3 m off, and a root that moves is turned by as much."""
    seen, skeleton, true = seen_tree(4, root_moves=root_moves)
    best = refined_poses(seen.views, skeleton, true, seen.made.parts)
    step = np.zeros((FRAMES, skeleton.states))
    units = [joint.type.unit for joint in skeleton.joints]
    step[::4, : skeleton.joint_states] = [2.0 if unit == "rad" else 0.3 for unit in units]
    step[::4, skeleton.joint_states + 3 :] = 1.2
    start = with_moved_states(skeleton, true, step)
    found = refined_poses(seen.views, skeleton, start, seen.made.parts)
    np.testing.assert_allclose(found, best, atol=1e-5)  # m, rad: the last step of each, of a tenth of a deviation


def test_frames_of_oblique_markers_alone_are_found() -> None:
    """No pose is made of a marker beyond 75 degrees; the tree says where it is."""
    scene = Scene(joints=3, frames=FRAMES, tilt_deg=(60.0, 82.0), kinds=("revolute",))
    seen = watched(3, scene, Seeing(sigma_px=0.05))
    without = ~np.array(seen.poses.seen)
    assert 0.02 < without.mean() < 0.6
    fit = learn(seen.poses, views=seen.views)
    assert fit.image is not None
    order = [seen.made.parts.index(part) for part in fit.image.views.parts]
    off = turned_by(fit.image.T_ref_part, seen.made.T_ref_part[:, order])
    assert np.all(np.isfinite(fit.states.q))
    assert off[without[:, order]].max() < np.radians(1.0)


def test_frames_at_which_nothing_started_are_found() -> None:
    """A third of them, in runs of up to ten, with the states of the first frame."""
    seen, skeleton, true = seen_tree(4, root_moves=True)
    best = refined_poses(seen.views, skeleton, true, seen.made.parts)
    lost = np.arange(FRAMES) % 30 < 10
    q = np.where(lost[:, None], true.q[:1], true.q)
    root = np.where(lost[:, None, None], true.T_ref_root[:1], true.T_ref_root)
    found = refined_poses(seen.views, skeleton, replace(true, q=q, T_ref_root=root), seen.made.parts)
    np.testing.assert_allclose(found, best, atol=1e-5)


def test_gross_errors_are_left_out_and_cost_no_other_sighting() -> None:
    seeing = Seeing(outliers=0.05, missing=0.1)
    for seed in (5, 6):
        seen, skeleton, true = seen_tree(seed, root_moves=bool(seed % 2), seeing=seeing)
        image = refine_image(skeleton, true, seen.made.parts, seen.views, unknowns(seen.views.camera, 0.0)).image
        assert np.array_equal(image.inlier < 0.5, seen.outlier)


@pytest.mark.parametrize("root_moves", [False, True])
def test_equations_of_states_are_those_of_finite_differences(root_moves: bool) -> None:
    """Gradients: half the change of the squared residuals; joints named from their far ends too, in `true_tree`."""
    seen, skeleton, true = seen_tree(7, root_moves=root_moves)
    skeleton, data = replace(skeleton, shared=1), data_of(seen)
    model = replace(true, shared=np.array([0.1]))
    found = state_equations(skeleton, model, data, data.seen.astype(float))

    def half_square(step: FloatArray) -> FloatArray:
        moved = with_moved_states(skeleton, model, np.tile(step, (FRAMES, 1)))
        return 0.5 * data.chi2(tree_poses(skeleton, moved).parts, model.shared).sum(axis=-1)

    size = 1e-6  # m, rad
    for i, step in enumerate(size * np.eye(skeleton.states)):
        slope = (half_square(step) - half_square(-step)) / (2 * size)
        np.testing.assert_allclose(slope, found.g[:, i], rtol=1e-4, atol=1e-3 * np.abs(found.g).max())


def test_states_are_carried_between_on_and_back() -> None:
    """At an even pace all three ways tell the same; where there is one side alone it tells all."""
    seen, skeleton, true = seen_tree(8, root_moves=True)
    t_s = seen.views.t_s
    pace = np.arange(1.0, skeleton.states + 1) * 0.1
    steady = with_moved_states(skeleton, replace(true, q=np.zeros_like(true.q)), t_s[:, None] * pace)
    first = steady.T_ref_root[0]
    steady = replace(steady, T_ref_root=first @ se3.exp(t_s[:, None] * pace[skeleton.joint_states :]))
    good = np.ones(FRAMES, dtype=bool)
    good[[0, 1, 20, 21, FRAMES - 1]] = False
    rows = np.flatnonzero(~good)
    wrong = steady.with_states(rows, true.take(rows))
    for way in carried(skeleton, wrong, t_s, rows, good):
        np.testing.assert_allclose(way.q[2:4], steady.q[rows][2:4], atol=1e-9)
        np.testing.assert_allclose(way.T_ref_root[2:4], steady.T_ref_root[rows][2:4], atol=1e-9)
    between, on, back = carried(skeleton, wrong, t_s, rows, good)
    np.testing.assert_allclose(on.q[-1], steady.q[-1], atol=1e-9)
    np.testing.assert_allclose(back.q[:2], steady.q[:2], atol=1e-9)
    np.testing.assert_allclose(between.q[0], steady.q[2], atol=1e-9)
    assert carried(skeleton, wrong, t_s, rows, np.zeros(FRAMES, dtype=bool)) == ()


def test_a_marker_tells_its_part_s_poses_or_none() -> None:
    seen, _, _ = seen_tree(9, root_moves=False)
    told = Told.of(data_of(seen))
    views = seen.views
    known = np.isfinite(views.T_ref_part).all(axis=(-2, -1))
    assert np.array_equal(told.known[views.frame, views.marker], known)
    np.testing.assert_array_equal(told.T_ref_part[views.frame, views.marker][known], views.T_ref_part[known])


def test_markers_alone_tell_all_states() -> None:
    """No frame is right to begin with, so that none around tells anything."""
    seen, skeleton, true = seen_tree(10, root_moves=True)
    skeleton, data = replace(skeleton, shared=1), data_of(seen)
    model = replace(true, shared=np.zeros(1), q=true.q + 1.5, T_ref_root=true.T_ref_root @ se3.exp(np.ones(6)))
    found, changed = with_likely_states(skeleton, model, data, Told.of(data), np.ones(FRAMES, dtype=bool))
    assert changed.all()
    assert not is_odd(data, chi2_of(skeleton, found, data)).any()


def test_frames_around_tell_states_where_no_marker_has_a_pose() -> None:
    seen, skeleton, true = seen_tree(11, root_moves=True)
    skeleton, data = replace(skeleton, shared=1), data_of(seen)
    odd = np.arange(FRAMES) % 8 == 4
    rows = np.flatnonzero(odd)
    wrong = replace(true, shared=np.zeros(1), q=true.q + 1.5, T_ref_root=true.T_ref_root @ se3.exp(np.ones(6)))
    model = replace(true, shared=np.zeros(1)).with_states(rows, wrong.take(rows))
    told = Told.of(data)
    silent = replace(told, known=np.zeros_like(told.known))
    found, _ = with_likely_states(skeleton, model, data, silent, odd)
    assert not is_odd(data, chi2_of(skeleton, found, data)).any()
