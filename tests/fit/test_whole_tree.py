"""Whole tree: Jacobians by finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from station.fit.whole_tree import Skeleton, TreeModel, jacobians, part_poses, stepped
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames

FRAMES, STEP = 4, 1e-6


def example(*, root_moves: bool) -> tuple[Skeleton, TreeModel]:
    rng = np.random.default_rng(40)
    revolute, prismatic = JOINT_TYPES["revolute"], JOINT_TYPES["prismatic"]
    skeleton = Skeleton(
        joints=((0, 1, revolute), (1, 2, prismatic), (0, 3, revolute)),
        body_of=(0, 1, 1, 2, 3, 3, 0),
        free_mount=(False, False, True, False, False, True, True),
        root_moves=root_moves,
    )
    root = se3.exp(rng.normal(size=(FRAMES, 6))) if root_moves else se3.identity(FRAMES)
    frames = tuple(JointFrames.plain(se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6))) for _ in skeleton.joints)
    return skeleton, TreeModel(root, frames, rng.normal(size=(FRAMES, 3)), se3.exp(rng.normal(size=(7, 6))))


@pytest.mark.parametrize("root_moves", [True, False])
def test_jacobians_are_those_of_finite_differences(root_moves: bool) -> None:
    skeleton, model = example(root_moves=root_moves)
    by_parameters, by_states = jacobians(skeleton, model)
    n, s = skeleton.parameters, skeleton.states
    assert (n, s) == (9 + 7 + 9 + 18, 9 if root_moves else 3)

    def slope(step: np.ndarray, states: np.ndarray) -> np.ndarray:
        ahead = part_poses(skeleton, stepped(skeleton, model, step, states))
        behind = part_poses(skeleton, stepped(skeleton, model, -step, -states))
        return se3.log(se3.inverse(behind) @ ahead) / (2 * STEP)

    for i in range(n):
        numeric = slope(STEP * np.eye(n)[i], np.zeros((FRAMES, s)))
        np.testing.assert_allclose(by_parameters[..., i], numeric, atol=1e-7)
    for i in range(s):
        numeric = slope(np.zeros(n), np.tile(STEP * np.eye(s)[i], (FRAMES, 1)))
        np.testing.assert_allclose(by_states[..., i], numeric, atol=1e-7)
