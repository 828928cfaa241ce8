"""All joints, mounts and states of one tree at once, from all its trackers.

The pose of part k of body b in frame t is

    T_ref_part = T_ref_root(t) @ prod over the joints from the root to b of F_j exp(q_jt screw_j) C_j  @ T_body_part

and its measured pose has the residual of `pairwise`. A link whose one marker is seen at a bad angle is then held by its
neighbours: each joint leaves one number a frame free instead of six. Gauss-Newton on the joints' and mounts'
parameters; each frame's states, with the root's pose if the root moves, are projected out (Schur complement). Frames
are independent given the parameters, so everything is batched over them, some at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from station.fit.bodies import Bodies
from station.fit.noise import INLIER_ABOVE, Noise, time_of_correlation
from station.fit.pairwise import (
    OUTLIER_SHARE_START,
    ROTATION_VOLUME,
    parameter_covariance,
    residual_jacobian,
    residuals,
    stepped_frames,
)
from station.kinematics import se3
from station.kinematics.joints import JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

ITERATIONS = 15
# Settled when a step promises to change chi squared by less than this.
SETTLED = 1e-2
DAMPING_START, DAMPING_FALL, DAMPING_RISE, DAMPING_MIN, DAMPING_MAX = 1e-6, 0.1, 10.0, 1e-12, 1e3
# Numbers in one chunk's whitened Jacobian, 8 bytes each.
JACOBIAN_SIZE = 8_000_000
# Relative; keeps a state that nothing observes where it is.
UNOBSERVED = 1e-12
# A pose that is less likely an inlier than this tells nothing; as a tiny weight it would only ruin the arithmetic.
LEAST_INLIER = 1e-3


@dataclass(frozen=True, eq=False)
class Skeleton:
    """What stays fixed: joints (parent body, child body, type) from the root outward, and the body of each part.

    Attributes:
        joints: parents come before their children; body 0 is the root.
        body_of: K bodies.
        free_mount: (K,) whether T_body_part is estimated; the part that gives a body its frame is not.
        root_moves: whether the root has a pose in each frame, or the identity throughout.
    """

    joints: tuple[tuple[int, int, JointType], ...]
    body_of: tuple[int, ...]
    free_mount: tuple[bool, ...]
    root_moves: bool

    def path(self, body: int) -> list[int]:
        """Joints between the root and a body."""
        above = {child: (j, parent) for j, (parent, child, _) in enumerate(self.joints)}
        found: list[int] = []
        while body in above:
            j, body = above[body]
            found.append(j)
        return found

    def joint_columns(self, j: int) -> slice:
        """Columns of a joint's parameters, those of T_parent_axis first."""
        sizes = [len(kind.axis_freedoms) + len(kind.child_freedoms) for _, _, kind in self.joints]
        return slice(sum(sizes[:j]), sum(sizes[: j + 1]))

    def mount_columns(self, part: int) -> slice:
        """Columns of a part's mount."""
        start = self.joint_columns(len(self.joints)).start + 6 * sum(self.free_mount[:part])
        return slice(start, start + 6 * self.free_mount[part])

    @property
    def parameters(self) -> int:
        """Number of columns."""
        return self.mount_columns(len(self.body_of) - 1).stop

    @property
    def states(self) -> int:
        """Numbers that each frame has of its own: joints' states, then the root's pose."""
        return len(self.joints) + 6 * self.root_moves


@dataclass(frozen=True, eq=False)
class TreeModel:
    """Parameters and states: T_ref_root (T, 4, 4), frames of each joint (4, 4), q (T, J), mounts (K, 4, 4)."""

    T_ref_root: FloatArray
    frames: tuple[JointFrames, ...]
    q: FloatArray
    mounts: FloatArray


@dataclass(frozen=True, eq=False)
class Measured:
    """Poses of the tree's K parts.

    Attributes:
        T_ref_part: (T, K, 4, 4).
        whitener: (T, K, 6, 6) W with W^T W the inverse covariance; rows of what was not measured are zero.
        log_odds: (T, K) of inlier against outlier at zero residual; -inf where unseen.
        dimensions: (T, K) numbers measured.
    """

    T_ref_part: FloatArray
    whitener: FloatArray
    log_odds: FloatArray
    dimensions: FloatArray

    def take(self, rows: slice) -> Measured:
        """Some of the frames."""
        return Measured(self.T_ref_part[rows], self.whitener[rows], self.log_odds[rows], self.dimensions[rows])


def measured_parts(bodies: Bodies, parts: Sequence[int]) -> Measured:
    """What was measured of some parts, each still a body of its own, with their covariances."""
    some = bodies.take(parts)
    if some.covariance is None:
        raise ValueError("a tree is fitted with covariances")
    noise = Noise(some.covariance, None, np.ones(1))
    whitener, log_density = noise.whitener(np.ones((len(some.seen), 1)), some.seen, some.oriented)
    outside = -np.log(bodies.scene_m3) * some.seen - np.log(ROTATION_VOLUME) * some.oriented
    log_odds = log_density - outside + np.log((1 - OUTLIER_SHARE_START) / OUTLIER_SHARE_START)
    dimensions = 3.0 * some.seen + 3.0 * some.oriented
    return Measured(some.T_ref_body, whitener, np.where(some.seen, log_odds, -np.inf), dimensions)


@dataclass(frozen=True, eq=False)
class TreeFit:
    """The refined tree.

    Attributes:
        model: parameters and states.
        covariance: (n, n) of the parameters, in the order of `Skeleton`'s columns.
        state_std: (T, J).
        inlier: (T, K) probability that a part's pose is one; 0 unseen.
        scale: variance of whitened residuals, 1 if the covariances are right; it is in the deviations already, and in
            those of the parameters so is the number of frames that repeat an error.
    """

    model: TreeModel
    covariance: FloatArray
    state_std: FloatArray
    inlier: FloatArray
    scale: float


def body_poses(skeleton: Skeleton, model: TreeModel) -> list[FloatArray]:
    """T_ref_body (T, 4, 4) of each body."""
    poses = {0: model.T_ref_root}
    for j, (parent, child, kind) in enumerate(skeleton.joints):  # parents come first
        f = model.frames[j]
        poses[child] = poses[parent] @ f.T_parent_axis @ kind.axis_motion(model.q[:, j, None], f.form) @ f.T_axis_child
    return [poses[body] for body in range(len(poses))]


def part_poses(skeleton: Skeleton, model: TreeModel) -> FloatArray:
    """T_ref_part (T, K, 4, 4)."""
    bodies = body_poses(skeleton, model)
    return np.stack([bodies[b] @ mount for b, mount in zip(skeleton.body_of, model.mounts, strict=True)], axis=1)


def jacobians(skeleton: Skeleton, model: TreeModel) -> tuple[FloatArray, FloatArray]:
    """Right perturbations of the parts' poses by the parameters (T, K, 6, n) and by the frame's states (T, K, 6, s).

    A twist of joint j, told in the reference frame by Ad(T_ref_child), moves all that hangs from it;
    Ad(T_ref_part^-1) tells it in the part's frame.
    """
    bodies, parts = body_poses(skeleton, model), part_poses(skeleton, model)
    T, K = parts.shape[:2]
    by_parameters, by_states = np.zeros((T, K, 6, skeleton.parameters)), np.zeros((T, K, 6, skeleton.states))
    twists = [_joint_twists(skeleton, model, j, bodies) for j in range(len(skeleton.joints))]
    of_root = se3.adjoint(bodies[0])
    for k, body in enumerate(skeleton.body_of):  # parts differ in their paths
        Ad = se3.adjoint(se3.inverse(parts[:, k]))
        for j in skeleton.path(body):
            columns = skeleton.joint_columns(j)
            moved = Ad @ twists[j]
            by_parameters[:, k, :, columns], by_states[:, k, :, j] = moved[..., :-1], moved[..., -1]
        if skeleton.root_moves:
            by_states[:, k, :, len(skeleton.joints) :] = Ad @ of_root
        if skeleton.free_mount[k]:
            by_parameters[:, k, :, skeleton.mount_columns(k)] = np.eye(6)
    return by_parameters, by_states


def _joint_twists(skeleton: Skeleton, model: TreeModel, j: int, bodies: Sequence[FloatArray]) -> FloatArray:
    """(T, 6, n_j + 1) twists in the reference frame of a joint's parameters and, last, its state."""
    _, child, kind = skeleton.joints[j]
    frames = model.frames[j]
    of_axis = se3.adjoint(bodies[child] @ se3.inverse(frames.T_axis_child))  # the axis frame, moved
    of_origin = se3.adjoint(
        bodies[child] @ se3.inverse(kind.axis_motion(model.q[:, j, None], frames.form) @ frames.T_axis_child)
    )  # the axis frame, before the motion
    by_axis = of_origin[..., list(kind.axis_freedoms)]
    return np.concatenate(
        [by_axis, of_axis[..., list(kind.child_freedoms)], of_axis @ kind.state_twists(frames.form)], axis=-1
    )


def stepped(skeleton: Skeleton, model: TreeModel, step: FloatArray, dstates: FloatArray) -> TreeModel:
    """The model moved by parameters (n,) and states (T, s)."""
    frames: list[JointFrames] = []
    for j, (_, _, kind) in enumerate(skeleton.joints):
        frames.append(stepped_frames(kind, model.frames[j], step[skeleton.joint_columns(j)]))
    mounts = model.mounts.copy()
    for k in np.flatnonzero(skeleton.free_mount):
        mounts[k] = mounts[k] @ se3.exp(step[skeleton.mount_columns(int(k))])
    J = len(skeleton.joints)
    root = model.T_ref_root @ se3.exp(dstates[:, J:]) if skeleton.root_moves else model.T_ref_root
    return TreeModel(root, tuple(frames), model.q + dstates[:, :J], mounts)


@dataclass(frozen=True, eq=False)
class _Reduced:
    """Normal equations of the parameters, and for each frame its states' step = own - coupling @ parameters' step."""

    H: FloatArray  # (n, n)
    unreduced: FloatArray  # (n,) diagonal of H before the states were eliminated
    g: FloatArray  # (n,)
    own: FloatArray  # (T, s)
    coupling: FloatArray  # (T, s, n)
    state_covariance: FloatArray  # (T, s, s) given the parameters


def _reduce(skeleton: Skeleton, model: TreeModel, measured: Measured, inlier: FloatArray, damping: float) -> _Reduced:
    T, K = inlier.shape
    rows = max(JACOBIAN_SIZE // (6 * K * (skeleton.parameters + skeleton.states)), 1)
    pieces: list[_Reduced] = []
    for start in range(0, T, rows):  # memory asks for this loop
        some = slice(start, start + rows)
        part = replace(model, T_ref_root=model.T_ref_root[some], q=model.q[some])
        pieces.append(_reduced_piece(skeleton, part, measured.take(some), inlier[some], damping))
    return _Reduced(
        np.sum([p.H for p in pieces], axis=0),
        np.sum([p.unreduced for p in pieces], axis=0),
        np.sum([p.g for p in pieces], axis=0),
        np.concatenate([p.own for p in pieces]),
        np.concatenate([p.coupling for p in pieces]),
        np.concatenate([p.state_covariance for p in pieces]),
    )


def _reduced_piece(
    skeleton: Skeleton, model: TreeModel, measured: Measured, inlier: FloatArray, damping: float
) -> _Reduced:
    e = residuals(measured.T_ref_part, part_poses(skeleton, model))
    W = measured.whitener * np.sqrt(inlier)[..., None, None]
    by_parameters, by_states = jacobians(skeleton, model)
    WK = W @ residual_jacobian(e)
    T, K = inlier.shape
    A = (WK @ by_parameters).reshape(T, 6 * K, -1)
    B = (WK @ by_states).reshape(T, 6 * K, -1)
    r = (W @ e[..., None]).reshape(T, 6 * K, 1)
    B_t = np.swapaxes(B, -1, -2)
    H_ss = B_t @ B
    diagonal = np.diagonal(H_ss, axis1=-2, axis2=-1)
    kept = np.where(diagonal > 0, (UNOBSERVED + damping) * diagonal, 1.0)
    inverse = np.asarray(np.linalg.inv(H_ss + kept[..., None] * np.eye(kept.shape[-1])), dtype=np.float64)
    coupling = inverse @ (B_t @ A)
    own = -inverse @ (B_t @ r)
    A_free = (A - B @ coupling).reshape(-1, A.shape[-1])
    H = A_free.T @ A.reshape(-1, A.shape[-1])
    unreduced = np.sum(A.reshape(-1, A.shape[-1]) ** 2, axis=0)
    return _Reduced(0.5 * (H + H.T), unreduced, A_free.T @ r.reshape(-1), own[..., 0], coupling, inverse)


def _chi2(skeleton: Skeleton, model: TreeModel, measured: Measured) -> FloatArray:
    """(T, K) whitened squared residuals."""
    e = residuals(measured.T_ref_part, part_poses(skeleton, model))
    return np.sum((measured.whitener @ e[..., None])[..., 0] ** 2, axis=-1)


def refine_tree(skeleton: Skeleton, model: TreeModel, measured: Measured) -> TreeFit:
    """Least squares from a start; poses that don't fit are weighted down as outliers of the scene."""
    damping = DAMPING_START
    chi2 = _chi2(skeleton, model, measured)
    for _ in range(ITERATIONS):  # each step starts where the last one ended
        inlier = _inlier(measured, chi2)
        reduced = _reduce(skeleton, model, measured, inlier, damping)
        step = -_solve(reduced.H, reduced.g, damping)
        tried = stepped(skeleton, model, step, reduced.own - reduced.coupling @ step)
        tried_chi2 = _chi2(skeleton, tried, measured)
        gain = float(np.sum(inlier * (chi2 - tried_chi2)))
        if gain >= 0:
            model, chi2, damping = tried, tried_chi2, max(damping * DAMPING_FALL, DAMPING_MIN)
        else:
            damping = min(max(damping, DAMPING_START) * DAMPING_RISE, DAMPING_MAX)
        if abs(gain) <= SETTLED:
            break
    return _finished(skeleton, model, measured, chi2)


def _inlier(measured: Measured, chi2: FloatArray) -> FloatArray:
    """(T, K) probability that a pose is no outlier."""
    probability = np.asarray(expit(measured.log_odds - 0.5 * chi2), dtype=np.float64)
    return np.where(probability > LEAST_INLIER, probability, 0.0)


def _solve(H: FloatArray, g: FloatArray, damping: float) -> FloatArray:
    """H^-1 g with columns scaled to unit length."""
    scale = np.sqrt(np.where(np.diagonal(H) > 0, np.diagonal(H), 1.0))
    scaled = H / np.outer(scale, scale) + (damping + UNOBSERVED) * np.eye(len(H))
    return np.linalg.solve(scaled, g / scale) / scale


def _repeats(skeleton: Skeleton, model: TreeModel, measured: Measured, inlier: FloatArray) -> float:
    """Frames in which an error repeats itself: what is shared by all frames is known so much less; at least 1."""
    e = residuals(measured.T_ref_part, part_poses(skeleton, model))
    whitened = np.swapaxes((measured.whitener @ e[..., None])[..., 0], 0, 1)
    good = inlier.T > INLIER_ABOVE
    frames = good.sum(axis=-1)
    times = time_of_correlation(whitened, good, measured.dimensions.max(axis=0))
    return float(np.sum(frames * times) / max(np.sum(frames), 1))


def _finished(skeleton: Skeleton, model: TreeModel, measured: Measured, chi2: FloatArray) -> TreeFit:
    inlier = _inlier(measured, chi2)
    reduced = _reduce(skeleton, model, measured, inlier, 0.0)
    observed = np.sum(inlier.max(axis=1, initial=0.0))
    freedoms = np.sum(inlier * measured.dimensions) - skeleton.parameters - skeleton.states * observed
    scale = float(np.sum(inlier * chi2) / freedoms) if freedoms > 0 else 1.0
    repeats = _repeats(skeleton, model, measured, inlier)
    covariance = parameter_covariance(reduced.H, reduced.unreduced) * scale * repeats
    shared = np.einsum("tsn,nm,tsm->ts", reduced.coupling, covariance, reduced.coupling, optimize=True)
    own = np.diagonal(reduced.state_covariance, axis1=-2, axis2=-1) * scale
    return TreeFit(model, covariance, np.sqrt(own + shared)[:, : len(skeleton.joints)], inlier, scale)
