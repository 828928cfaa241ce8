"""Bodies that move along one line: the likeliest tree by how they moved, and a word where another may do as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from station.fit.learner import Fit, learn
from station.logs import FloatArray
from tests.benchmarks.made_joints import MadeJoint, MadeObject, named, poses, watch
from tests.benchmarks.nulls import free_motion

FRAMES, STD_M, STD_RAD = 300, 0.002, 0.01
T = np.linspace(0, 1, FRAMES)
AXIS = np.array([1.0, 0.0, 0.0])


def pulled(start: float, end: float) -> FloatArray:
    """(T,) from 0 to 1 and back between two times, still before and after."""
    return np.sin(np.pi * np.clip((T - start) / (end - start), 0, 1)) ** 2


def cabinet(states: Sequence[FloatArray], *, kind: str = "prismatic", moves: bool = False) -> Fit:
    """A cabinet with drawers above each other, or with doors about one line."""
    rng = np.random.default_rng(140)
    zero = [poses(np.zeros(3), np.array([0.4, 0.1, 0.1 + 0.2 * i])) for i in range(len(states))]
    joints = tuple(MadeJoint(kind, 0, i + 1, AXIS, np.zeros(3), T_zero) for i, T_zero in enumerate(zero))
    T_world_cabinet = poses(np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.2, 1.5]))
    root = free_motion(rng, "smooth", FRAMES) if moves else np.tile(T_world_cabinet, (FRAMES, 1, 1))
    bodies = tuple(range(len(states) + 1))
    mounts = np.tile(np.eye(4), (len(bodies), 1, 1))
    made = MadeObject(joints, tuple(q[:, None] for q in states), root, "moving" if moves else "static", bodies, mounts)
    parts = ("cabinet", *(f"drawer{i}" for i in range(len(states))))
    return learn(named(watch(rng, made.T_ref_part, STD_M, STD_RAD), parts).log)


def edges(fit: Fit) -> set[frozenset[str]]:
    return {frozenset((joint.parent, joint.child)) for joint in fit.tree.joints}


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize(("kind", "travel"), [("prismatic", 0.2), ("revolute", 1.0)])
def test_drawers_that_were_pulled_one_at_a_time_hang_from_the_cabinet(kind: str, travel: float, moves: bool) -> None:
    fit = cabinet(
        [travel * pulled(0, 0.3), travel * pulled(0.35, 0.65), travel * pulled(0.7, 1)], kind=kind, moves=moves
    )
    assert edges(fit) == {frozenset(("cabinet", f"drawer{i}")) for i in range(3)}
    assert [joint.type for joint in fit.tree.joints] == [kind] * 3
    assert fit.tree.warnings == ()


def test_a_drawer_in_a_drawer_hangs_from_that() -> None:
    """The outer one is pulled and carries the inner one; then the inner one alone."""
    outer, inner = 0.2 * pulled(0, 0.45), 0.15 * pulled(0.55, 1)
    fit = cabinet([outer, outer + inner])
    assert edges(fit) == {frozenset(("cabinet", "drawer0")), frozenset(("drawer0", "drawer1"))}
    assert fit.tree.warnings == ()


def test_drawers_that_moved_at_once_are_said_to_be_in_doubt() -> None:
    fit = cabinet([0.2 * np.sin(8 * T), 0.2 * np.sin(4.4 * T + 1)])
    assert len(fit.tree.joints) == 2 and all(joint.type == "prismatic" for joint in fit.tree.joints)
    assert any("may as well connect" in warning and "to 1" in warning for warning in fit.tree.warnings)


def test_drawers_at_right_angles_are_in_no_doubt() -> None:
    rng = np.random.default_rng(141)
    axes = (AXIS, np.array([0.0, 1.0, 0.0]))
    joints = tuple(
        MadeJoint("prismatic", 0, i + 1, axis, np.zeros(3), poses(np.zeros(3), np.array([0.4, 0.1, 0.2 * i])))
        for i, axis in enumerate(axes)
    )
    q = tuple(0.2 * np.sin(rate * T)[:, None] for rate in (8.0, 4.4))
    root, mounts = np.tile(np.eye(4), (FRAMES, 1, 1)), np.tile(np.eye(4), (3, 1, 1))
    made = MadeObject(joints, q, root, "static", (0, 1, 2), mounts)
    fit = learn(named(watch(rng, made.T_ref_part, STD_M, STD_RAD), ("cabinet", "drawer0", "drawer1")).log)
    assert edges(fit) == {frozenset(("cabinet", "drawer0")), frozenset(("cabinet", "drawer1"))}
    assert fit.tree.warnings == ()
