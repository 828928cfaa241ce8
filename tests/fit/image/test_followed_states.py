"""States of a known tree from one frame after another, against the truth of simulated corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.errors import InvalidData
from station.fit.image.live import SeenStates, StateFollower
from station.fit.image.views import Views
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from tests.benchmarks.made_joints import inverse
from tests.fit.image.seen_objects import Scene
from tests.fit.image.simulated_views import Seeing, Watched, watch, watched

FRAMES = 60
SCENE = Scene(joints=3, kinds=("revolute", "prismatic"), frames=FRAMES)
MIXED = Scene(joints=3, kinds=("revolute", "screw", "spherical"), frames=FRAMES)


def frames_of(views: Views, rows: np.ndarray | range) -> list[Views]:
    """Each of some frames by itself."""
    found = []
    for t in rows:
        own = np.flatnonzero(views.frame == t)
        found.append(
            replace(
                views,
                t_s=views.t_s[t : t + 1],
                frame=np.zeros(len(own), dtype=np.intp),
                marker=views.marker[own],
                corners_px=views.corners_px[own],
                covariance_px2=views.covariance_px2[own],
                T_ref_part=views.T_ref_part[own],
            )
        )
    return found


def followed(seen: Watched, rows: np.ndarray | range = range(FRAMES), *, still: bool | None = None) -> list[SeenStates]:
    still = not seen.seen.scene.root_moves if still is None else still
    follower = StateFollower(seen.tree, seen.views.parts, still=still)
    return [follower.follow(views) for views in frames_of(seen.views, rows)]


def errors(found: list[SeenStates], seen: Watched, rows: np.ndarray | range = range(FRAMES)) -> FloatArray:
    """(T, C) of the states, but for whole turns of a whole run."""
    off = np.stack([each.q for each in found]) - seen.states.q[np.array(rows)]
    turns = np.round(np.nanmedian(off, axis=0) / (2 * np.pi)) * (np.array(seen.states.units) == "rad")
    return off - 2 * np.pi * turns


def stds(found: list[SeenStates]) -> FloatArray:
    return np.stack([each.std for each in found])


@pytest.mark.parametrize("scene", [SCENE, MIXED])
@pytest.mark.parametrize("root_moves", [False, True])
def test_states_are_as_far_off_as_their_deviations_say(scene: Scene, root_moves: bool) -> None:
    off = []
    for seed in range(3):
        seen = watched(seed, replace(scene, root_moves=root_moves))
        found = followed(seen)
        assert np.mean([each.fits for each in found]) > 0.97
        off.append((errors(found, seen) / stds(found)).ravel())
    z = np.concatenate(off)
    assert np.isfinite(z).all()
    assert 0.90 < np.mean(np.abs(z) < 1.96) < 0.98
    assert np.abs(z).max() < 6.0


def test_a_root_that_stands_still_is_known_better_by_the_frames_before() -> None:
    seen = watched(5, SCENE)
    known, anew = (
        np.sqrt(np.mean(errors(followed(seen, still=still), seen)[20:] ** 2, axis=0)) for still in (True, False)
    )
    assert np.all(known < 1.05 * anew)
    assert known.min() < 0.8 * anew[np.argmin(known / anew)]


def without_part(views: Views, part: int, first: int, last: int) -> Views:
    kept = ~((views.part[views.marker] == part) & (views.frame >= first) & (views.frame < last))
    return replace(
        views,
        frame=views.frame[kept],
        marker=views.marker[kept],
        corners_px=views.corners_px[kept],
        covariance_px2=views.covariance_px2[kept],
        T_ref_part=views.T_ref_part[kept],
    )


def test_a_joint_whose_marker_is_not_seen_has_no_state_and_goes_on_by_the_same_turn_after() -> None:
    seen = watched(1, SCENE)
    joint = seen.tree.joints[0]
    part = seen.views.parts.index(joint.child)
    hidden = replace(seen, views=without_part(seen.views, part, 20, 35))
    found = followed(hidden)
    column = seen.tree.columns.index(joint.columns[0])
    told = np.array([np.isfinite(each.q[column]) for each in found])
    np.testing.assert_array_equal(~told, (np.arange(FRAMES) >= 20) & (np.arange(FRAMES) < 35))
    z = errors(found, hidden) / stds(found)
    assert np.nanmax(np.abs(z)) < 6.0


def test_after_a_gap_in_which_all_has_moved_the_states_are_right_at_once() -> None:
    for seed in range(3):
        seen = watched(seed, replace(SCENE, frames=200))
        rows = np.array([0, 1, 2, 97, 98, 190, 30])
        z = errors(followed(seen, rows[np.argsort(rows)]), seen, np.sort(rows)) / stds(followed(seen, np.sort(rows)))
        assert np.nanmax(np.abs(z)) < 6.0


def test_a_marker_that_is_somewhere_else_spoils_no_other_joint() -> None:
    seen = watched(2, SCENE, Seeing(outliers=0.06))
    found = followed(seen)
    z = errors(found, seen) / stds(found)
    assert np.nanmax(np.abs(z)) < 8.0
    gone = np.bincount(seen.views.frame[seen.outlier], minlength=FRAMES) > 0
    assert not np.any(np.array([each.fits for each in found])[gone])


def test_a_camera_that_was_pushed_is_found_out() -> None:
    seen = watched(3, SCENE)
    pushed = replace(seen.seen, T_cam_root=se3.exp(np.array([0.01, 0.0, 0.01, 0.0, 0.01, 0.03])) @ seen.seen.T_cam_root)
    later = watch(np.random.default_rng(9), pushed, seen.seeing)
    follower = StateFollower(seen.tree, seen.views.parts)
    half = FRAMES // 2
    before = [follower.follow(views) for views in frames_of(seen.views, range(half))]
    after = [follower.follow(views) for views in frames_of(later.views, range(half, FRAMES))]
    z = errors(before + after, seen) / stds(before + after)
    assert np.abs(z).max() < 6.0
    assert all(each.fits for each in after)


@pytest.mark.parametrize("stated", [0.4, 2.0])
def test_noise_other_than_was_stated_is_learned(stated: float) -> None:
    seen = watched(4, replace(SCENE, frames=150), Seeing(stated=stated))
    found = followed(seen, range(150))
    z = (errors(found, seen, range(150)) / stds(found))[75:]
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.2  # what frames before tell of the root is made less of


def test_a_rolling_shutter_does_little_harm() -> None:
    seen = watched(6, SCENE, Seeing(readout_s=0.025))
    blind = replace(seen, views=replace(seen.views, readout_s=0.0))
    rms = [np.sqrt(np.nanmean(errors(followed(each), each) ** 2, axis=0)) for each in (seen, blind)]
    assert np.all(rms[0] < 1.1 * rms[1])
    assert (rms[0] / rms[1]).min() < 0.5


def test_further_trackers_count_where_the_tree_tells_their_mounts() -> None:
    seen = watched(7, replace(SCENE, trackers=(2, 2)))
    tree = with_mounts(seen)
    assert tree.mounts
    known, lost = (StateFollower(each, seen.views.parts, still=True) for each in (tree, replace(tree, mounts={})))
    last = [[follower.follow(views) for views in frames_of(seen.views, range(FRAMES))] for follower in (known, lost)]
    z = errors(last[0], seen) / stds(last[0])
    assert np.abs(z).max() < 6.0
    assert np.all(np.median(stds(last[0]), axis=0) < np.median(stds(last[1]), axis=0))


def with_mounts(seen: Watched) -> KinematicTree:
    """The true tree with the true mounts of its further trackers."""
    tree, made = seen.tree, seen.made
    T_body = dict(zip(made.parts, seen.seen.T_body_part, strict=True))
    trackers = [part for part in tree.parts if part not in tree.bodies]
    return replace(tree, mounts={part: inverse(T_body[tree.body_of(part)]) @ T_body[part] for part in trackers})


def test_markers_on_nothing_of_the_tree_are_refused() -> None:
    tree = watched(0, SCENE).tree
    with pytest.raises(InvalidData, match=r"no marker is on a part of the tree; the tree has .*the markers are on lid"):
        StateFollower(tree, ("lid",))
