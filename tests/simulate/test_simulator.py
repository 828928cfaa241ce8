"""Claims of the motion simulator, against Algorithm 2 in plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from station.formats.trees import example_names, load_tree
from station.kinematics.tree import KinematicTree
from station.simulate import SimulationOptions, UniformNoise, simulate, simulate_all
from station.simulate.simulator import STREAMS

# Metres and dimensionless: rounding of some hundred products of matrices at 10 m.
ROUNDING = 1e-10
SEED = 11


def hat(xi: np.ndarray) -> np.ndarray:
    """(4, 4) of a twist [v, w]."""
    v, (x, y, z) = xi[:3], xi[3:]
    return np.array([[0, -z, y, v[0]], [z, 0, -x, v[1]], [-y, x, 0, v[2]], [0, 0, 0, 0]], dtype=float)


def about(axis: np.ndarray, point: np.ndarray, angle: float, advance: float) -> np.ndarray:
    """(4, 4) screw motion."""
    back, there = np.eye(4), np.eye(4)
    back[:3, 3], there[:3, 3] = -point, point
    return there @ expm(hat(np.concatenate([advance * axis, angle * axis]))) @ back


def fk(joint, sigma: np.ndarray) -> np.ndarray:
    """(4, 4) T_parent_child of one joint, from the definitions of the types."""
    zero = joint.T_parent_child_zero
    if joint.type == "rigid":
        return zero
    if joint.type == "prismatic":
        return about(joint.axis_parent, np.zeros(3), 0.0, sigma[0]) @ zero
    if joint.type == "spherical":
        return about(sigma, joint.point_parent_m, 1.0, 0.0) @ zero
    pitch = joint.pitch_m_per_rad or 0.0
    return about(joint.axis_parent, joint.point_parent_m, sigma[0], pitch * sigma[0]) @ zero


def place_objects(x: dict[str, np.ndarray], tree: KinematicTree, sigma: dict[str, np.ndarray], p: str) -> None:
    """The paper's PLACEOBJECTS, word for word."""
    for joint in tree.joints:
        if joint.parent == p:
            x[joint.child] = x[p] @ fk(joint, sigma.get(joint.name, np.zeros(0)))
            place_objects(x, tree, sigma, joint.child)


def bound(joint, sigma: np.ndarray) -> np.ndarray:
    low, high = joint.limits
    if joint.type == "spherical":
        return sigma * min(max(np.linalg.norm(sigma), low), high) / np.linalg.norm(sigma)
    return np.array([min(max(x, low), high) for x in sigma])


def algorithm_2(tree: KinematicTree, options: SimulationOptions, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(T, K, 4, 4) poses with noise and without, frame by frame, with the same random numbers as `simulate`."""
    rng = {
        name: np.random.default_rng(stream)
        for name, stream in zip(STREAMS, np.random.SeedSequence(seed).spawn(len(STREAMS)), strict=True)
    }
    start = rng["roots"].uniform(-1, 1, 6)
    root_steps = rng["roots"].uniform(-1, 1, (options.frames, 6))
    state_steps = rng["states"].uniform(-1, 1, (options.frames, len(tree.columns)))
    noise = rng["noise"].uniform(-1, 1, (options.frames, len(tree.parts), 6))
    root = expm(hat(np.concatenate([np.zeros(3), 2 * np.pi * start[3:]])))
    root[:3, 3] = 5 * start[:3]
    eps = np.repeat([options.noise.translation_m, options.noise.rotation_rad], 3)
    root_eps = np.repeat([options.root_step_m, options.root_step_rad], 3)
    seen, true = [], []
    sigma: dict[str, np.ndarray] = {}
    for t in range(options.frames):
        columns = iter(state_steps[t])
        for joint in tree.movable:
            u = np.array([next(columns) for _ in range(joint.kind.states)])
            low, high = joint.limits
            if t == 0:
                sigma[joint.name] = bound(joint, u * high if len(u) > 1 else low + (high - low) * (1 + u) / 2)
            else:
                sigma[joint.name] = bound(joint, sigma[joint.name] + u * (high - low) / 10)
        if t > 0:
            root = root @ expm(hat(root_steps[t] * root_eps))
        x = {tree.root: root}
        place_objects(x, tree, sigma, tree.root)
        true.append([x[part] for part in tree.parts])
        seen.append([x[part] @ expm(hat(noise[t, k] * eps)) for k, part in enumerate(tree.parts)])
    return np.array(seen), np.array(true)


@pytest.mark.parametrize("name", example_names())
def test_a_simulation_is_algorithm_2_frame_by_frame(name: str):
    tree, options = load_tree(name), SimulationOptions(frames=25, noise=UniformNoise(0.02, 0.2))
    seen, true = algorithm_2(tree, options, SEED)
    simulated = simulate(tree, options, SEED)
    assert np.abs(simulated.truth.T_ref_part - true).max() < ROUNDING
    assert np.abs(simulated.log.T_ref_part - seen).max() < ROUNDING


@pytest.mark.parametrize("motion", ("walk", "smooth"))
def test_repeats_at_once_are_the_same_to_the_bit_as_one_by_one(motion: str):
    tree = load_tree("all_joints")
    options = SimulationOptions(frames=37, inflation=2, motion=motion, outliers=0.1, missing=0.1)
    seeds = (5, 0, 123456789012345678901234567890)
    for seed, one in zip(seeds, simulate_all(tree, options, seeds), strict=True):
        alone = simulate(tree, options, seed)
        assert (one.seed, one.tree.parts) == (seed, alone.tree.parts)
        for a, b in ((one.log, alone.log), (one.truth, alone.truth)):
            assert a.T_ref_part.tobytes() == b.T_ref_part.tobytes() and a.t_s.tobytes() == b.t_s.tobytes()
        assert one.states.q.tobytes() == alone.states.q.tobytes()
