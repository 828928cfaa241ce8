"""Random articulated objects with trackers, made from the definitions of the joints; and whether a fit is right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray
from station.tree_scores import score_tree
from tests.benchmarks.made_joints import (
    PITCH_M_PER_RAD,
    STATES,
    MadeJoint,
    MadeObject,
    inverse,
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


def true_tree(made: MadeObject) -> KinematicTree:
    """The object as a tree of its trackers, each body named by the first of them."""
    first = {body: made.body_of.index(body) for body in sorted(set(made.body_of))}
    parts = {body: made.parts[k] for body, k in first.items()}
    members = {body: tuple(p for p, of in zip(made.parts, made.body_of, strict=True) if of == body) for body in first}
    return KinematicTree(
        root=parts[0],
        parts=made.parts,
        rigid_groups=tuple(group for group in members.values() if len(group) > 1),
        trees=(tuple(parts.values()),),
        joints=tuple(
            _told(joint, parts, {body: made.T_body_part[k] for body, k in first.items()}) for joint in made.joints
        ),
    )


def _told(joint: MadeJoint, parts: Mapping[int, str], T_body_part: Mapping[int, FloatArray]) -> Joint:
    """A joint between two trackers, in the frame of the parent's."""
    T_part_body, kind = inverse(T_body_part[joint.parent]), JOINT_TYPES[joint.type]
    point = T_part_body[:3, :3] @ joint.point_m + T_part_body[:3, 3]
    return Joint(
        name=f"b{joint.parent}__b{joint.child}",
        type=joint.type,
        parent=parts[joint.parent],
        child=parts[joint.child],
        axis_parent=T_part_body[:3, :3] @ joint.axis if kind.has_axis else None,
        point_parent_m=point if kind.has_point else None,
        T_parent_child_zero=T_part_body @ joint.T_parent_child_zero @ T_body_part[joint.child],
        pitch_m_per_rad=joint.pitch_m_per_rad if kind.form_freedoms else None,
    )


def mistakes(tree: KinematicTree, made: MadeObject) -> dict[str, str]:
    """What is wrong with a fitted tree: "groups", "edges" or "types", the first that is, with a sentence."""
    scores = score_tree(tree, true_tree(made))
    right = {"groups": scores.groups_correct, "edges": scores.structure_correct, "types": scores.types_correct}
    wrong = [step for step, holds in right.items() if not holds]
    return {wrong[0]: "; ".join(scores.mistakes)} if wrong else {}
