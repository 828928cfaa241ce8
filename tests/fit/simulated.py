"""Seeded articulated objects with trackers: truth and a noisy log, made from the definition of the joints alone; and
how near a fit comes to the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, PoseLog
from station.tree_scores import TreeScores, score_tree

FRAME_S = 1 / 30


@dataclass(frozen=True, eq=False)
class Truth:
    """What was simulated: body of each part, (parent body, child body, type) of each joint, states (T, J), poses."""

    body_of: tuple[int, ...]
    joints: tuple[tuple[int, int, str], ...]
    q: FloatArray
    T_world_body: FloatArray  # (T, B, 4, 4)
    T_body_part: FloatArray  # (K, 4, 4)
    axis_parent_body: FloatArray  # (J, 3), in the parent body's frame
    point_parent_body: FloatArray  # (J, 3)


def poses(rotation_vectors: FloatArray, translations: FloatArray) -> FloatArray:
    """(..., 4, 4) of rotation vectors and translations (..., 3) that broadcast."""
    rotation_vectors, translations = np.broadcast_arrays(rotation_vectors, translations)
    T = np.zeros((*translations.shape[:-1], 4, 4))
    T[..., :3, :3] = (
        Rotation.from_rotvec(np.reshape(rotation_vectors, (-1, 3))).as_matrix().reshape(*T.shape[:-2], 3, 3)
    )
    T[..., :3, 3] = translations
    T[..., 3, 3] = 1
    return T


def random_pose(rng: np.random.Generator, reach_m: float) -> FloatArray:
    return poses(Rotation.random(random_state=rng).as_rotvec(), rng.uniform(-reach_m, reach_m, 3))


def states(rng: np.random.Generator, T: int, travel: float, kind: str) -> FloatArray:
    """Smooth (two sines) or a reflected random walk over the whole travel."""
    t = np.linspace(0, 1, T)
    if kind == "smooth":
        f = rng.uniform(0.5, 2.0, 2)
        q = np.sin(2 * np.pi * (f[0] * t + rng.uniform())) + 0.5 * np.sin(2 * np.pi * (f[1] * 2 * t + rng.uniform()))
    else:
        q = np.cumsum(rng.uniform(-1, 1, T))
    return travel * (q - q.min()) / (q.max() - q.min())


def simulated_tree(
    rng: np.random.Generator,
    *,
    bodies: int,
    frames: int = 300,
    root_moves: bool = False,
    kind: str = "smooth",
    trackers: tuple[int, int] = (1, 3),
) -> Truth:
    """A random tree; each joint moves by 20-120 deg or 6-25 cm."""
    T_world_body = np.tile(np.eye(4), (frames, bodies, 1, 1))
    T_world_body[:, 0] = random_pose(rng, 1.0)
    if root_moves:
        sway = np.stack([states(rng, frames, 0.2, kind) for _ in range(6)], axis=-1)
        T_world_body[:, 0] = T_world_body[:, 0] @ poses(3 * sway[:, 3:], sway[:, :3])
    joints, q, axes, points = [], [], [], []
    for child in range(1, bodies):
        parent = int(rng.integers(child))
        joint = str(rng.choice(["revolute", "revolute", "prismatic"]))
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        point = rng.uniform(-0.15, 0.15, 3)
        zero = random_pose(rng, 0.25)
        travel = np.radians(rng.uniform(20, 120)) if joint == "revolute" else rng.uniform(0.06, 0.25)
        state = states(rng, frames, travel, kind)
        if joint == "revolute":
            motion = poses(np.zeros((frames, 3)), point) @ poses(state[:, None] * axis, np.zeros((frames, 3)))
            motion = motion @ poses(np.zeros(3), -point)
        else:
            motion = poses(np.zeros((frames, 3)), state[:, None] * axis)
        T_world_body[:, child] = T_world_body[:, parent] @ motion @ zero
        joints.append((parent, child, joint))
        q.append(state)
        axes.append(axis)
        points.append(point)
    body_of = [body for body in range(bodies) for _ in range(rng.integers(trackers[0], trackers[1] + 1))]
    mounts = np.stack([random_pose(rng, 0.08) for _ in body_of])
    order = rng.permutation(len(body_of))
    return Truth(
        tuple(body_of[i] for i in order),
        tuple(joints),
        np.stack(q, -1),
        T_world_body,
        mounts[order],
        np.array(axes),
        np.array(points),
    )


def noisy_log(
    rng: np.random.Generator,
    truth: Truth,
    *,
    sigma_m: float,
    sigma_rad: float,
    missing: float = 0.0,
    camera_like: bool = False,
) -> PoseLog:
    """The trackers' poses in the world, each with right-perturbed Gaussian noise.

    Camera-like: noise four times as large along one direction of each pose's own position and about two of
    orientation, with its covariance in the log; else unknown to the log.
    """
    T_world_part = truth.T_world_body[:, list(truth.body_of)] @ truth.T_body_part
    T, K = T_world_part.shape[:2]
    scale = np.tile(np.array([sigma_m] * 3 + [sigma_rad] * 3), (T, K, 1))
    axes = np.broadcast_to(np.eye(3), (T, K, 3, 3))
    if camera_like:
        axes = np.swapaxes(T_world_part[..., :3, :3], -1, -2)  # columns: the world's axes in the part's frame
        scale = scale * np.array([1, 1, 4, 4, 4, 1])
    noise = scale * rng.normal(size=(T, K, 6))
    v, w = ((axes @ x[..., None])[..., 0] for x in (noise[..., :3], noise[..., 3:]))
    measured = T_world_part @ poses(w, v)
    unseen = rng.uniform(size=(T, K)) < missing
    measured[unseen] = np.nan
    covariance = None
    if camera_like:
        covariance = np.zeros((T, K, 6, 6))
        for part in (slice(0, 3), slice(3, 6)):
            covariance[..., part, part] = (axes * scale[..., None, part] ** 2) @ np.swapaxes(axes, -1, -2)
        covariance[unseen] = np.nan
    parts = tuple(f"p{k}_b{body}" for k, body in enumerate(truth.body_of))
    return PoseLog(np.arange(T) * FRAME_S, "world", parts, measured, covariance)


def scores(truth: Truth, log: PoseLog, found: KinematicTree) -> TreeScores:
    """Of what was found in a log of the truth; joints in the order of the truth's."""
    exact = truth.T_world_body[:, list(truth.body_of)] @ truth.T_body_part
    return score_tree(found, true_tree(truth, log.parts), PoseLog(log.t_s, log.reference, log.parts, exact))


def true_tree(truth: Truth, parts: tuple[str, ...]) -> KinematicTree:
    """The truth as a tree of its trackers, each body named by the first of them."""
    bodies = sorted(set(truth.body_of))
    members = {b: tuple(p for p, of in zip(parts, truth.body_of, strict=True) if of == b) for b in bodies}
    first = {b: names[0] for b, names in members.items()}
    joints = tuple(_true_joint(truth, i, first) for i in range(len(truth.joints)))
    groups = tuple(group for group in members.values() if len(group) > 1)
    return KinematicTree(first[0], parts, groups, (tuple(first.values()),), joints)


def _true_joint(truth: Truth, i: int, name: dict[int, str]) -> Joint:
    """Between the first trackers of its bodies; its states begin at 0."""
    parent, child, kind = truth.joints[i]
    T_parent, T_child = (truth.T_body_part[truth.body_of.index(body)] for body in (parent, child))
    T_part_body = se3.inverse(T_parent)
    first = int(np.argmin(truth.q[:, i]))
    T_zero = se3.inverse(truth.T_world_body[first, parent]) @ truth.T_world_body[first, child]
    point = T_part_body[:3, :3] @ truth.point_parent_body[i] + T_part_body[:3, 3]
    return Joint(
        name=f"joint{i}",
        type=kind,
        parent=name[parent],
        child=name[child],
        axis_parent=T_part_body[:3, :3] @ truth.axis_parent_body[i],
        point_parent_m=point if kind == "revolute" else None,
        T_parent_child_zero=T_part_body @ T_zero @ T_child,
    )
