"""Kinematic trees: forward kinematics, re-rooting, and what is no tree."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint, KinematicTree, connected_bodies

examples = settings(max_examples=25, deadline=None)  # a loaded machine is no failure
seeds = st.integers(0, 2**32 - 1)


def random_joint(rng: np.random.Generator, parent: str, child: str, kind: str) -> Joint:
    axis = rng.normal(size=3)
    return Joint(
        name=f"{parent}__{child}",
        type=kind,
        parent=parent,
        child=child,
        axis_parent=axis / np.linalg.norm(axis) if JOINT_TYPES[kind].has_axis else None,
        point_parent_m=rng.normal(size=3) if JOINT_TYPES[kind].has_point else None,
        T_parent_child_zero=se3.exp(rng.normal(size=6)),
        pitch_m_per_rad=0.1 * rng.normal() if JOINT_TYPES[kind].form_freedoms else None,
        state_min=-0.4 if JOINT_TYPES[kind].states else None,
        state_max=1.0 if JOINT_TYPES[kind].states else None,
    )


def random_tree(seed: int, size: int = 6) -> KinematicTree:
    """A tree of `size` bodies p0, p1... with a joint of random type from each to an earlier one, in random order."""
    rng = np.random.default_rng(seed)
    names = tuple(f"p{i}" for i in range(size))
    ends = [(names[rng.integers(i)], names[i]) for i in range(1, size)]
    joints = [random_joint(rng, *pair, str(rng.choice(list(JOINT_TYPES)))) for pair in ends]
    rng.shuffle(joints)
    return KinematicTree("p0", names, (), (names,), tuple(joints))


def states(tree: KinematicTree, seed: int, *batch: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {joint.name: rng.uniform(-3, 3, (*batch, *joint.kind.state_shape)) for joint in tree.movable}


def columns_of(tree: KinematicTree, q: dict[str, np.ndarray], *batch: int) -> np.ndarray:
    """(*batch, C) states as an array."""
    return np.concatenate([q[joint.name].reshape(*batch, joint.kind.states) for joint in tree.movable], axis=-1)


def hinge(name: str = "hinge", parent: str = "base", child: str = "lid", **changes: object) -> Joint:
    values: dict[str, object] = {
        "name": name,
        "type": "revolute",
        "parent": parent,
        "child": child,
        "axis_parent": (0, 0, 1),
        "point_parent_m": (1, 0, 0),
        "T_parent_child_zero": se3.translation([3.0, 0, 0.5]),
    }
    return Joint(**(values | changes))  # type: ignore[arg-type]


def ball(name: str = "ball", parent: str = "base", child: str = "lid") -> Joint:
    zero = se3.pose(se3.exp_so3([0.1, 0.2, 0.3]), [3, 0, 0.5])
    return hinge(name, parent, child, type="spherical", axis_parent=None, T_parent_child_zero=zero)


def small_tree(**changes: object) -> KinematicTree:
    values: dict[str, object] = {
        "root": "base",
        "parts": ("base", "base_b", "lid", "knob"),
        "rigid_groups": (("base", "base_b"),),
        "trees": (("base", "lid"), ("knob",)),
        "joints": (hinge(),),
    }
    return KinematicTree(**(values | changes))  # type: ignore[arg-type]


def test_a_hinge_turns_its_child_about_the_point():
    """A quarter turn about z through (1, 0): the child at (3, 0) goes to (1, 2)."""
    T = small_tree().forward({"hinge": np.pi / 2})["lid"]
    np.testing.assert_allclose(T, se3.pose(se3.exp_so3([0, 0, np.pi / 2]), [1, 2, 0.5]), atol=1e-15)


def test_the_state_is_the_motion_before_the_zero_pose():
    """T_parent_child(q) = motion(q) @ zero, with motion a turn about the axis through the point."""
    rng = np.random.default_rng(4)
    joint = random_joint(rng, "base", "lid", "revolute")
    turn = se3.pose(se3.exp_so3(0.7 * joint.axis_parent), np.zeros(3))
    motion = se3.translation(joint.point_parent_m) @ turn @ se3.translation(-joint.point_parent_m)
    np.testing.assert_allclose(joint.forward(0.7), motion @ joint.T_parent_child_zero, atol=1e-14)


@given(seeds)
@examples
def test_forward_is_the_product_of_the_joints_on_the_way(seed: int):
    tree = random_tree(seed)
    q = states(tree, seed)
    poses = tree.forward(q)
    assert set(poses) == set(tree.parts)
    for joint in tree.joints:
        relative = se3.inverse(poses[joint.parent]) @ poses[joint.child]
        np.testing.assert_allclose(relative, joint.forward(q.get(joint.name, np.zeros(()))), atol=1e-12)


def test_forward_takes_batches_and_columns_alike():
    tree = random_tree(10)
    assert {joint.type for joint in tree.joints} == {"rigid", "prismatic", "revolute", "screw", "spherical"}
    q = states(tree, 6, 4, 3)
    columns = columns_of(tree, q, 4, 3)
    by_name, by_column = tree.forward(q), tree.forward(columns)
    one = tree.forward(columns[2, 1])
    for part in tree.parts:
        assert by_name[part].shape == (4, 3, 4, 4)
        np.testing.assert_array_equal(by_name[part], by_column[part])
        np.testing.assert_allclose(by_name[part][2, 1], one[part], atol=1e-14)


def test_states_are_broadcast_against_each_other():
    tree = KinematicTree("a", ("a", "b", "c"), (), (("a", "b", "c"),), (hinge("ab", "a", "b"), hinge("bc", "b", "c")))
    poses = tree.forward({"ab": np.zeros((5, 1)), "bc": np.linspace(0, 1, 3)})
    assert {T.shape for T in poses.values()} == {(5, 3, 4, 4)}


def test_an_unseen_state_hides_what_hangs_from_it():
    tree = KinematicTree("a", ("a", "b", "c"), (), (("a", "b", "c"),), (hinge("ab", "a", "b"), hinge("bc", "b", "c")))
    poses = tree.forward({"ab": [0.0, 0.0, np.nan], "bc": [0.0, np.nan, 0.0]})
    seen = {part: np.isfinite(T).all(axis=(-2, -1)).tolist() for part, T in poses.items()}
    assert seen == {"a": [True] * 3, "b": [True, True, False], "c": [True, False, False]}


def test_a_forest_is_told_tree_by_tree():
    tree = small_tree(
        parts=("base", "lid", "box", "drawer"),
        rigid_groups=(),
        trees=(("base", "lid"), ("drawer", "box")),
        joints=(hinge(), hinge("slide", "box", "drawer", type="prismatic", point_parent_m=None)),
    )
    assert tree.tree_roots == ("base", "box")
    assert set(tree.forward({"hinge": 0.0})) == {"base", "lid"}
    other = tree.forward([0.0, 0.2], start="box")
    np.testing.assert_allclose(other["drawer"][:3, 3], [3.0, 0, 0.7])


def test_a_tree_without_movable_joints_keeps_the_batch():
    tree = small_tree(joints=(hinge(type="rigid", axis_parent=None, point_parent_m=None),))
    assert tree.movable == ()
    assert tree.forward(np.zeros((7, 0)))["lid"].shape == (7, 4, 4)
    assert tree.forward({})["lid"].shape == (4, 4)


@given(seeds, st.integers(0, 5))
@examples
def test_rerooting_keeps_every_relative_pose(seed: int, new_root: int):
    tree = random_tree(seed)
    turned = tree.rerooted(f"p{new_root}")
    assert turned.root == f"p{new_root}"
    q = columns_of(tree, states(tree, seed, 2), 2) if tree.movable else np.zeros((2, 0))
    before, after = tree.forward(q), turned.forward(tree.rerooted_states(f"p{new_root}", q))
    for a in tree.parts:
        for b in tree.parts:
            expected = se3.inverse(before[a]) @ before[b]
            np.testing.assert_allclose(se3.inverse(after[a]) @ after[b], expected, atol=1e-9)


def test_states_of_joints_with_an_axis_stay_when_a_tree_is_rerooted():
    tree = KinematicTree("a", ("a", "b", "c"), (), (("a", "b", "c"),), (hinge("ab", "a", "b"), ball("bc", "b", "c")))
    q = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(tree.rerooted_states("b", q), q)
    moved = tree.rerooted_states("c", q)
    assert moved[0] == q[0]
    np.testing.assert_allclose(moved[1:], -Rotation.from_rotvec([0.1, 0.2, 0.3]).inv().apply(q[1:]), atol=1e-15)
    np.testing.assert_allclose(tree.rerooted("c").rerooted_states("a", moved), q, atol=1e-15)


@given(seeds)
@examples
def test_a_reversed_screw_has_the_same_hand_and_the_same_states(seed: int):
    joint = random_joint(np.random.default_rng(seed), "base", "lid", "screw")
    turned = joint.reversed()
    assert turned.pitch_m_per_rad == joint.pitch_m_per_rad
    q = np.array([-9.0, 0.4, 7.0])
    np.testing.assert_allclose(turned.forward(q), se3.inverse(joint.forward(q)), atol=1e-12)
    np.testing.assert_allclose(joint.with_sign(-1).forward(-q), joint.forward(q), atol=1e-12)


def test_a_ball_turns_its_child_about_the_centre_by_the_rotation_vector():
    q = np.array([0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(
        ball().forward(q), se3.pose(se3.exp_so3(q) @ se3.exp_so3([0.1, 0.2, 0.3]), [1, 2, 0.5]), atol=1e-15
    )
    assert ball().with_sign(-1).forward(q) == pytest.approx(ball().forward(q))  # a ball has no sign


def test_columns_name_each_state_with_its_unit():
    weld = hinge("weld", "b", "c", type="rigid", axis_parent=None, point_parent_m=None)
    slide = hinge("slide", "c", "d", type="prismatic", point_parent_m=None)
    bodies = tuple("abcd")
    tree = KinematicTree("a", bodies, (), (bodies,), (ball("ab", "a", "b"), weld, slide))
    assert tree.columns == ("ab_x", "ab_y", "ab_z", "slide")
    assert tree.units == {"ab_x": "rad", "ab_y": "rad", "ab_z": "rad", "slide": "m"}
    with pytest.raises(InvalidData, match="state of a joint named twice: ab_x"):
        KinematicTree("a", tuple("abc"), (), (tuple("abc"),), (ball("ab", "a", "b"), hinge("ab_x", "b", "c")))


@given(seeds)
@examples
def test_a_reversed_joint_is_the_motion_of_its_own_axis_and_zero(seed: int):
    joint = random_joint(np.random.default_rng(seed), "base", "lid", "revolute")
    turned = joint.reversed()
    assert (turned.parent, turned.child) == ("lid", "base")
    turn = se3.pose(se3.exp_so3(0.7 * turned.axis_parent), np.zeros(3))
    motion = se3.translation(turned.point_parent_m) @ turn @ se3.translation(-turned.point_parent_m)
    expected = se3.inverse(joint.forward(0.7))
    np.testing.assert_allclose(motion @ turned.T_parent_child_zero, expected, atol=1e-12)


@given(seeds)
@examples
def test_a_reversed_joint_has_the_point_nearest_its_child(seed: int):
    """No other point of the axis is nearer to the child at the middle of the observed range."""
    turned = random_joint(np.random.default_rng(seed), "base", "lid", "revolute").reversed()
    p_child = turned.forward(0.3)[:3, 3]
    away = p_child - turned.point_parent_m
    assert away @ turned.axis_parent == pytest.approx(0, abs=1e-12)


@given(seeds)
@examples
def test_reversing_twice_gives_the_geometry_back(seed: int):
    joint = random_joint(np.random.default_rng(seed), "base", "lid", "prismatic")
    twice = joint.reversed().reversed()
    np.testing.assert_allclose(twice.axis_parent, joint.axis_parent, atol=1e-14)
    np.testing.assert_allclose(twice.T_parent_child_zero, joint.T_parent_child_zero, atol=1e-14)


def test_reversing_drops_the_deviations_that_held_in_the_old_parent():
    turned = hinge(axis_std_rad=0.1, point_std_m=0.2, rms_translation_m=0.3, rms_rotation_rad=0.4, frames=9).reversed()
    assert (turned.axis_std_rad, turned.point_std_m, turned.rms_translation_m) == (None, None, None)
    assert (turned.rms_rotation_rad, turned.frames) == (0.4, 9)


def test_rerooting_leaves_the_callers_tree_and_other_trees_alone():
    tree = small_tree()
    turned = tree.rerooted("lid")
    assert (tree.root, tree.joint("hinge").parent) == ("base", "base")
    assert turned.tree_roots == ("lid", "knob")
    assert tree.rerooted("knob").joint("hinge") is tree.joint("hinge")


def test_a_part_knows_its_body():
    tree = small_tree()
    assert [tree.body_of(part) for part in tree.parts] == ["base", "base", "lid", "knob"]


def test_bodies_are_connected_through_others():
    joints = [hinge("x", "a", "b"), hinge("y", "d", "c"), hinge("z", "b", "d")]
    assert connected_bodies(["a", "b", "c", "d", "e"], joints) == (("a", "b", "c", "d"), ("e",))
    assert connected_bodies(["e", "c", "d"], joints) == (("e",), ("c", "d"))


def test_a_tree_is_frozen_and_travels_to_other_processes():
    scores = {"criterion": "evidence", "rigid": 1.0}
    joint = hinge(scores=scores)
    scores["rigid"] = 2.0
    assert joint.scores == {"criterion": "evidence", "rigid": 1.0}
    with pytest.raises(ValueError, match="read-only"):
        joint.axis_parent[0] = 1.0
    copy = pickle.loads(pickle.dumps(small_tree(joints=(joint,))))
    np.testing.assert_array_equal(copy.forward([0.3])["lid"], small_tree().forward([0.3])["lid"])


@pytest.mark.parametrize(
    ("changes", "message"),
    (
        ({"name": "Hinge"}, "joint 'Hinge' is no name"),
        ({"parent": "the base"}, "part 'the base' is no name"),
        ({"child": "base"}, "'base' at both ends"),
        ({"type": "helical"}, "type 'helical'; want one of rigid, prismatic, revolute"),
        ({"axis_parent": None}, "axis_parent is missing; the type needs it"),
        ({"axis_parent": (0, 0, 1 + 2e-6)}, "want a unit vector"),
        ({"axis_parent": (0, 1)}, "want three finite numbers"),
        ({"point_parent_m": (0, np.nan, 1)}, "want three finite numbers"),
        ({"type": "prismatic"}, "point_parent_m is given; the type has none"),
        ({"type": "rigid", "point_parent_m": None}, "axis_parent is given; the type has none"),
        ({"pitch_m_per_rad": 0.1}, "pitch_m_per_rad is given"),
        ({"type": "screw"}, "pitch_m_per_rad is missing; the type needs it"),
        ({"type": "screw", "pitch_m_per_rad": np.inf}, "pitch_m_per_rad is inf"),
        ({"type": "spherical"}, "axis_parent is given; the type has none"),
        ({"T_parent_child_zero": np.eye(3)}, "no rigid motion"),
        ({"T_parent_child_zero": 1.001 * np.eye(4)}, "no rigid motion"),
        ({"T_parent_child_zero": np.diag([1, 1, -1, 1])}, "no rigid motion"),
        ({"T_parent_child_zero": np.full((4, 4), np.nan)}, "no rigid motion"),
        ({"state_min": 1.0, "state_max": 0.0}, "state from 1.0 to 0.0"),
        ({"limits": (0.0, np.inf)}, "limits from 0.0 to inf"),
        ({"type": "rigid", "axis_parent": None, "point_parent_m": None, "limits": (0, 1)}, "has no state"),
    ),
)
def test_what_is_no_joint_is_refused(changes: dict, message: str):
    with pytest.raises(InvalidData, match=message):
        hinge(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    (
        ({"parts": ("base", "base_b", "lid", "knob", "lid")}, "part named twice: lid"),
        ({"rigid_groups": (("base", "base_c"),)}, "unknown part 'base_c'"),
        ({"rigid_groups": (("base", "base_b"), ("base_b", "knob"))}, "named twice: base_b"),
        ({"rigid_groups": (("base", "base_b"), ("knob",))}, "rigid group of 1"),
        ({"rigid_groups": ()}, "trees hold none of the body base_b"),
        ({"trees": (("base", "lid"), ("knob",), ("base_b",))}, r"trees hold 2 parts \(base, base_b\)"),
        ({"trees": (("base", "lid"),)}, "none of the body knob"),
        ({"trees": (("base", "lid"), ("knob", "lid"))}, "named twice: lid"),
        ({"trees": (("base", "lid"), ("knob", "door"))}, "unknown part 'door'"),
        ({"trees": (("base", "lid", "knob"),)}, "has 2 roots"),
        ({"joints": ()}, "has 2 roots"),
        ({"joints": (hinge(), hinge("more", "base", "knob"))}, "of different trees"),
        ({"joints": (hinge(), hinge())}, "joint named twice: hinge"),
        ({"joints": (hinge(parent="base_b"),)}, "at 'base_b', which is no body"),
        ({"joints": (hinge(), hinge("again"))}, "'lid' has two parents"),
        ({"joints": (hinge(), hinge("back", "lid", "base"))}, "a loop"),
        ({"root": "lid"}, "root 'lid' is no root; have base, knob"),
        ({"root": "base_b"}, "root 'base_b' is no root"),
    ),
)
def test_what_is_no_tree_is_refused(changes: dict, message: str):
    with pytest.raises(InvalidData, match=message):
        small_tree(**changes)


def test_a_loop_beside_a_tree_is_refused():
    joints = (hinge(), hinge("there", "c", "d"), hinge("back", "d", "c"))
    with pytest.raises(InvalidData, match="no joint connects c, d to base: they hang in a loop, c > d > c; want"):
        KinematicTree("base", ("base", "lid", "c", "d"), (), (("base", "lid", "c", "d"),), joints)


def test_states_that_fit_no_joint_are_refused():
    tree = small_tree()
    with pytest.raises(InvalidData, match="no joint 'door'; have hinge"):
        tree.forward({"hinge": 0.0, "door": 0.0})
    with pytest.raises(InvalidData, match="no state of hinge"):
        tree.forward({})
    with pytest.raises(InvalidData, match=r"shape \(2,\); want \(..., 1\): hinge"):
        tree.forward([0.0, 0.0])
    with pytest.raises(InvalidData, match=r"states of 'ball' have shape \(2,\); want \(..., 3\): a rotation vector"):
        small_tree(joints=(ball(),)).forward({"ball": [0.0, 0.0]})
    with pytest.raises(InvalidData, match="no body 'base_b'"):
        tree.forward([0.0], start="base_b")


def test_names_that_are_not_there_are_refused_with_those_that_are():
    tree = small_tree()
    with pytest.raises(InvalidData, match="no joint 'door'; have hinge"):
        tree.joint("door")
    with pytest.raises(InvalidData, match="no part 'door'"):
        tree.body_of("door")
    with pytest.raises(InvalidData, match=r"'base_b' is no body \(its body is 'base'\)"):
        tree.rerooted("base_b")


def test_a_tree_file_may_say_more_of_a_joint():
    joint = replace(hinge(), limits=[-1, 1], probability={"revolute": 1.0})
    assert joint.limits == (-1, 1)


def test_a_joint_turned_round_moves_the_same_for_the_opposite_state():
    joint = Joint(
        name="pan",
        type="revolute",
        parent="base",
        child="link",
        axis_parent=np.array([0.0, 0.6, 0.8]),
        point_parent_m=np.array([0.1, 0.2, 0.3]),
        T_parent_child_zero=se3.exp(np.arange(6) / 10),
        state_min=-0.5,
        state_max=1.0,
    )
    turned = joint.with_sign(-1)
    np.testing.assert_allclose(turned.forward(-0.7), joint.forward(0.7), atol=1e-12)
    assert (turned.state_min, turned.state_max) == (-1.0, 0.5)
    assert joint.with_sign(1) is joint
