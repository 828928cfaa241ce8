"""Gravity's torque on joints against the slope of the potential energy, which knows no levers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.kinematics.tree import Joint, KinematicTree
from station.simulate.gravity import GRAVITY_M_S2, gravity_torques

STEP = 1e-5  # rad or m
BODIES = ("base", "a", "b", "c", "d")


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def random_tree(rng: np.random.Generator) -> KinematicTree:
    """Four joints in a tree of any shape, turning and sliding, in skew directions."""
    joints = []
    for k, body in enumerate(BODIES[1:]):
        sliding = k == 2
        zero = np.eye(4)
        zero[:3, 3] = rng.normal(size=3)
        joints.append(
            Joint(
                name=f"to_{body}",
                type="prismatic" if sliding else "revolute",
                parent=BODIES[int(rng.integers(k + 1))],
                child=body,
                axis_parent=unit(rng.normal(size=3)),
                point_parent_m=None if sliding else rng.normal(size=3),
                T_parent_child_zero=zero,
            )
        )
    return KinematicTree(root="base", parts=BODIES, rigid_groups=(), trees=(BODIES,), joints=tuple(joints))


def energy_j(tree: KinematicTree, q: dict, masses: dict, centres: dict, up: np.ndarray) -> np.ndarray:
    """(...,) potential energy of the bodies."""
    poses = tree.forward(q)
    return sum(
        GRAVITY_M_S2 * mass * ((poses[body] @ np.append(centres[body], 1.0))[..., :3] @ up)
        for body, mass in masses.items()
    )


@given(st.integers(0, 2**32 - 1))
def test_it_is_the_slope_of_the_potential_energy(seed: int):
    rng = np.random.default_rng(seed)
    tree, up = random_tree(rng), unit(rng.normal(size=3))
    masses = dict(zip(BODIES, rng.uniform(0.1, 2.0, 5).tolist(), strict=True))
    centres = {body: rng.normal(size=3) for body in BODIES}
    q = {joint.name: rng.uniform(-3, 3, size=7) for joint in tree.joints}
    torques = gravity_torques(tree, q, masses, centres, up)
    for name in q:
        above, under = (energy_j(tree, q | {name: q[name] + s * STEP}, masses, centres, up) for s in (1, -1))
        # the third derivative of the energy is at most some 2 kg * 10 m/s^2 * 20 m: 1e-8 N m here, and rounding
        np.testing.assert_allclose(torques[name], (under - above) / (2 * STEP), atol=1e-6)


def test_a_kilogram_a_metre_out_pulls_with_ten_newton_metres():
    tree = KinematicTree(
        root="base",
        parts=("base", "arm"),
        rigid_groups=(),
        trees=(("base", "arm"),),
        joints=(
            Joint(
                "shoulder",
                "revolute",
                "base",
                "arm",
                np.array([0.0, -1, 0]),
                np.zeros(3),
                T_parent_child_zero=np.eye(4),
            ),
        ),
    )
    torque = gravity_torques(tree, {"shoulder": [0.0, np.pi / 2]}, {"arm": 1.0}, {"arm": [1.0, 0, 0]})["shoulder"]
    np.testing.assert_allclose(torque, [-GRAVITY_M_S2, 0], atol=1e-12)  # -y lifts x: gravity turns it back
    assert gravity_torques(tree, {"shoulder": 0.0}, {}, {})["shoulder"] == pytest.approx(0.0)
