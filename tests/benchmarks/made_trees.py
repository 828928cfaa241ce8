"""Random articulated objects with trackers, made from the definitions of the joints; and whether a fit is right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from tests.benchmarks.made_joints import (
    PITCH_M_PER_RAD,
    STATES,
    MadeJoint,
    MadeObject,
    poses,
    random_direction,
    random_poses,
    random_rotations,
)

TRAVEL = {"prismatic": (0.05, 0.25), "turning": (np.radians(15.0), np.radians(120.0))}  # m, rad: least and most
POINT_M, ZERO_M, MOUNT_M, ROOT_M = 0.15, 0.25, 0.08, 1.0  # half sides of the cubes in which things are
WALK_SHARE = 0.1  # of the range, the largest step of a state in a frame (paper, Algorithm 2, line 8)
ROOT_STEP_M, ROOT_STEP_RAD = 0.01, 0.05
ROOT_SWAY_M, ROOT_SWAY_RAD = 0.1, 0.5


def smooth(rng: np.random.Generator, frames: int) -> FloatArray:
    """(T,) sum of two sines, from 0 to 1."""
    t = np.linspace(0, 2 * np.pi, frames)
    rate, phase = rng.uniform(0.5, 2.0, 2), rng.uniform(0, 2 * np.pi, 2)
    q = np.sin(rate[0] * t + phase[0]) + 0.5 * np.sin(2 * rate[1] * t + phase[1])
    return (q - q.min()) / (q.max() - q.min())


def bounded_walk(rng: np.random.Generator, frames: int) -> FloatArray:
    """(T,) steps of at most a tenth of the range, held within it (paper, Algorithm 2), then stretched to 0 to 1."""
    q = np.empty(frames)
    q[0] = rng.uniform()
    for t, step in enumerate(rng.uniform(-WALK_SHARE, WALK_SHARE, frames - 1)):  # each starts where the last ended
        q[t + 1] = np.clip(q[t] + step, 0.0, 1.0)
    return (q - q.min()) / (q.max() - q.min())


def states(rng: np.random.Generator, kind: str, frames: int, *, walk: bool) -> FloatArray:
    """(T, s) over a random travel; each of a spherical joint's three over one of its own."""
    low, high = TRAVEL["prismatic" if kind == "prismatic" else "turning"]
    columns = [(bounded_walk if walk else smooth)(rng, frames) * rng.uniform(low, high) for _ in range(STATES[kind])]
    return np.stack(columns, axis=-1)


def root_poses(rng: np.random.Generator, frames: int, *, moves: bool, walk: bool) -> FloatArray:
    """(T, 4, 4)."""
    start = random_poses(rng, ROOT_M)
    if not moves:
        return np.tile(start, (frames, 1, 1))
    if walk:
        steps = rng.uniform(-1, 1, (frames - 1, 6)) * np.repeat([ROOT_STEP_M, ROOT_STEP_RAD], 3)
        found = [start]
        for step in poses(steps[:, 3:], steps[:, :3]):  # each pose starts where the last one ended
            found.append(found[-1] @ step)
        return np.stack(found)
    sway = np.stack([smooth(rng, frames) for _ in range(6)], axis=-1) * 2 * np.repeat([ROOT_SWAY_M, ROOT_SWAY_RAD], 3)
    return start @ poses(sway[:, 3:], sway[:, :3])


def random_tree(
    rng: np.random.Generator,
    *,
    bodies: int,
    frames: int,
    kinds: Sequence[str],
    root_moves: bool,
    walk: bool,
    trackers: tuple[int, int] = (1, 3),
) -> MadeObject:
    """A random tree whose joints' types are drawn from `kinds`, with that many trackers on each body."""
    joints: list[MadeJoint] = []
    for child in range(1, bodies):
        kind = str(rng.choice(list(kinds)))
        zero = poses(random_rotations(rng), rng.uniform(-ZERO_M, ZERO_M, 3))
        point = rng.uniform(-POINT_M, POINT_M, 3)
        pitch = PITCH_M_PER_RAD if kind == "screw" else 0.0
        joints.append(MadeJoint(kind, int(rng.integers(child)), child, random_direction(rng), point, zero, pitch))
    body_of = [body for body in range(bodies) for _ in range(rng.integers(trackers[0], trackers[1] + 1))]
    shuffled = tuple(int(body) for body in rng.permutation(body_of))
    return MadeObject(
        tuple(joints),
        tuple(states(rng, joint.type, frames, walk=walk) for joint in joints),
        root_poses(rng, frames, moves=root_moves, walk=walk),
        "moving" if root_moves else "static",
        shuffled,
        random_poses(rng, MOUNT_M, len(body_of)),
    )


def body_members(tree: KinematicTree) -> dict[str, frozenset[str]]:
    """Parts of each body of a fitted tree, by its named part."""
    groups = {name: frozenset(group) for group in tree.rigid_groups for name in group}
    return {name: groups.get(name, frozenset((name,))) for name in tree.bodies}


def mistakes(tree: KinematicTree, made: MadeObject, parts: Sequence[str]) -> dict[str, str]:
    """What is wrong with a fitted tree: "groups", "edges" or "types", the first that is, with a sentence."""
    true_groups = {
        body: frozenset(part for part, of in zip(parts, made.body_of, strict=True) if of == body)
        for body in set(made.body_of)
    }
    found_groups = body_members(tree)
    body_by_group = {group: body for body, group in true_groups.items()}
    if set(found_groups.values()) != set(true_groups.values()):
        return {"groups": _differing(set(found_groups.values()), set(true_groups.values()))}
    true_types = {frozenset((joint.parent, joint.child)): joint.type for joint in made.joints}
    found_types = {
        frozenset(body_by_group[found_groups[name]] for name in (joint.parent, joint.child)): joint.type
        for joint in tree.joints
    }
    if set(found_types) != set(true_types):
        odd, lost = _edges(set(found_types) - set(true_types)), _edges(set(true_types) - set(found_types))
        return {"edges": f"joints {odd} instead of {lost}"}
    wrong = [e for e in true_types if true_types[e] != found_types[e]]
    if wrong:
        return {"types": "; ".join(f"{_edges({e})} is {true_types[e]}, called {found_types[e]}" for e in wrong)}
    return {}


def _edges(edges: set[frozenset[int]]) -> str:
    return ", ".join("-".join(str(body) for body in sorted(edge)) for edge in sorted(edges, key=sorted)) or "none"


def _differing(found: set[frozenset[str]], true: set[frozenset[str]]) -> str:
    odd = ["+".join(sorted(group)) for group in sorted(found - true, key=sorted)]
    return f"{len(found)} bodies instead of {len(true)}: {', '.join(odd)}"
