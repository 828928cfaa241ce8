"""Claims of what is simulated: virtual trackers, planar objects, wrong and missing poses, roots, motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.errors import InvalidData
from station.formats.trees import example_names, load_tree
from station.kinematics import se3
from station.kinematics.joint import Joint
from station.kinematics.tree import KinematicTree
from station.simulate import (
    MOTIONS,
    NOISE_MODELS,
    SimulationOptions,
    UniformNoise,
    check_movable,
    make_noise,
    place_objects,
    simulate,
    simulate_all,
    start_root,
    start_states,
    state_ranges,
    walk_root,
    walk_states,
)
from station.simulate.degrading import OUTLIER_M

SILENT = UniformNoise(0.0, 0.0)
ROUNDING = 1e-9  # metres and dimensionless, of chains of matrices at 10 m
EVERY_MOTION = pytest.mark.parametrize("motion", MOTIONS)
EVERY_TREE = pytest.mark.parametrize("name", example_names())


def relative(log, a: str, b: str) -> np.ndarray:
    """(T, 4, 4) pose of b in a."""
    T = log.T_ref_part
    return np.linalg.inv(T[:, log.parts.index(a)]) @ T[:, log.parts.index(b)]


def hinged(joint: Joint) -> KinematicTree:
    """A tree of one joint."""
    bodies = (joint.parent, joint.child)
    return KinematicTree(root=bodies[0], parts=bodies, rigid_groups=(), trees=(bodies,), joints=(joint,))


def door(**changes: object) -> Joint:
    joint = Joint(
        name="hinge",
        type="revolute",
        parent="frame",
        child="door",
        axis_parent=np.array([0.0, 0.0, 1.0]),
        point_parent_m=np.zeros(3),
        T_parent_child_zero=np.eye(4),
        limits=(0.0, 1.0),
    )
    return replace(joint, **changes)


@EVERY_TREE
@EVERY_MOTION
def test_the_truth_is_the_true_tree_at_the_true_states(name: str, motion: str):
    made = simulate(load_tree(name), SimulationOptions(frames=40, motion=motion), 4)
    poses = made.tree.forward(made.states.q)
    for body in made.tree.bodies:
        np.testing.assert_allclose(relative(made.truth, made.tree.root, body), poses[body], atol=ROUNDING)


@EVERY_TREE
@EVERY_MOTION
def test_states_keep_to_the_limits_and_the_walk_steps_by_a_tenth_of_the_range(name: str, motion: str):
    tree = load_tree(name)
    made = simulate(tree, SimulationOptions(frames=400, motion=motion), 5)
    start = 0
    for joint in tree.movable:
        q = made.states.q[:, start : start + joint.kind.states]
        start += joint.kind.states
        low, high = joint.limits
        if joint.kind.states > 1:
            assert np.all(np.linalg.norm(q, axis=1) <= high * (1 + 1e-12))
            continue
        assert q.min() >= low and q.max() <= high
        assert np.ptp(q) > 0.5 * (high - low)
        if motion == "walk":
            step = np.abs(np.diff(q[:, 0])) / (high - low)
            assert 0.09 < step.max() <= 0.1 + 1e-12


@EVERY_MOTION
def test_virtual_trackers_are_rigid_on_their_part_and_near_it(motion: str):
    tree = load_tree("experiment1")
    made = simulate(tree, SimulationOptions(frames=30, inflation=3, motion=motion, nearby_m=0.07), 6)
    assert len(made.log.parts) == 4 * (1 + 3)
    assert {frozenset(group) for group in made.tree.rigid_groups} == {
        frozenset([part, *(f"{part}_v{i}" for i in (1, 2, 3))]) for part in tree.parts
    }
    for group in made.tree.rigid_groups:
        for tracker in group[1:]:
            mount = relative(made.truth, group[0], tracker)
            np.testing.assert_allclose(mount, np.broadcast_to(mount[0], mount.shape), atol=ROUNDING)
            assert 0 < np.abs(mount[0, :3, 3]).max() <= 0.07


def test_names_of_virtual_trackers_avoid_those_that_are_taken():
    once = simulate(load_tree("lamp"), SimulationOptions(frames=2, inflation=1), 0)
    again = simulate(once.tree, SimulationOptions(frames=2, inflation=1), 0)
    assert {"foot", "foot_v1", "foot_v2", "foot_v1_v1"} <= set(again.log.parts)
    assert len(set(again.log.parts)) == len(again.log.parts) == 16
    assert all(len(group) == 4 for group in again.tree.rigid_groups)


def test_a_rigid_joint_is_told_as_a_rigid_group_and_the_motion_stays():
    tree = load_tree("all_joints")
    made = simulate(tree, SimulationOptions(frames=50), 7)
    assert ("block", "plate") in made.tree.rigid_groups and "bracket" not in {j.name for j in made.tree.joints}
    assert made.tree.joint("lid").parent == "block"
    mount = relative(made.truth, "block", "plate")
    np.testing.assert_allclose(
        mount, np.broadcast_to(tree.joint("bracket").T_parent_child_zero, mount.shape), atol=ROUNDING
    )
    lid = tree.joint("lid").forward(made.states.state("lid"))
    np.testing.assert_allclose(relative(made.truth, "plate", "cover"), lid, atol=ROUNDING)


def test_a_ball_on_a_part_that_is_fixed_and_turned_tells_its_states_in_the_axes_of_the_body():
    turned = se3.exp([0.1, 0.2, 0.3, 0.4, -0.9, 0.7])
    rigid = door(name="bolt", type="rigid", child="plate", axis_parent=None, point_parent_m=None, limits=None)
    rigid = replace(rigid, T_parent_child_zero=turned)
    ball = door(name="ball", type="spherical", parent="plate", axis_parent=None, point_parent_m=np.ones(3))
    parts = ("frame", "plate", "door")
    tree = KinematicTree(root="frame", parts=parts, rigid_groups=(), trees=(parts,), joints=(rigid, ball))
    made = simulate(tree, SimulationOptions(frames=20, noise=SILENT), 1)
    np.testing.assert_allclose(
        relative(made.truth, "frame", "door"), made.tree.forward(made.states.q)["door"], atol=ROUNDING
    )
    np.testing.assert_allclose(
        relative(made.truth, "plate", "door"), ball.forward(made.states.q @ turned[:3, :3]), atol=ROUNDING
    )


def test_several_trees_move_apart():
    other = door(name="lid", parent="box", child="cover")
    tree = KinematicTree(
        root="frame",
        parts=("frame", "door", "box", "cover"),
        rigid_groups=(),
        trees=(("frame", "door"), ("box", "cover")),
        joints=(door(), other),
    )
    made = simulate(tree, SimulationOptions(frames=20), 2)
    assert np.ptp(relative(made.truth, "frame", "box")[:, :3, 3], axis=0).max() > 0.01
    np.testing.assert_allclose(
        relative(made.truth, "box", "cover"), other.forward(made.states.state("lid")), atol=ROUNDING
    )


@EVERY_MOTION
def test_a_static_root_stands_still_and_a_moving_one_moves_in_small_steps(motion: str):
    options = SimulationOptions(frames=60, motion=motion)
    still, moving = (simulate(load_tree("lamp"), replace(options, root=root), 8) for root in ("static", "moving"))
    foot = still.truth.T_ref_part[:, 0]
    assert np.all(foot == foot[0]) and np.abs(foot[0, :3, 3]).max() <= 5
    step = se3.log(np.linalg.inv(moving.truth.T_ref_part[:-1, 0]) @ moving.truth.T_ref_part[1:, 0])
    assert np.all(np.abs(step).max(axis=0) > 1e-4)
    if motion == "walk":
        assert np.abs(step[:, :3]).max() <= 0.02 and np.abs(step[:, 3:]).max() <= 0.05
    np.testing.assert_array_equal(still.states.q, moving.states.q)


@EVERY_MOTION
@pytest.mark.parametrize("noise", [name for name, model in NOISE_MODELS.items() if model.reference == "world"])
def test_a_planar_object_stays_in_its_planes(motion: str, noise: str):
    options = SimulationOptions(
        frames=50, planar=True, inflation=1, motion=motion, noise=make_noise(noise, 0.01, 0.05), outliers=0.2
    )
    in_space = simulate(load_tree("planar_linkage"), options, 9)
    options = replace(options, planar_noise=True)
    made = simulate(load_tree("planar_linkage"), options, 9)
    for log in (made.log, made.truth):
        T = log.T_ref_part
        np.testing.assert_allclose(T[..., 2, :3], np.broadcast_to([0, 0, 1], T[..., 2, :3].shape), atol=1e-12)
        np.testing.assert_allclose(T[..., 2, 3], 0, atol=1e-12)
        assert np.ptp(T[..., :2, 3], axis=0).min() > 1e-3
    assert not np.array_equal(made.log.T_ref_part, made.truth.T_ref_part)
    np.testing.assert_array_equal(in_space.truth.T_ref_part, made.truth.T_ref_part)
    assert np.all(in_space.log.T_ref_part[..., 2, 3] != 0)


def test_what_is_not_planar_is_refused_with_the_joint_and_why():
    options = SimulationOptions(planar=True)
    with pytest.raises(InvalidData, match=r"joint 'elbow' \(revolute\): its axis is 0 1 0; want one along z"):
        simulate(load_tree("experiment1"), options)
    slide = door(type="prismatic", point_parent_m=None)
    with pytest.raises(InvalidData, match=r"its axis is 0 0 1; want one at right angles to z"):
        simulate(hinged(slide), options)
    with pytest.raises(InvalidData, match="z axes of parent and child differ"):
        simulate(hinged(door(T_parent_child_zero=se3.exp([0, 0, 0, 0.1, 0, 0]))), options)
    with pytest.raises(InvalidData, match=r"\(spherical\) moves in space"):
        simulate(hinged(door(type="spherical", axis_parent=None)), options)
    with pytest.raises(InvalidData, match="camera noise is in space; choose another model, or leave planar_noise out"):
        SimulationOptions(planar=True, planar_noise=True, noise=make_noise("camera", 0.001, 0.01))
    with pytest.raises(InvalidData, match="planar_noise is for planar objects"):
        SimulationOptions(planar_noise=True)


def test_the_shares_of_wrong_and_missing_poses_are_those_that_were_asked_for():
    options = SimulationOptions(frames=2000, noise=SILENT, outliers=0.1, missing=0.2)
    made = simulate(load_tree("lamp"), options, 10)
    count = made.log.seen.size
    missing = ~made.log.seen
    assert abs(missing.mean() - 0.2) < 4 * np.sqrt(0.16 / count)
    wrong = np.any(made.log.T_ref_part != made.truth.T_ref_part, axis=(-2, -1)) & ~missing
    assert abs(wrong.sum() / made.log.seen.sum() - 0.1) < 4 * np.sqrt(0.09 / made.log.seen.sum())
    off = made.log.T_ref_part[wrong][:, :3, 3] - made.truth.T_ref_part[wrong][:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < OUTLIER_M * np.sqrt(3)
    assert np.all(made.truth.seen)


def test_the_motion_of_a_seed_is_the_same_whatever_is_seen_of_it_and_however_long():
    tree = load_tree("drawer_cabinet")
    plain = simulate(tree, SimulationOptions(frames=30), 3)
    for options in (
        SimulationOptions(frames=30, noise=make_noise("student", 0.1, 0.2), outliers=0.3, missing=0.3),
        SimulationOptions(frames=30, inflation=2, known_noise=True),
        SimulationOptions(frames=60),
    ):
        made = simulate(tree, options, 3)
        np.testing.assert_array_equal(made.states.q[:30], plain.states.q)
        np.testing.assert_array_equal(made.truth.T_ref_part[:30, : len(tree.parts)], plain.truth.T_ref_part)
    louder = simulate(tree, SimulationOptions(frames=30, noise=UniformNoise(0.002, 0.02)), 3)
    xi, more = (se3.log(se3.inverse(m.truth.T_ref_part) @ m.log.T_ref_part) for m in (plain, louder))
    np.testing.assert_allclose(more, 2 * xi, atol=1e-9)


def test_seeds_differ():
    made = simulate_all(load_tree("lamp"), SimulationOptions(frames=5), range(4))
    assert len({one.log.T_ref_part.tobytes() for one in made}) == 4
    assert simulate_all(load_tree("lamp"), SimulationOptions(), ()) == ()


def test_a_log_tells_its_noise_only_if_asked_to():
    tree = load_tree("lamp")
    assert simulate(tree).log.covariance is None
    for name in NOISE_MODELS:
        noise = make_noise(name, 0.001, 0.01)
        made = simulate(tree, SimulationOptions(frames=5, noise=noise, known_noise=True))
        np.testing.assert_array_equal(made.log.covariance, noise.covariance(made.truth.T_ref_part))
    with pytest.raises(InvalidData, match="student noise has no variance that could be told"):
        SimulationOptions(noise=make_noise("student", 0.001, 0.01, {"freedom": 2}), known_noise=True)


def test_a_camera_stands_as_far_off_as_it_says():
    options = SimulationOptions(frames=50, noise=make_noise("camera", 0.001, 0.01, {"distance_m": 1.5}))
    truth = simulate(load_tree("lamp"), options, 1).truth
    assert truth.reference == "camera"
    np.testing.assert_allclose(truth.T_ref_part[..., :3, 3].mean(axis=(0, 1)), [0, 0, 1.5], atol=1e-12)


def test_one_noise_for_all_parts_as_printed_would_leave_no_noise_between_them():
    """Lines 4-5 of Algorithm 2 to the letter, on poses: the poses relative to each other are the true ones."""
    truth = simulate(load_tree("experiment1"), SimulationOptions(frames=20), 0).truth.T_ref_part
    delta = se3.exp(np.random.default_rng(0).uniform(-0.1, 0.1, (20, 1, 6)))
    printed = delta @ truth
    between = se3.inverse(printed[:, :1]) @ printed[:, 1:]
    np.testing.assert_allclose(between, se3.inverse(truth[:, :1]) @ truth[:, 1:], atol=ROUNDING)
    ours = UniformNoise(0.1, 0.1).perturbed(truth, np.random.default_rng(0))
    assert np.abs(se3.log(se3.inverse(se3.inverse(ours[:, :1]) @ ours[:, 1:]) @ between)).max(axis=0).min() > 0.05


def test_noise_on_the_left_would_swing_parts_about_the_worlds_origin():
    far = se3.translation(np.array([5.0, 0.0, 0.0]))
    turn = se3.exp([0, 0, 0, 0, 0, 0.1])
    assert np.linalg.norm((turn @ far - far)[:3, 3]) > 0.49
    assert np.linalg.norm((far @ turn - far)[:3, 3]) == 0


def test_a_walk_can_be_played_frame_by_frame():
    tree, rng = load_tree("all_joints"), np.random.default_rng(0)
    ranges = state_ranges(tree)
    q, T = start_states(tree, rng), start_root(rng)
    for _ in range(200):
        poses = place_objects(tree, T, q)
        assert set(poses) == set(tree.bodies)
        np.testing.assert_allclose(se3.inverse(T) @ poses["drawer"], tree.forward(q)["drawer"], atol=ROUNDING)
        after = walk_states(tree, q, rng)
        plain = [i for i in range(len(q)) if not any(b <= i < b + 3 for b in ranges.balls)]
        assert np.all(np.abs(after - q)[plain] <= 0.1 * ranges.span[plain] + 1e-12)
        assert np.all(after[plain] >= ranges.low[plain]) and np.all(after[plain] <= ranges.high[plain])
        q, T = after, walk_root(T, rng, 0.02, 0.05)
    flat = start_root(rng, planar=True)
    assert np.all(walk_root(flat, rng, 0.1, 0.1, planar=True)[2] == [0, 0, 1, 0])


def test_joints_without_limits_turn_as_far_as_they_may_but_a_drawer_is_refused():
    turning = state_ranges(hinged(door(limits=None)))
    assert (turning.low[0], turning.high[0]) == (-np.pi, np.pi)
    ball = state_ranges(hinged(door(type="spherical", axis_parent=None, limits=None)))
    assert (ball.low[0], ball.high[0]) == (0, np.pi)
    observed = state_ranges(hinged(door(limits=None, state_min=0.1, state_max=0.4)))
    assert (observed.low[0], observed.high[0]) == (0.1, 0.4)
    drawer = hinged(door(type="prismatic", point_parent_m=None, limits=None))
    with pytest.raises(InvalidData, match=r"joint 'hinge' \(prismatic\) has no limits: how far may it move\?"):
        simulate(drawer)
    with pytest.raises(InvalidData, match="limits from -1 to 1 rad; a spherical joint's are of the angle"):
        check_movable(hinged(door(type="spherical", axis_parent=None, limits=(-1.0, 1.0))))


def test_a_root_without_a_pose_is_refused():
    with pytest.raises(InvalidData, match="no pose of the root frame; have door"):
        place_objects(hinged(door()), {"door": np.eye(4)}, np.zeros(1))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"frames": 0}, "frames: have 0; want a whole number, 1 or more"),
        ({"frames": 10.0}, "frames: have 10.0"),
        ({"inflation": -1}, "inflation: have -1; want a whole number, 0 or more"),
        ({"noise": "uniform"}, "noise is 'uniform'; want a model such as UniformNoise"),
        ({"motion": "jump"}, "motion 'jump' is unknown; choose one of walk, smooth"),
        ({"root": "flying"}, "root 'flying' is unknown; choose one of moving, static"),
        ({"outliers": 1.0}, "share of outliers is 1.0; want a number from 0 to less than 1"),
        ({"missing": float("nan")}, "share of missing poses is nan"),
        ({"rate_hz": 0.0}, "rate_hz is 0"),
        ({"nearby_m": -0.1}, "nearby_m is -0.1 m; want a finite number, 0 or more"),
        ({"root_step_rad": float("inf")}, "root_step_rad is inf rad"),
        ({"known_noise": True, "noise": UniformNoise(0.0, 0.1)}, "noise of 0 has no standard deviation"),
        ({"root_step_m": 1e9}, "root_step_m is 1e+09 m; want 1e+06 at most"),
        ({"planar": True, "planar_noise": True, "known_noise": True}, "noise in a plane has no covariance in space"),
    ],
)
def test_options_that_can_not_be_are_refused_with_those_that_can(options: dict[str, object], said: str):
    with pytest.raises(InvalidData) as refused:
        SimulationOptions(**options)  # type: ignore[arg-type]
    assert said in str(refused.value)


@pytest.mark.parametrize("seed", (-1, 1.5, True, None, "1"))
def test_a_seed_that_is_none_is_refused(seed: object):
    with pytest.raises(InvalidData, match="want a whole number, 0 or more"):
        simulate(load_tree("lamp"), SimulationOptions(), seed)  # type: ignore[arg-type]


def test_more_than_fits_in_memory_is_refused_before_it_is_made():
    with pytest.raises(InvalidData, match="40000000 poses at once; want 1000000 at most"):
        simulate(load_tree("lamp"), SimulationOptions(frames=10_000_000))
    with pytest.raises(InvalidData, match="poses at once"):
        simulate(load_tree("lamp"), SimulationOptions(inflation=10**9))


def test_one_part_one_frame_and_a_joint_that_may_not_move_are_simulated_too():
    alone = KinematicTree(root="box", parts=("box",), rigid_groups=(), trees=(("box",),), joints=())
    for motion in MOTIONS:
        options = SimulationOptions(frames=1, motion=motion, inflation=1)
        made = simulate(alone, options, 1)
        assert made.log.parts == ("box", "box_v1") and made.states.q.shape == (1, 0)
        stuck = simulate(hinged(door(limits=(0.3, 0.3))), replace(options, frames=20), 1)
        np.testing.assert_allclose(stuck.states.q, 0.3, atol=1e-15)


@EVERY_MOTION
def test_a_ball_with_a_least_angle_keeps_to_it(motion: str):
    ball = hinged(door(type="spherical", axis_parent=None, limits=(0.5, 0.9)))
    q = simulate(ball, SimulationOptions(frames=300, motion=motion), 1).states.q
    angle = np.linalg.norm(q, axis=1)
    assert angle.min() >= 0.5 - 1e-12 and angle.max() <= 0.9 + 1e-12


def test_trackers_whose_place_a_tree_does_not_tell_are_near_their_part():
    parts = ("foot_b", "foot", "lower_arm", "upper_arm", "shade")
    tree = replace(load_tree("lamp"), parts=parts, rigid_groups=(("foot", "foot_b"),))
    made = simulate(tree, SimulationOptions(frames=10, inflation=1), 1)
    assert set(made.tree.rigid_groups[0]) == {"foot", "foot_b", "foot_v1", "foot_b_v1"}
    mount = relative(made.truth, "foot", "foot_b")
    assert 0 < np.abs(mount[0, :3, 3]).max() <= 0.1
    np.testing.assert_allclose(mount, np.broadcast_to(mount[0], mount.shape), atol=ROUNDING)
