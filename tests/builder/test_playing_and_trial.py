"""Algorithm 2 frame by frame, and simulate-and-fit with its scores in words, rows and lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.builder.draft import Draft, blank, limits_of
from station.builder.edits import add_part, moved_joint, set_limits, set_type
from station.builder.placing import set_axis
from station.builder.playing import TrialSettings, start_play
from station.builder.trial import HEADER, run_trial
from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.tree import Joint
from tests.drawn_objects import drawer_cabinet, swivel_chair

QUIET = TrialSettings(frames=40, noise_translation_m=1e-4, noise_rotation_rad=1e-3)


def door() -> Draft:
    draft = add_part(add_part(blank("door", "frame"), "door"), "knob", "door")
    return set_axis(draft, "knob_joint", (0, 1, 0), (0.1, 0, 0.2))


def test_a_walk_keeps_to_limits_and_to_steps_of_a_tenth_of_them():
    play = start_play(swivel_chair(), TrialSettings())
    for _ in range(60):
        after = play.stepped()
        for joint in play.draft.tree.movable:
            low, high = limits_of(joint)
            step = after.states[joint.name] - play.states[joint.name]
            assert low <= after.states[joint.name] <= high and abs(step) <= 0.1 * (high - low) + 1e-12
        play = after
    assert play.frame == 60


def test_the_same_seed_plays_the_same_and_a_frame_is_a_value():
    def states(seed: int) -> list[dict[str, float]]:
        play = start_play(door(), TrialSettings(seed=seed))
        return [play.states, play.stepped().states, play.stepped().stepped().states]

    assert states(3) == states(3) != states(4)
    play = start_play(door(), TrialSettings())
    assert play.stepped().states == play.stepped().states


def test_what_a_tracker_sees_is_off_by_the_noise_and_by_nothing_without_it():
    settings = TrialSettings(noise_translation_m=0.01, noise_rotation_rad=0.0)
    play = start_play(door(), settings).stepped()
    for part, T in play.truth.items():
        off = np.linalg.norm(play.measured[part][:3, 3] - T[:3, 3])
        assert 0 < off <= np.sqrt(3) * 0.01
    quiet = play.with_settings(replace(settings, noise_translation_m=0.0))
    for part, T in quiet.truth.items():
        np.testing.assert_allclose(quiet.measured[part], T, atol=1e-12)
    assert quiet.states == play.states


def test_virtual_trackers_are_played_too_and_stay_rigid_on_their_parts():
    quiet = TrialSettings(inflation=2, noise_translation_m=0.0, noise_rotation_rad=0.0)
    play = start_play(door(), quiet)
    assert set(play.measured) == {f"{part}{ending}" for part in door().parts for ending in ("", "_v1", "_v2")}
    later = play.stepped().stepped()
    for part in door().parts:
        mounts = [se3.inverse(at.measured[part]) @ at.measured[f"{part}_v2"] for at in (play, later)]
        np.testing.assert_allclose(mounts[0], mounts[1], atol=1e-9)
        assert np.linalg.norm(mounts[0][:3, 3]) > 1e-3  # m: beside the part
        assert np.any(play.measured[part] != later.measured[part])


def test_a_static_root_stays_where_it_is_and_a_moving_one_does_not():
    still = start_play(door(), TrialSettings(root="static")).stepped().stepped()
    np.testing.assert_array_equal(still.truth["frame"], np.eye(4))
    assert np.any(start_play(door(), TrialSettings()).stepped().truth["frame"] != np.eye(4))


def test_a_quiet_trial_finds_the_drawn_tree_and_says_so():
    trial = run_trial(swivel_chair(), QUIET)
    assert trial.headline.startswith("Found: all bodies, 3 joints between the right ones")
    assert [row.right for row in trial.rows] == [True] * 3
    assert [row.true_type for row in trial.rows] == ["prismatic", "revolute", "revolute"]
    assert all(row.axis.split()[1] == "deg" and "std" in row.axis for row in trial.rows)
    assert trial.rows[0].states.endswith("mm") and trial.rows[1].states.endswith("deg")
    table = trial.markdown().splitlines()
    assert table[2] == f"| {' | '.join(HEADER)} |" and len(table) >= 7


def test_a_loud_trial_says_what_went_wrong():
    trial = run_trial(drawer_cabinet(), replace(QUIET, noise_translation_m=0.5, noise_rotation_rad=1.5))
    assert trial.headline.startswith("Not found: ") and not all(row.right for row in trial.rows)
    assert len(trial.headline.splitlines()) == 1


@pytest.mark.parametrize("inflation", [0, 1])
def test_found_axes_are_drawn_where_the_true_ones_are(inflation: int):
    draft = swivel_chair()
    trial = run_trial(draft, replace(QUIET, inflation=inflation))
    states = {"height": 0.05, "swivel": 0.4, "recline": 0.1}
    lines = [line for line in trial.found_lines(states) if line.what == "found axis"]
    assert len(lines) == 3
    poses = draft.poses(states)
    for joint in draft.joints:
        axis = poses[joint.parent][:3, :3] @ joint.axis_parent
        ends = [line.points_m[1] - line.points_m[0] for line in lines]
        sine = [np.linalg.norm(np.cross(axis, end)) / np.linalg.norm(end) for end in ends]
        best = lines[int(np.argmin(sine))]
        assert min(sine) < 0.02  # rad; the noise is of 1 mrad
        if joint.point_parent_m is not None:
            point = (poses[joint.parent] @ [*joint.point_parent_m, 1.0])[:3]
            on_axis = [line for line, s in zip(lines, sine, strict=True) if s < 0.02]
            off = min(np.linalg.norm(np.cross(axis, point - line.points_m[0])) for line in on_axis)
            assert off < 2e-3, best  # m


def test_an_axis_found_on_a_virtual_tracker_is_drawn_where_that_tracker_is():
    trial = run_trial(swivel_chair(), replace(QUIET, inflation=1))
    true, truth = trial.simulated.tree, trial.simulated.truth
    at = [truth.T_ref_part[0, truth.parts.index(part)] for part in ("column", "column_v1")]
    T_tracker_column = se3.inverse(at[1]) @ at[0]

    def told(joint: Joint) -> Joint:
        """The true joint as a fit would tell it that names the column by its virtual tracker."""
        if joint.parent == "column":
            return replace(moved_joint(joint, T_tracker_column), parent="column_v1")
        if joint.child == "column":
            zero = joint.T_parent_child_zero @ se3.inverse(T_tracker_column)
            return replace(joint, child="column_v1", T_parent_child_zero=zero)
        return joint

    names = tuple("column_v1" if name == "column" else name for name in true.trees[0])
    found = replace(true, trees=(names,), joints=tuple(map(told, true.joints)))
    states = {"height": 0.05, "swivel": 0.4, "recline": 0.1}
    as_drawn = replace(trial, fit=replace(trial.fit, tree=true)).found_lines(states)
    as_found = replace(trial, fit=replace(trial.fit, tree=found)).found_lines(states)
    assert len(as_found) == len(as_drawn) == 2 * len(true.joints)
    for joint, line, want in zip(true.joints, as_found[::2], as_drawn[::2], strict=True):
        axis = want.points_m[1] - want.points_m[0]
        np.testing.assert_allclose(line.points_m[1] - line.points_m[0], axis, atol=1e-9)
        if joint.point_parent_m is not None:  # an axis without a point may be drawn anywhere
            np.testing.assert_allclose(np.cross(axis, line.points_m - want.points_m[0]), 0.0, atol=1e-9)


def test_rigid_joints_and_balls_are_tried_as_well():
    draft = set_type(set_type(door(), "knob_joint", "spherical"), "door_joint", "rigid")
    trial = run_trial(draft, QUIET)
    assert [(row.true, row.found_type) for row in trial.rows] == [("knob_joint", "spherical")]
    states = dict.fromkeys(draft.tree.columns, 0.1)
    crosses = [line for line in trial.found_lines(states) if line.what == "found centre"]
    centre = draft.poses(states)["door"] @ [0.1, 0, 0.2, 1]
    assert len(crosses) == 3
    for cross in crosses:
        np.testing.assert_allclose(cross.points_m.mean(axis=0), centre[:3], atol=2e-3)


def test_limits_bound_what_is_simulated():
    draft = set_limits(door(), "door_joint", 0.2, 0.3)
    states = run_trial(draft, QUIET).simulated.states.state("door_joint")
    assert states.min() >= 0.2 and states.max() <= 0.3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"frames": 0}, "frames"),
        ({"noise_translation_m": -1.0}, "noise of translation"),
        ({"noise": "pink"}, "noise 'pink' is unknown; choose one of uniform"),
        ({"inflation": -1}, "inflation"),
        ({"motion": "dance"}, "motion 'dance' is unknown"),
        ({"seed": -1}, "seed"),
    ],
)
def test_settings_that_can_not_be_are_refused(change: dict[str, object], said: str):
    with pytest.raises(InvalidData, match=said):
        TrialSettings(**change)  # pyright: ignore[reportArgumentType]


def test_what_can_not_be_fitted_is_said():
    with pytest.raises(InvalidData, match="method 'magic' is unknown"):
        run_trial(door(), replace(QUIET, method="magic"))
    with pytest.raises(InvalidData, match="add a part first"):
        run_trial(blank(), QUIET)


def test_a_play_is_told_in_the_root_where_it_began():
    play = start_play(door(), TrialSettings())
    np.testing.assert_array_equal(play.truth["frame"], np.eye(4))
    want = play.draft.poses(play.states)
    for part, T in play.truth.items():
        np.testing.assert_allclose(T, want[part], atol=1e-12)
    moved = play.stepped()
    relative = se3.inverse(moved.truth["frame"]) @ moved.truth["knob"]
    np.testing.assert_allclose(relative, play.draft.poses(moved.states)["knob"], atol=1e-12)
