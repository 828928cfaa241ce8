"""Found trees against true ones: what is no mistake, what is one, and how large the errors are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from station.errors import InvalidData
from station.fit.learner import learn
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, JointLog, PoseLog
from station.tree_scores import JointScore, score_tree
from tests.benchmarks.made_joints import named, watch
from tests.benchmarks.made_trees import random_tree, true_tree

# Rounding of a few products of poses about a metre away.
EXACT = 1e-9
KINDS = ("prismatic", "revolute", "screw", "spherical")
examples = settings(max_examples=25, deadline=None)  # a loaded machine is no failure


def joint(name: str, kind: str, parent: str, child: str, **changes: object) -> Joint:
    values: dict[str, object] = {
        "axis_parent": None if kind == "spherical" else np.array([0.6, 0.0, 0.8]),
        "point_parent_m": None if kind == "prismatic" else np.array([0.1, -0.2, 0.3]),
        "T_parent_child_zero": se3.exp([0.2, 0.1, -0.3, 0.5, -0.7, 0.4]),
        "pitch_m_per_rad": 0.02 if kind == "screw" else None,
    }
    return Joint(name, kind, parent, child, **(values | changes))  # type: ignore[arg-type]


def chain(kinds: tuple[str, ...] = ("prismatic", "revolute", "screw")) -> KinematicTree:
    """Bodies a, b, c...; each has a second tracker, a_1, b_1, c_1..."""
    names = tuple("abcdefg"[: len(kinds) + 1])
    joints = [joint(f"j{i}", kind, names[i], names[i + 1]) for i, kind in enumerate(kinds)]
    trackers = tuple(f"{name}_1" for name in names)
    groups = tuple(zip(names, trackers, strict=True))
    return KinematicTree("a", (*names, *trackers), groups, (names,), tuple(joints))


def mounts(tree: KinematicTree) -> dict[str, FloatArray]:
    """Pose of each part in its body's named part."""
    rng = np.random.default_rng(5)
    return {part: np.eye(4) if part in tree.bodies else se3.exp(rng.normal(size=6)) for part in tree.parts}


def poses(tree: KinematicTree, q: FloatArray) -> PoseLog:
    """True poses of all parts at states (T, C)."""
    bodies, mount = tree.forward(q), mounts(tree)
    T = np.stack([bodies[tree.body_of(part)] @ mount[part] for part in tree.parts], axis=1)
    return PoseLog(np.arange(len(T)) / 30, "world", tree.parts, T)


def named_by_tracker(tree: KinematicTree, names: tuple[str, ...]) -> KinematicTree:
    """The tree whose bodies are named by these trackers, every joint told between them."""
    mount = mounts(tree)
    new = {tree.body_of(name): name for name in names}

    def told(old: Joint) -> Joint:
        parent, child = (new.get(end, end) for end in (old.parent, old.child))
        T_new_old = np.linalg.inv(mount[parent])
        axis, point = old.axis_parent, old.point_parent_m
        return replace(
            old,
            parent=parent,
            child=child,
            axis_parent=None if axis is None else T_new_old[:3, :3] @ axis,
            point_parent_m=None if point is None else (T_new_old @ [*point, 1.0])[:3],
            T_parent_child_zero=T_new_old @ old.T_parent_child_zero @ mount[child],
        )

    trees = tuple(tuple(new.get(name, name) for name in bodies) for bodies in tree.trees)
    return replace(tree, root=new.get(tree.root, tree.root), trees=trees, joints=tuple(told(j) for j in tree.joints))


def states(tree: KinematicTree, frames: int = 20) -> FloatArray:
    return np.random.default_rng(3).uniform(-1, 1, (frames, len(tree.columns)))


def log_of(tree: KinematicTree, q: ArrayLike) -> JointLog:
    columns = np.asarray(q)
    return JointLog(np.arange(len(columns)) / 30, tree.columns, columns, tuple(tree.units.values()))


def only(found: KinematicTree, true: KinematicTree, truth: PoseLog | None = None) -> JointScore:
    """The score of a tree's single joint."""
    (score,) = score_tree(found, true, truth).joints
    return score


@examples
@given(
    st.lists(st.sampled_from(KINDS), min_size=1, max_size=4).map(tuple),
    st.data(),
)
def test_another_root_and_other_naming_trackers_are_no_mistake(kinds: tuple[str, ...], data: st.DataObject) -> None:
    true = chain(kinds)
    q = states(true)
    root = data.draw(st.sampled_from(true.bodies))
    renamed = data.draw(st.sets(st.sampled_from(true.bodies)))
    found_q = true.rerooted_states(root, q)
    found = named_by_tracker(true.rerooted(root), tuple(f"{name}_1" for name in renamed))
    scores = score_tree(found, true, poses(true, q), found_states=log_of(found, found_q), true_states=log_of(true, q))
    assert scores.groups_correct and scores.structure_correct and scores.types_correct
    assert scores.mistakes == ()
    for score, of in zip(scores.joints, true.joints, strict=True):
        assert (score.joint, score.true_type, score.found_type, score.found_joint) == (
            of.name,
            of.type,
            of.type,
            of.name,
        )
        assert score.axis_error_rad == (None if of.axis_parent is None else pytest.approx(0.0, abs=EXACT))
        assert score.point_error_m == (None if of.point_parent_m is None else pytest.approx(0.0, abs=EXACT))
        assert score.state_rms == (None if of.type == "spherical" else pytest.approx(0.0, abs=EXACT))


@pytest.mark.parametrize("turned_round", [False, True])
@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 0.3, 1.5])
def test_the_axis_error_is_the_angle_between_the_lines(angle_rad: float, turned_round: bool) -> None:
    true = chain(("revolute",))
    axis = Rotation.from_rotvec([0.0, angle_rad, 0.0]).apply([0.6, 0.0, 0.8])
    found = replace(true, joints=(replace(true.joints[0], axis_parent=-axis if turned_round else axis),))
    # The cross product of nearly parallel unit vectors is good to 1e-16.
    assert only(found, true).axis_error_rad == pytest.approx(angle_rad, rel=1e-6, abs=1e-15)


def test_the_error_of_an_axis_told_in_another_tracker_s_frame_is_the_angle_in_space() -> None:
    true = chain(("revolute", "prismatic"))
    truth = poses(true, states(true))
    tilt = Rotation.from_rotvec([0.0, 0.2, 0.0]).apply([0.6, 0.0, 0.8])
    wrong = replace(true, joints=tuple(replace(old, axis_parent=tilt) for old in true.joints))
    found = named_by_tracker(wrong.rerooted("b"), ("a_1", "b_1", "c_1"))
    for score in score_tree(found, true, truth).joints:
        assert score.axis_error_rad == pytest.approx(0.2, abs=EXACT)


def test_the_point_may_lie_anywhere_along_the_axis_and_errs_by_its_distance_from_it() -> None:
    true = chain(("revolute",))
    (old,) = true.joints
    assert old.axis_parent is not None and old.point_parent_m is not None
    off = np.cross(old.axis_parent, [0.0, 1.0, 0.0])  # a unit vector at right angles to the axis
    for along_m, off_m in ((0.7, 0.0), (-0.4, 0.05)):
        moved = replace(old, point_parent_m=old.point_parent_m + along_m * old.axis_parent + off_m * off)
        assert only(replace(true, joints=(moved,)), true).point_error_m == pytest.approx(off_m, abs=EXACT)


def test_the_centre_of_a_ball_errs_in_all_directions() -> None:
    true = chain(("spherical",))
    (old,) = true.joints
    moved = replace(old, point_parent_m=old.point_parent_m + np.array([0.03, 0.0, 0.04]))
    score = only(replace(true, joints=(moved,)), true)
    assert score.point_error_m == pytest.approx(0.05, abs=EXACT)
    assert score.axis_error_rad is None


def test_without_true_poses_a_joint_told_from_another_tracker_has_no_errors() -> None:
    true = chain(("revolute", "prismatic"))
    found = named_by_tracker(true, ("a_1",))
    first, second = score_tree(found, true).joints
    assert (first.found_type, first.axis_error_rad, first.point_error_m) == ("revolute", None, None)
    assert second.axis_error_rad == pytest.approx(0.0, abs=EXACT)


def test_states_are_compared_without_their_zero_by_the_axes_directions_and_where_they_were_found() -> None:
    true = chain(("revolute", "prismatic"))
    q = states(true, 50)
    wave = 0.01 * np.array([1.0, -1.0] * 25)
    turned = replace(true, joints=(true.joints[0].with_sign(-1), true.joints[1]))
    found_q = np.stack([-q[:, 0] + 3.0 + wave, q[:, 1] - 0.4], axis=-1)
    found_q[10:20, 0] = np.nan
    found_q[30:, 0] += 2 * np.pi  # a whole turn, which means nothing
    scores = score_tree(turned, true, found_states=log_of(turned, found_q), true_states=log_of(true, q))
    assert [score.state_rms for score in scores.joints] == [pytest.approx(0.01), pytest.approx(0.0, abs=EXACT)]


def test_states_that_were_never_found_have_no_error() -> None:
    true = chain(("revolute",))
    q = states(true)
    scores = score_tree(true, true, found_states=log_of(true, np.nan * q), true_states=log_of(true, q))
    assert scores.joints[0].state_rms is None


def test_a_joint_of_another_type_is_a_mistake_of_types_alone() -> None:
    true = chain(("prismatic", "revolute"))
    found = replace(true, joints=(joint("a__b", "revolute", "a", "b"), true.joints[1]))
    scores = score_tree(found, true)
    assert (scores.groups_correct, scores.structure_correct, scores.types_correct) == (True, True, False)
    assert scores.joints[0] == JointScore("j0", "prismatic", "revolute", "a__b")
    assert scores.joints[1].axis_error_rad == pytest.approx(0.0, abs=EXACT)
    assert scores.mistakes == ("j0 is prismatic, called revolute",)


def test_a_joint_between_other_bodies_is_a_mistake_of_structure() -> None:
    true = chain(("prismatic", "revolute"))
    found = replace(true, joints=(true.joints[0], joint("a__c", "revolute", "a", "c")))
    scores = score_tree(found, true)
    assert (scores.groups_correct, scores.structure_correct, scores.types_correct) == (True, False, False)
    assert scores.joints[1] == JointScore("j1", "revolute", None)
    assert scores.mistakes == ("joints a+a_1 to c+c_1 instead of b+b_1 to c+c_1",)


def test_a_missing_joint_is_a_mistake_of_structure() -> None:
    true = chain(("prismatic", "revolute"))
    found = replace(true, trees=(("a", "b"), ("c",)), joints=true.joints[:1])
    scores = score_tree(found, true)
    assert scores.groups_correct and not scores.structure_correct
    assert [score.found_type for score in scores.joints] == ["prismatic", None]
    assert scores.mistakes == ("joints none instead of b+b_1 to c+c_1",)


def test_two_bodies_taken_for_one_are_called_rigid() -> None:
    true = chain(("prismatic", "revolute"))
    groups = (("a", "a_1", "b", "b_1"), ("c", "c_1"))
    found = replace(true, rigid_groups=groups, trees=(("a", "c"),), joints=(joint("a__c", "revolute", "a", "c"),))
    scores = score_tree(found, true)
    assert not scores.groups_correct and not scores.structure_correct and not scores.types_correct
    # The second joint hangs from a body mixed of two true ones: it stands for neither.
    assert [score.found_type for score in scores.joints] == ["rigid", None]
    assert scores.mistakes == ("2 bodies instead of 3: a+a_1+b+b_1",)


def test_a_joint_between_pieces_of_its_bodies_keeps_its_type_and_errors() -> None:
    true = chain(("revolute",))
    apart = replace(
        true,
        rigid_groups=(("a", "a_1"),),
        trees=(("a", "b", "b_1"),),
        joints=(*true.joints, joint("b__b_1", "revolute", "b", "b_1")),
    )
    scores = score_tree(apart, true)
    assert not scores.groups_correct
    assert scores.joints[0].found_type == "revolute"
    assert scores.joints[0].axis_error_rad == pytest.approx(0.0, abs=EXACT)
    assert scores.mistakes == ("3 bodies instead of 2: b, b_1",)


def test_two_joints_between_pieces_of_the_same_two_bodies_tell_no_type() -> None:
    true = chain(("revolute",))
    twice = replace(
        true,
        rigid_groups=(("a", "a_1"),),
        trees=(("a", "b", "b_1"),),
        joints=(*true.joints, joint("a__b_1", "revolute", "a", "b_1")),
    )
    assert only(twice, true) == JointScore("j0", "revolute", None)


def test_a_joint_from_a_body_that_is_mixed_from_both_tells_no_type() -> None:
    true = chain(("revolute",))
    mixed = replace(true, rigid_groups=(("a", "a_1", "b_1"),))
    assert only(mixed, true) == JointScore("j0", "revolute", None)


def test_a_rigid_joint_makes_one_body_as_a_rigid_group_does() -> None:
    true = chain(("revolute",))
    held = joint("hold", "rigid", "b", "b_1", axis_parent=None, point_parent_m=None)
    joints = replace(true, rigid_groups=(("a", "a_1"),), trees=(("a", "b", "b_1"),), joints=(*true.joints, held))
    for found, of in ((joints, true), (true, joints)):
        scores = score_tree(found, of)
        assert scores.types_correct
        assert [score.joint for score in scores.joints] == ["j0"]


def test_trees_of_different_parts_are_refused() -> None:
    true = chain(("revolute",))
    other = replace(true, parts=(*true.parts, "world"), trees=(*true.trees, ("world",)))
    with pytest.raises(InvalidData, match="world only in the found one, none only in the true one"):
        score_tree(other, true)


def test_states_at_different_times_are_refused() -> None:
    true = chain(("revolute",))
    q = states(true)
    with pytest.raises(InvalidData, match="19 found, 20 true"):
        score_tree(true, true, found_states=log_of(true, q[1:]), true_states=log_of(true, q))


@pytest.mark.parametrize("root_moves", [False, True])
def test_a_fit_of_many_trackers_errs_as_little_as_their_noise(root_moves: bool) -> None:
    """The truth is made apart from the station: it knows bodies, and trackers mounted anyhow on them."""
    made = random_tree(
        np.random.default_rng(4),
        bodies=4,
        frames=60,
        kinds=("prismatic", "revolute"),
        root_moves=root_moves,
        walk=False,
        trackers=(2, 2),
    )
    watched = named(watch(np.random.default_rng(5), made.T_ref_part, 1e-6, 1e-6), made.parts)
    truth = replace(watched.log, T_ref_part=made.T_ref_part)
    true = true_tree(made)
    q = JointLog(truth.t_s, true.columns, np.concatenate(made.q, axis=-1), tuple(true.units.values()))
    fit = learn(watched.log)
    scores = score_tree(fit.tree, true, truth, found_states=fit.states, true_states=q)
    assert scores.types_correct
    assert fit.tree.bodies != true.bodies  # or mounts would not be needed
    for score in scores.joints:
        # A micrometre and a microradian on levers below half a metre, over travels of 5 cm and 15 deg at least.
        assert score.axis_error_rad is not None and score.axis_error_rad < 5e-5
        assert score.point_error_m is None or score.point_error_m < 5e-5
        assert score.state_rms is not None and score.state_rms < 5e-6
