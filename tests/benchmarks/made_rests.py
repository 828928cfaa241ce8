"""Objects whose joints move one at a time and rest for long, and trackers that err alike wherever a pose is the same.

A marker that stands still is found again and again with nearly the same error: what differs from frame to frame at
rest is far less than what differs from pose to pose.
"""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray, PoseLog
from tests.benchmarks.made_joints import (
    FRAME_S,
    OUTLIER_REACH_M,
    MadeJoint,
    MadeObject,
    poses,
    random_direction,
    random_poses,
)

POINT_M, ZERO_M, MOUNT_M, ROOT_M = 0.15, 0.25, 0.05, 1.0  # half sides of the cubes in which things are
TRAVEL_RAD = (np.radians(25.0), np.radians(80.0))  # to either side of the rest
# Lengths [m] and angles [rad] over which an error that goes with the pose changes, and waves that make it.
CHANGE_M, CHANGE_RAD, WAVES = 0.1, 0.5, 4


def turn_of(frames: int, start: int, stop: int, travel_rad: float) -> FloatArray:
    """(T, 1) a swing to both sides from frame `start` to `stop`, at rest before and after."""
    q = np.zeros((frames, 1))
    q[start:stop, 0] = travel_rad * np.sin(np.linspace(0, 2 * np.pi, stop - start))
    return q


def chain_that_rests(
    rng: np.random.Generator, *, bodies: int, frames: int, moving: float, trackers: int = 2
) -> MadeObject:
    """A chain of revolute joints from a root that stands still, which swing one after another.

    Args:
        rng: for where things are and how far they turn.
        bodies: of the chain, the root among them.
        frames: T.
        moving: share of the frames in which some joint moves; they rest before, between and after.
        trackers: on each body.
    """
    joints = tuple(
        MadeJoint(
            "revolute", i, i + 1, random_direction(rng), rng.uniform(-POINT_M, POINT_M, 3), random_poses(rng, ZERO_M)
        )
        for i in range(bodies - 1)
    )
    swing, rest = moving * frames / len(joints), (1 - moving) * frames / (len(joints) + 1)
    starts = [round(rest + i * (swing + rest)) for i in range(len(joints))]
    q = tuple(turn_of(frames, at, at + round(swing), float(rng.uniform(*TRAVEL_RAD))) for at in starts)
    body_of = tuple(body for body in range(bodies) for _ in range(trackers))
    root = np.tile(random_poses(rng, ROOT_M), (frames, 1, 1))
    return MadeObject(joints, q, root, "static", body_of, random_poses(rng, MOUNT_M, len(body_of)))


def errors_of_poses(rng: np.random.Generator, T_ref_part: FloatArray) -> FloatArray:
    """(T, K, 6) of unit variance: functions of each part's pose (T, K, 4, 4), by waves of random directions."""
    p, R = T_ref_part[..., :3, 3] / CHANGE_M, T_ref_part[..., :3, :2] / CHANGE_RAD
    at = np.concatenate([p, R.reshape(*p.shape[:2], 6)], axis=-1)
    parts = at.shape[1]
    waves, phase = rng.normal(size=(parts, WAVES, 6, 9)), rng.uniform(0, 2 * np.pi, (parts, WAVES, 6))
    return np.sin(np.einsum("tki,kwji->tkwj", at, waves) + phase).sum(axis=2) * np.sqrt(2 / WAVES)


def watch_resting(
    rng: np.random.Generator,
    made: MadeObject,
    std_m: float,
    std_rad: float,
    *,
    by_pose: float,
    outliers: float = 0.0,
    told: bool = True,
) -> PoseLog:
    """A log of the object's parts.

    Args:
        rng: of all errors.
        made: what is watched.
        std_m: deviation of a position's errors, for each axis.
        std_rad: of an orientation's.
        by_pose: share of the errors' variance that goes with the pose; the rest is new in each frame.
        outliers: share of the poses that are anywhere.
        told: whether the log has the errors' covariance.
    """
    T = made.T_ref_part
    deviations = np.repeat([std_m, std_rad], 3)
    white = rng.normal(size=(*T.shape[:2], 6))
    noise = (np.sqrt(by_pose) * errors_of_poses(rng, T) + np.sqrt(1 - by_pose) * white) * deviations
    measured = T @ poses(noise[..., 3:], noise[..., :3])
    gross = rng.uniform(size=T.shape[:2]) < outliers
    anywhere = random_poses(rng, OUTLIER_REACH_M, *T.shape[:2])
    anywhere[..., :3, 3] += T[..., :3, 3].mean(axis=0)
    measured[gross] = anywhere[gross]
    covariance = np.broadcast_to(np.diag(deviations**2), (*T.shape[:2], 6, 6)).copy() if told else None
    t_s = np.arange(len(T), dtype=np.float64) * FRAME_S
    return PoseLog(t_s, "world", made.parts, measured, covariance)
