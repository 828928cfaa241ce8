"""Articulated objects made from the definitions of the joints alone, and logs of what trackers would see of them.

Nothing here is shared with the learner but the log that it reads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from station.logs import FloatArray, PoseLog

FRAME_S = 1 / 30
STATES = {"rigid": 0, "prismatic": 1, "revolute": 1, "screw": 1, "spherical": 3}
# Gross outliers are anywhere within this of the part's mean position [m], turned anyhow.
OUTLIER_REACH_M = 0.5
PITCH_M_PER_RAD = 0.03


def poses(w: FloatArray, v: FloatArray) -> FloatArray:
    """(..., 4, 4) of rotation vectors w [rad] and translations v [m], (..., 3), broadcast."""
    shape = np.broadcast_shapes(w.shape, v.shape)
    T = np.zeros((*shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(np.array(w, dtype=np.float64)).as_matrix()
    T[..., :3, 3], T[..., 3, 3] = v, 1.0
    return T


def inverse(T: FloatArray) -> FloatArray:
    """(..., 4, 4)."""
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    found = np.zeros_like(T)
    found[..., :3, :3], found[..., :3, 3:], found[..., 3, 3] = R, -R @ T[..., :3, 3:], 1.0
    return found


def random_direction(rng: np.random.Generator) -> FloatArray:
    """(3,) unit vector, evenly over the sphere."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_rotations(rng: np.random.Generator, *batch: int) -> FloatArray:
    """(*batch, 3) rotation vectors, evenly over all rotations."""
    return Rotation.from_quat(rng.normal(size=(*batch, 4))).as_rotvec()


def random_poses(rng: np.random.Generator, reach_m: float, *batch: int) -> FloatArray:
    """(*batch, 4, 4) turned anyhow, within a cube of twice the reach."""
    return poses(random_rotations(rng, *batch), rng.uniform(-reach_m, reach_m, (*batch, 3)))


def normals(axis: FloatArray) -> FloatArray:
    """(2, 3) unit vectors at right angles to the axis (3,) and to each other."""
    return np.linalg.svd(axis[None])[2][1:]


@dataclass(frozen=True, eq=False)
class MadeJoint:
    """T_parent_child(q) = motion(q) @ T_parent_child_zero, everything in the parent body's frame."""

    type: str
    parent: int
    child: int
    axis: FloatArray
    point_m: FloatArray
    T_parent_child_zero: FloatArray
    pitch_m_per_rad: float = 0.0

    def motion(self, q: FloatArray) -> FloatArray:
        """(T, 4, 4) for states q (T, s): [m], [rad], or a rotation vector about the point."""
        if self.type == "rigid":
            return np.tile(np.eye(4), (len(q), 1, 1))
        if self.type == "prismatic":
            return poses(np.zeros(3), q * self.axis)
        w = q if self.type == "spherical" else q * self.axis
        v = self.point_m - Rotation.from_rotvec(w).apply(self.point_m)
        return poses(w, v + self.pitch_m_per_rad * q * self.axis if self.type == "screw" else v)


@dataclass(frozen=True, eq=False)
class MadeObject:
    """Bodies, the joints between them and the trackers on them, over T frames.

    Attributes:
        joints: parents come before their children; body 0 is the root.
        q: (T, s) states of each joint.
        T_ref_root: (T, 4, 4).
        root: "reference" (known exactly), "static" or "moving".
        body_of: body of each of the K trackers.
        T_body_part: (K, 4, 4).
    """

    joints: tuple[MadeJoint, ...]
    q: tuple[FloatArray, ...]
    T_ref_root: FloatArray
    root: str
    body_of: tuple[int, ...]
    T_body_part: FloatArray

    @property
    def T_ref_part(self) -> FloatArray:
        """(T, K, 4, 4)."""
        bodies = {0: self.T_ref_root}
        for joint, q in zip(self.joints, self.q, strict=True):
            bodies[joint.child] = bodies[joint.parent] @ joint.motion(q) @ joint.T_parent_child_zero
        return np.stack([bodies[b] @ T for b, T in zip(self.body_of, self.T_body_part, strict=True)], axis=1)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the trackers, each with its body."""
        return tuple(f"p{k}_b{body}" for k, body in enumerate(self.body_of))


def swept_states(kind: str, frames: int, travel: float) -> FloatArray:
    """(T, s) evenly spaced over the travel; a spherical joint's three wind through it at different rates."""
    if kind == "spherical":
        t = np.linspace(0, 2 * np.pi, frames)[:, None]
        return 0.5 * travel * np.sin(t * np.array([1.0, 2.0, 3.0]) + np.array([0.0, 1.0, 2.0]))
    return np.linspace(0, travel, frames)[:, None] * np.ones(STATES[kind])


def single_joint(
    rng: np.random.Generator,
    kind: str,
    *,
    frames: int,
    travel: float,
    arm_m: float,
    lever_m: float = 0.2,
    parent_tracked: bool = False,
) -> MadeObject:
    """One joint of a kind, however it may lie.

    Args:
        rng: for the direction of the axis and of the arm, the child's orientation and the parent's poses.
        kind: joint type.
        frames: T.
        travel: of the state [m or rad].
        arm_m: from the axis to the child's origin.
        lever_m: from the parent's origin to the axis.
        parent_tracked: whether the parent is a tracked part, posed anyhow in each frame; else it is the reference.
    """
    axis = random_direction(rng)
    point = lever_m * random_direction(rng)
    arm = arm_m * random_direction(rng) if kind == "spherical" else arm_m * (random_direction(rng)[:2] @ normals(axis))
    if kind != "spherical" and arm_m > 0:
        arm *= arm_m / np.linalg.norm(arm)
    zero = poses(random_rotations(rng), point + arm)
    joint = MadeJoint(kind, 0, 1, axis, point, zero, PITCH_M_PER_RAD if kind == "screw" else 0.0)
    q = (swept_states(kind, frames, travel),)
    if parent_tracked:
        return MadeObject((joint,), q, random_poses(rng, 0.5, frames), "moving", (0, 1), np.tile(np.eye(4), (2, 1, 1)))
    return MadeObject((joint,), q, np.tile(np.eye(4), (frames, 1, 1)), "reference", (1,), np.eye(4)[None])


@dataclass(frozen=True, eq=False)
class Faults:
    """What else is wrong with a log: shares of gross outliers and of unseen poses, no orientations, slow errors.

    `error_frames` is the time after which the errors' correlation falls to 1/e; 0 for independent ones.
    """

    outliers: float = 0.0
    missing: float = 0.0
    positions_only: bool = False
    error_frames: float = 0.0


SOUND = Faults()


@dataclass(frozen=True, eq=False)
class Watched:
    """A log, and the noise (T, K, 6) [m, rad] of the right perturbations that are in it where it shows no outlier."""

    log: PoseLog
    noise: FloatArray


def watch(
    rng: np.random.Generator, T_ref_part: FloatArray, std_m: float, std_rad: float, faults: Faults = SOUND
) -> Watched:
    """A log of poses (T, K, 4, 4) with Gaussian noise of these deviations for each axis, unknown to the log."""
    shape = T_ref_part.shape[:2]
    noise = _errors(rng, shape, faults.error_frames) * np.repeat([std_m, std_rad], 3)
    measured = T_ref_part @ poses(noise[..., 3:], noise[..., :3])
    gross = rng.uniform(size=shape) < faults.outliers
    anywhere = random_poses(rng, OUTLIER_REACH_M, *shape)
    anywhere[..., :3, 3] += T_ref_part[..., :3, 3].mean(axis=0)
    measured[gross] = anywhere[gross]
    covariance = None
    if faults.positions_only:
        measured[..., :3, :3] = np.eye(3)
        covariance = np.broadcast_to(np.diag(np.repeat([np.nan, np.inf], 3)), (*shape, 6, 6)).copy()
        covariance[..., ~np.eye(6, dtype=bool)] = 0.0
    measured[rng.uniform(size=shape) < faults.missing] = np.nan
    parts = tuple(f"p{k}" for k in range(shape[1]))
    return Watched(PoseLog(np.arange(shape[0]) * FRAME_S, "world", parts, measured, covariance), noise)


def _errors(rng: np.random.Generator, shape: tuple[int, ...], error_frames: float) -> FloatArray:
    """(T, K, 6) of unit variance; from frame to frame a first-order autoregression."""
    white = rng.normal(size=(*shape, 6))
    if error_frames <= 0:
        return white
    keep = np.exp(-1 / error_frames)
    white[1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0))


def named(watched: Watched, parts: tuple[str, ...]) -> Watched:
    """The same with other names of the parts."""
    return replace(watched, log=replace(watched.log, parts=parts))
