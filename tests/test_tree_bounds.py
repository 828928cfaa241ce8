"""The bounds of a tree's axes and points: against finite differences, against fits, and what they don't cover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.errors import InvalidData
from station.fit.learner import learn
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, JointLog, PoseLog
from station.tree_bounds import JointBound, tree_bounds
from station.tree_scores import score_tree
from tests.benchmarks.bounds import bound
from tests.benchmarks.made_joints import MadeObject, named, watch
from tests.benchmarks.made_trees import random_tree, true_tree

STD_M, STD_RAD = 0.003, 0.02
KINDS = ("prismatic", "revolute", "screw", "spherical")
COVARIANCE = np.diag(np.repeat([STD_M**2, STD_RAD**2], 3))


def made_tree(seed: int, *, root_moves: bool, bodies: int = 4, kinds: tuple[str, ...] = KINDS) -> MadeObject:
    rng = np.random.default_rng(seed)
    return random_tree(rng, bodies=bodies, frames=30, kinds=kinds, root_moves=root_moves, walk=False, trackers=(1, 3))


def truth_of(made: MadeObject) -> tuple[KinematicTree, PoseLog, JointLog]:
    tree, poses = true_tree(made), made.T_ref_part
    t_s = np.arange(len(poses)) / 30
    states = JointLog(t_s, tree.columns, np.concatenate(made.q, axis=-1), tuple(tree.units.values()))
    return tree, PoseLog(t_s, "world", made.parts, poses), states


def bounds_of(made: MadeObject, **options: object) -> tuple[JointBound, ...]:
    return tree_bounds(*truth_of(made), COVARIANCE, root_moves=made.root == "moving", **options)  # type: ignore[arg-type]


def at_feet(made: MadeObject) -> MadeObject:
    """The object with each axis' point nearest the mean position of the child's first tracker."""
    tree, truth, _ = truth_of(made)
    moved = []
    for j, told in zip(made.joints, tree.joints, strict=True):
        a, b = (truth.T_ref_part[:, made.parts.index(end)] for end in (told.parent, told.child))
        T_body_part = made.T_body_part[made.parts.index(told.parent)]
        middle = (T_body_part @ (np.linalg.inv(a) @ b))[:, :3, 3].mean(axis=0)
        along = 0.0 if j.type == "spherical" else j.axis @ (middle - j.point_m)
        moved.append(replace(j, point_m=j.point_m + along * j.axis))
    return replace(made, joints=tuple(moved))


@pytest.mark.parametrize("root_moves", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_bounds_are_those_of_finite_differences(seed: int, root_moves: bool) -> None:
    """All types; the oracle differentiates poses that are made from the joints' definitions, by all parameters."""
    made = made_tree(seed, root_moves=root_moves)
    rng = np.random.default_rng(seed)
    seen = rng.uniform(size=made.T_ref_part.shape[:2]) > 0.2
    least = bound(at_feet(made), np.zeros((*seen.shape, 6)), STD_M, STD_RAD, seen=seen.astype(float))
    for j, found in enumerate(bounds_of(made, seen=seen)):
        for mine, oracle in ((found.axis, least.axis(j)), (found.point, least.point(j))):
            # Across an axis any two normals will do: the ellipse is the same. Central differences are good to 1e-9.
            assert np.linalg.eigvalsh(mine) == pytest.approx(np.linalg.eigvalsh(oracle), rel=1e-5)


def test_roots_of_the_traces_are_told_and_none_where_a_type_has_no_axis_or_point() -> None:
    made = made_tree(1, root_moves=True, kinds=("prismatic", "spherical"), bodies=5)
    assert {joint.type for joint in made.joints} == {"prismatic", "spherical"}
    for joint, found in zip(made.joints, bounds_of(made), strict=True):
        if joint.type == "spherical":
            assert found.axis_rad is None and found.point_m == pytest.approx(np.sqrt(np.trace(found.point)))
        else:
            assert found.point_m is None and found.axis_rad == pytest.approx(np.sqrt(np.trace(found.axis)))


def test_twice_the_noise_doubles_the_bounds_and_the_world_frame_is_nothing_to_them() -> None:
    made = made_tree(2, root_moves=True)
    tree, truth, states = truth_of(made)
    far = replace(truth, T_ref_part=se3.exp([3.0, -4.0, 2.0, 1.0, 2.0, -0.5]) @ truth.T_ref_part)
    once = bounds_of(made)
    for other, factor in (
        (tree_bounds(tree, truth, states, 4 * COVARIANCE, root_moves=True), 4),
        (tree_bounds(tree, far, states, COVARIANCE, root_moves=True), 1),
    ):
        for a, b in zip(once, other, strict=True):
            assert b.axis == pytest.approx(factor * a.axis, rel=1e-6, abs=1e-15)
            assert b.point == pytest.approx(factor * a.point, rel=1e-6, abs=1e-15)


def test_noise_that_differs_from_pose_to_pose_counts_pose_by_pose() -> None:
    """A pose with a thousand times the deviation is as good as unseen."""
    made = made_tree(3, root_moves=False)
    shape = made.T_ref_part.shape[:2]
    seen = np.random.default_rng(3).uniform(size=shape) > 0.3
    loud = np.where(seen, 1.0, 1e6)[..., None, None] * COVARIANCE
    found = tree_bounds(*truth_of(made), loud, root_moves=False)
    for a, b in zip(bounds_of(made, seen=seen), found, strict=True):
        assert np.linalg.eigvalsh(b.axis) == pytest.approx(np.linalg.eigvalsh(a.axis), rel=1e-4)


def test_a_joint_that_rests_has_infinite_bounds_and_leaves_the_others_finite() -> None:
    made = made_tree(4, root_moves=True, kinds=("prismatic", "revolute"))
    resting = replace(made, q=(0.0 * made.q[0], *made.q[1:]))
    first, *others = bounds_of(resting)
    assert first.axis_rad == np.inf
    assert all(other.axis_rad is not None and np.isfinite(other.axis_rad) for other in others)


def test_each_tree_of_a_forest_has_the_bounds_it_has_alone() -> None:
    made = made_tree(5, root_moves=True, bodies=3, kinds=("revolute",))
    tree, truth, states = truth_of(made)
    copies = [_renamed(tree, name) for name in ("x", "y")]
    both = KinematicTree(
        copies[0].root,
        tuple(part for copy in copies for part in copy.parts),
        tuple(group for copy in copies for group in copy.rigid_groups),
        tuple(bodies for copy in copies for bodies in copy.trees),
        tuple(joint for copy in copies for joint in copy.joints),
    )
    poses = PoseLog(truth.t_s, "world", both.parts, np.tile(truth.T_ref_part, (1, 2, 1, 1)))
    q = JointLog(states.t_s, both.columns, np.tile(states.q, (1, 2)), states.units * 2)
    found = tree_bounds(both, poses, q, COVARIANCE, root_moves=True)
    for one, other in zip(found, bounds_of(made) * 2, strict=True):
        assert one.axis == pytest.approx(other.axis, rel=1e-9)
    assert [bound.joint for bound in found] == [joint.name for joint in both.joints]


def _renamed(tree: KinematicTree, stem: str) -> KinematicTree:
    def new(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(f"{stem}_{name}" for name in names)

    def moved(joint: Joint) -> Joint:
        name, parent, child = new((joint.name, joint.parent, joint.child))
        return replace(joint, name=name, parent=parent, child=child)

    groups, trees = tuple(map(new, tree.rigid_groups)), tuple(map(new, tree.trees))
    (root,) = new((tree.root,))
    return KinematicTree(root, new(tree.parts), groups, trees, tuple(moved(joint) for joint in tree.joints))


def test_fits_of_gaussian_noise_err_as_much_as_the_bound_says() -> None:
    """So the bound is attained: what the station finds is efficient."""
    made = made_tree(6, root_moves=True, bodies=3, kinds=("prismatic", "revolute"))
    tree, truth, _ = truth_of(made)
    least = [found.axis_rad for found in bounds_of(made)]
    squares: list[float] = []
    for seed in range(12):
        log = named(watch(np.random.default_rng(seed), made.T_ref_part, STD_M, STD_RAD), made.parts).log
        scores = score_tree(learn(log).tree, tree, truth)
        assert scores.types_correct
        squares += [_square(score.axis_error_rad, rad) for score, rad in zip(scores.joints, least, strict=True)]
    # 24 squares of two-dimensional errors, at worst along one direction each: a standard deviation of 29 %.
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.35)


def _square(error: float | None, least: float | None) -> float:
    assert error is not None and least is not None
    return (error / least) ** 2


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), np.diag([1.0] * 5 + [np.inf]), np.eye(3)])
def test_a_covariance_that_is_none_is_refused(covariance: FloatArray) -> None:
    with pytest.raises(InvalidData, match="positive definite"):
        tree_bounds(*truth_of(made_tree(0, root_moves=False)), covariance, root_moves=False)


def test_a_part_without_true_poses_is_refused() -> None:
    tree, truth, states = truth_of(made_tree(0, root_moves=False))
    fewer = PoseLog(truth.t_s, "world", truth.parts[1:], truth.T_ref_part[:, 1:])
    with pytest.raises(InvalidData, match=f"no true poses of {truth.parts[0]}"):
        tree_bounds(tree, fewer, states, COVARIANCE, root_moves=False)
